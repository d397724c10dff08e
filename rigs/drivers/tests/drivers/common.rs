//! A virtual bench, its rig, and a short plan, for the sweep tests.

use crate::cantilever::Cantilever;
use std::path::Path;
use std::process::Command;
use wcal_acquisition::AcquisitionError;
use wcal_acquisition::record::{RecordRequest, RecordResult, record};
use wcal_core::SessionData;
use wcal_core::deadline::Interrupt;
use wcal_core::device::DeviceError;
use wcal_core::device::Mount;
use wcal_drivers::Drivers;
use wcal_drivers::bench::VirtualBench;
use wcal_drivers::bench::scenario::Scenario;

/// Bench seconds per wall second.
pub(crate) const SPEED: f64 = 4.0;
/// Two trajectories of two depths.
pub(crate) const PLAN: &str = r#"
format = "wcal-plan/1"
name = "short"
[settle]
gate_pm_per_s = 3.0
window_s = 0.3
timeout_s = 3.0
[[block]]
role = "calibration"
trajectories = [1, 5]
depths_mm = [1.5, 3.0]
dwell_s = 0.3
average_s = 0.4
"#;

/// The virtual bench has a motorised mount: nobody is asked.
pub(crate) struct NoMount;

impl Mount for NoMount {
    fn select(&mut self, _: u32) -> Result<(), DeviceError> {
        panic!("the virtual bench has a motorised mount");
    }
}

/// A bench whose `[interrogator]` has `extra` too; no cameras unless `extra` ends in a `[cameras]`
/// table.
pub(crate) fn bench(extra: &str) -> VirtualBench {
    let cameras = if extra.contains("[cameras]") {
        ""
    } else {
        "\n[cameras]\ncount = 0\n"
    };
    let text = format!(
        "format = \"wcal-scenario/1\"\nseed = 4\nspeed = {SPEED}\n[interrogator]\nrate_hz = 500\n{extra}{cameras}"
    );
    start(&text)
}

/// A running bench by the text of its scenario.
pub(crate) fn start(text: &str) -> VirtualBench {
    let scenario = Scenario::parse(text).unwrap();
    let plant = Cantilever::of(&scenario);
    VirtualBench::start(scenario, plant).unwrap()
}

/// The rig of `rigs/virtual` at the addresses of a bench.
pub(crate) fn rig(bench: &VirtualBench) -> String {
    let text = include_str!("../../../virtual/rig.toml");
    let a = bench.addresses();
    // Cameras are replaced first: all ports look the same.
    let text = match a.cameras.as_slice() {
        [left, right] => text
            .replacen(
                "source = \"127.0.0.1:PORT\"",
                &format!("source = \"{left}\""),
                1,
            )
            .replacen(
                "source = \"127.0.0.1:PORT\"",
                &format!("source = \"{right}\""),
                1,
            ),
        _ => text
            .split("[[camera]]")
            .next()
            .unwrap_or_default()
            .to_owned(),
    };
    text.replace("tcp://127.0.0.1:PORT", &format!("tcp://{}", a.stage_tcp))
        .replace("127.0.0.1:PORT", &a.sm130.to_string())
        .replace("clock_scale = 4.0", &format!("clock_scale = {SPEED:?}"))
        .replace("rate_hz = 2000.0", "rate_hz = 500.0")
}

/// A new session in `folder`.
pub(crate) fn order(bench: &VirtualBench, plan: &str, folder: &Path) -> RecordRequest {
    RecordRequest {
        rig: rig(bench),
        plan: plan.to_owned(),
        places: ["rig.toml", "plan.toml"].map(str::to_owned),
        folder: folder.join("session"),
        resume: false,
        home: true,
        created: "2026-01-02T03:04:05Z".to_owned(),
        command: vec!["test".to_owned()],
    }
}

/// Records without anybody watching.
pub(crate) fn go(order: &RecordRequest) -> Result<RecordResult, AcquisitionError> {
    record(
        order,
        &mut Drivers::default(),
        &mut NoMount,
        &Interrupt::default(),
        &mut std::thread::sleep,
        &mut |_| {},
    )
}

/// Rows of a session.
pub(crate) fn rows(folder: &Path) -> wcal_core::WhiskerData {
    let loaded = wcal_session::load(folder).unwrap();
    match loaded.data {
        SessionData::Whisker(data) => data,
        other => panic!("{:?}", other.kind()),
    }
}

/// Mounts what a test needs, as root.
pub(crate) fn mount(arguments: &[&str]) {
    assert!(
        Command::new("mount")
            .args(arguments)
            .status()
            .unwrap()
            .success(),
        "needs root: {arguments:?}"
    );
}

/// A disk of its own; unmounted when dropped.
pub(crate) struct Disk(tempfile::TempDir);

impl Disk {
    /// `size` as mount(8) takes it.
    pub(crate) fn of(size: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        mount(&[
            "-t",
            "tmpfs",
            "-o",
            &format!("size={size}"),
            "tmpfs",
            dir.path().to_str().unwrap(),
        ]);
        Self(dir)
    }

    /// Where it is mounted.
    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Lazily: a recording may still be open where an assertion failed.
        let _ = Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}
