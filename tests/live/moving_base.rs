//! A virtual bench with a base that the stage carries, and calibrations made on it (SIMULATED).

use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use wcal_acquisition::rig::Rig;
use wcal_core::CalibrationFile;
use wcal_core::clock::HostClock;
use wcal_core::rig_devices::DeviceOpener;
use wcal_drivers::Drivers;

pub fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

pub fn wcal() -> Command {
    Command::new(env!("CARGO_BIN_EXE_wcal"))
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A running `wcal virtual-bench`, ended when dropped.
pub struct Bench {
    child: Child,
    pub addresses: PathBuf,
    pub rig: PathBuf,
}

impl Bench {
    pub fn start(folder: &Path, speed: f64, rate_hz: f64) -> Self {
        let path = |name: &str| folder.join(format!("{speed}-{name}"));
        let scenario = format!(
            "format = \"wcal-scenario/1\"\nseed = 7\nspeed = {speed}\n[interrogator]\nrate_hz = {rate_hz}\n[cameras]\nrate_hz = 1\n\
             size_px = [64, 48]\n"
        );
        std::fs::write(path("scenario.toml"), scenario).unwrap();
        let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
        let base = "[base]\nworld_from_base = [[1, 0, 0, 100], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\ncarried_along = [0, 0, 1]\n";
        let rig = rig.replace("rate_hz = 2000.0", &format!("rate_hz = {rate_hz:?}"));
        std::fs::write(path("rig.toml"), format!("{rig}\n{base}")).unwrap();
        let mut child = wcal()
            .arg("virtual-bench")
            .arg("--scenario")
            .arg(path("scenario.toml"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        std::fs::write(path("bench.json"), line).unwrap();
        Self { child, addresses: path("bench.json"), rig: path("rig.toml") }
    }

    pub fn type_fault(&mut self, line: &str) {
        writeln!(self.child.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// The stage, homed, trajectory 1 presented, free of the wire.
    pub fn stage(&self, speed: f64) -> Box<dyn wcal_core::device::Stage> {
        let addresses: Value = serde_json::from_slice(&std::fs::read(&self.addresses).unwrap()).unwrap();
        let port = format!("tcp://{}", addresses["stage_tcp"].as_str().unwrap());
        let rig = std::fs::read_to_string(&self.rig).unwrap().replace("tcp://127.0.0.1:PORT", &port);
        let rig = Rig::parse("rig.toml", &rig).unwrap();
        let clock = HostClock::start(speed);
        let mut devices = Drivers::default();
        let mut stage = devices.stage(&rig.stage, clock).unwrap();
        stage.start_home().unwrap();
        until_standing(stage.as_mut());
        devices.mount(&rig.mount, clock).unwrap().unwrap().select(1).unwrap();
        go(stage.as_mut(), 18.0);
        stage
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

pub fn until_standing(stage: &mut dyn wcal_core::device::Stage) {
    let start = Instant::now();
    // The axis answers with an error until it has its reference.
    while stage.read().map_or(true, |r| r.moving) {
        assert!(start.elapsed() < Duration::from_secs(60), "the stage does not come to rest");
        std::thread::sleep(Duration::from_millis(10));
    }
}

pub fn go(stage: &mut dyn wcal_core::device::Stage, mm: f64) {
    stage.start_move(mm, 4.0).unwrap();
    until_standing(stage);
}

/// A calibration that `fit-gpr` made of a session of the virtual bench, as it is and sealed again as verified.
pub fn calibrations(folder: &Path) -> [PathBuf; 2] {
    let bench = Bench::start(folder, 20.0, 500.0);
    let (session, fit) = (folder.join("session"), folder.join("fit"));
    let plan = repository("rigs/plans/paper-27.toml");
    let sweep = wcal()
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
    let run = wcal().arg("fit-gpr").arg(&session).arg("--out").arg(&fit).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let raw = fit.join("calibration.json");
    let good = folder.join("verified.json");
    reseal(&raw, &good, |c| c.verification = wcal_core::VerificationStatus::Verified);
    [raw, good]
}

pub fn reseal(from: &Path, to: &Path, change: impl FnOnce(&mut CalibrationFile<Value>)) {
    let mut file: CalibrationFile<Value> = serde_json::from_slice(&std::fs::read(from).unwrap()).unwrap();
    change(&mut file);
    file.content_sha256 = file.compute_hash().unwrap();
    std::fs::write(to, serde_json::to_vec_pretty(&file).unwrap()).unwrap();
}
