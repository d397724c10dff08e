//! A virtual bench with a base that the stage carries, and calibrations made on it (SIMULATED).

use crate::support::virtual_bench::{VirtualBench, rig_at};
use crate::support::{program, repository, text, until};
use serde_json::Value;
use std::path::{Path, PathBuf};
use wcal_acquisition::rig::Rig;
use wcal_core::CalibrationFile;
use wcal_core::clock::HostClock;
use wcal_core::device::Permission;
use wcal_core::rig_devices::DeviceOpener;
use wcal_drivers::Drivers;

/// A running `wcal virtual-bench` and its rig.
pub(crate) struct Bench {
    served: VirtualBench,
    pub addresses: PathBuf,
    pub rig: PathBuf,
}

impl Bench {
    pub(crate) fn start(folder: &Path, speed: f64, rate_hz: f64) -> Self {
        let scenario = format!(
            "format = \"wcal-scenario/1\"\nseed = 7\nspeed = {speed}\n[interrogator]\nrate_hz = {rate_hz}\n[cameras]\nrate_hz = 1\n\
             size_px = [64, 48]\n"
        );
        let base = "[base]\nworld_from_base = [[1, 0, 0, 100], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\ncarried_along = [0, 0, 1]\n";
        let rig = folder.join(format!("{speed}-rig.toml"));
        std::fs::write(&rig, format!("{}\n{base}", rig_at(rate_hz))).unwrap();
        let served = VirtualBench::serve(folder, &format!("{speed}-"), &scenario);
        Self {
            addresses: served.addresses.clone(),
            served,
            rig,
        }
    }

    pub(crate) fn type_fault(&mut self, line: &str) {
        self.served.type_fault(line);
    }

    /// The stage, homed, trajectory 1 presented, free of the wire.
    pub(crate) fn stage(&self, speed: f64) -> Box<dyn wcal_core::device::Stage> {
        let addresses: Value =
            serde_json::from_slice(&std::fs::read(&self.addresses).unwrap()).unwrap();
        let port = format!("tcp://{}", addresses["stage_tcp"].as_str().unwrap());
        let rig = std::fs::read_to_string(&self.rig)
            .unwrap()
            .replace("tcp://127.0.0.1:PORT", &port);
        let rig = Rig::parse("rig.toml", &rig).unwrap();
        let clock = HostClock::start(speed);
        let mut devices = Drivers::default();
        let mut stage = devices.stage(&rig.stage, clock).unwrap();
        stage.start_home().unwrap();
        until_standing(stage.as_mut());
        let mut mount = devices.mount(&rig.mount, clock).unwrap().unwrap();
        mount
            .prepare(Permission {
                home: true,
                clear_flags: false,
            })
            .unwrap();
        mount.select(1).unwrap();
        go(stage.as_mut(), 18.0);
        stage
    }
}

pub(crate) fn until_standing(stage: &mut dyn wcal_core::device::Stage) {
    // The axis answers with an error until it has its reference.
    until("a stage at rest", || stage.read().is_ok_and(|r| !r.moving));
}

/// Waits until a run has written that many rows, ten for each second of the bench.
pub(crate) fn until_rows(table: &Path, rows: usize) {
    let there = || std::fs::read_to_string(table).map_or(0, |t| t.lines().skip(1).count());
    until("rows", || there() >= rows);
}

/// Waits until a run has written that many rows more. Rows reach the file every half second: some
/// of them may be older than the call.
pub(crate) fn for_rows(table: &Path, rows: usize) {
    until_rows(
        table,
        rows + std::fs::read_to_string(table).map_or(0, |t| t.lines().skip(1).count()),
    );
}

pub(crate) fn go(stage: &mut dyn wcal_core::device::Stage, mm: f64) {
    stage.start_move(mm, 4.0).unwrap();
    until_standing(stage);
}

/// A calibration that `fit-gpr` made of a session of the virtual bench, as it is and sealed again
/// as verified.
pub(crate) fn calibrations(folder: &Path) -> [PathBuf; 2] {
    let bench = Bench::start(folder, 20.0, 500.0);
    let (session, fit) = (folder.join("session"), folder.join("fit"));
    let plan = repository("rigs/plans/paper-27.toml");
    let sweep = program()
        .args(["stage-sweep", "--home", "--json", "--rig"])
        .arg(&bench.rig)
        .arg("--plan")
        .arg(plan)
        .arg("--bench")
        .arg(&bench.addresses)
        .arg("--out")
        .arg(&session)
        .output()
        .unwrap();
    assert_eq!(sweep.status.code(), Some(0), "{}", text(&sweep.stderr));
    let run = program()
        .arg("fit-gpr")
        .arg(&session)
        .arg("--out")
        .arg(&fit)
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let raw = fit.join("calibration.json");
    let good = folder.join("verified.json");
    reseal(&raw, &good, |c| {
        c.verification = wcal_core::VerificationStatus::Verified
    });
    [raw, good]
}

pub(crate) fn reseal(from: &Path, to: &Path, change: impl FnOnce(&mut CalibrationFile<Value>)) {
    let mut file: CalibrationFile<Value> =
        serde_json::from_slice(&std::fs::read(from).unwrap()).unwrap();
    change(&mut file);
    file.content_sha256 = file.compute_hash().unwrap();
    std::fs::write(to, serde_json::to_vec_pretty(&file).unwrap()).unwrap();
}
