//! Sweeps against the virtual bench: good weather, interruptions, resuming, limits. Faults:
//! faults.rs.

use crate::common::{NoMount, PLAN, SPEED, bench, go, order, rows};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use wcal_acquisition::assign::ChannelMap;
use wcal_acquisition::monitor::Monitor;
use wcal_acquisition::record::{RecordRequest, record};
use wcal_acquisition::recorder::Recorder;
use wcal_acquisition::replay_interrogator::ReplayInterrogator;
use wcal_acquisition::rig::Rig;
use wcal_acquisition::run_file::RunFile;
use wcal_acquisition::sweep::{Ending, StageEnd, acquire};
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::{DeviceErrorKind as Kind, Interrogator};
use wcal_core::{Role, WhiskerRow};
use wcal_drivers::Drivers;
use wcal_drivers::bench::VirtualBench;
use wcal_drivers::bench::faults::Fault;
use wcal_drivers::bench::plant::Plant;
use wcal_drivers::bench::scenario::Scenario;

#[test]
fn a_plan_becomes_a_session_that_loads_and_agrees_with_the_plant() {
    let (bench, dir) = (
        bench("clock_offset_s = 120.0\nclock_drift_ppm = 200"),
        tempfile::tempdir().unwrap(),
    );
    let plan = format!(
        "{PLAN}unloading = true\nspeeds_mm_s = [1.0]\non_the_fly_hz = 10\n[[block]]\nrole = \"holdout\"\ntrajectories = [1]\n\
         depths_mm = [2.2]\ndwell_s = 0.3\naverage_s = 0.4\n"
    );
    let order = order(&bench, &plan, dir.path());
    let recorded = go(&order).unwrap();
    assert_eq!(recorded.sweep.ending, Ending::Finished, "{recorded:?}");
    assert_eq!(recorded.sweep.counts.lost, 0);
    let reduction = recorded.reduction.unwrap();
    let data = rows(&order.folder);
    let count = |role: Role| data.rows.iter().filter(|r| r.role == role).count();
    assert_eq!((count(Role::Rest), count(Role::Calibration)), (2, 6));
    assert!(
        count(Role::Verification) > 10,
        "{} rows on the fly",
        count(Role::Verification)
    );
    let sealed = wcal_session::load(&order.folder).unwrap().sealed;
    assert_eq!(sealed.len(), 2, "the holdout with its own rest");
    // What the plant does at trajectory 1: K m with m = (-, 0) for a push along +z.
    let scenario = Scenario::parse("format = \"wcal-scenario/1\"").unwrap();
    let mut plant = crate::cantilever::Cantilever::new(&scenario);
    let settled: Vec<_> = data
        .rows
        .iter()
        .filter(|r| r.role == Role::Calibration && r.trajectory == Some(1))
        .collect();
    for row in &settled {
        let depth = row.stage_mm.unwrap();
        let m = wcal_drivers::bench::plant::Plant::moment_nmm(&mut plant, 1, depth);
        let expected = 72.0 * m[0] + 9.0 * m[1] + 3.0;
        let heat = row.reference_shift_pm.unwrap();
        assert!(
            (row.shift_pm[0] - heat - expected).abs() < 0.6,
            "{} against {expected}",
            row.shift_pm[0]
        );
        assert!((row.groove_mm.unwrap().z - depth).abs() < 1e-6);
        assert!((0.8..1.2).contains(&row.shift_sd_pm.unwrap()[0]));
        assert!(
            (180..=205).contains(&row.samples.unwrap()),
            "{:?}",
            row.samples
        );
    }
    // Rows on the fly are where the stage was: their shifts lie on the settled curve. A row is the
    // mean of ten scans of 1 pm: 0.3 pm; a stamp of the stage that is some milliseconds late is
    // some tenths of a picometre at 1 mm/s, and tens of milliseconds on a busy computer.
    let moving = data
        .rows
        .iter()
        .filter(|r| r.role == Role::Verification && r.trajectory == Some(1));
    let moving: Vec<_> = moving.collect();
    let mut off_pm = |ahead_mm: f64| -> Vec<f64> {
        let off = |row: &&WhiskerRow| {
            let depth_mm = row.stage_mm.unwrap() + ahead_mm;
            let m = wcal_drivers::bench::plant::Plant::moment_nmm(&mut plant, 1, depth_mm);
            let heat = row.reference_shift_pm.unwrap();
            (row.shift_pm[0] - heat - (72.0 * m[0] + 9.0 * m[1] + 3.0)).abs()
        };
        let mut all: Vec<f64> = moving.iter().map(off).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let off = off_pm(0.0);
    let (middle, worst) = (off[off.len() / 2], off[off.len() - 1]);
    assert!(
        middle < 1.0 && worst < 5.0,
        "{middle} pm in the middle, {worst} pm at worst"
    );
    // Negative control: a stage that is elsewhere by a tenth of a millimetre, as after a tenth of a
    // second, is seen.
    let elsewhere = off_pm(0.1);
    assert!(elsewhere[elsewhere.len() / 2] > 1.0, "{elsewhere:?}");
    // The device clock is two minutes ahead of the host's; the delay between the devices is below
    // the poll (8 ms of wall time).
    assert!(
        reduction.clocks[0].offset_s > 60.0,
        "{:?}",
        reduction.clocks
    );
    assert_eq!(
        reduction.lag_s.len(),
        2,
        "one of each move between the devices"
    );
    assert!(
        reduction.lag_s.iter().all(|s| s.abs() < 0.008 * SPEED),
        "{:?}",
        reduction.lag_s
    );
    let again = wcal_acquisition::reduce::reduce(&order.folder).unwrap();
    assert_eq!(again.rows, reduction.rows, "reducing twice gives the same");
    assert!(go(&order).is_err(), "a session is never overwritten");
}

#[test]
fn ctrl_c_stops_the_stage_and_the_session_can_be_resumed() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let mut order = order(&bench, PLAN, dir.path());
    let interrupt = Interrupt::default();
    let mut lost = false;
    let first = record(
        &order,
        &mut Drivers::default(),
        &mut NoMount,
        &interrupt,
        &mut std::thread::sleep,
        &mut |p| {
            if p.step >= 4 && !std::mem::replace(&mut lost, true) {
                bench.inject(Fault::LostSamples { count: 37 });
            }
            if p.step >= 5 {
                interrupt.set(Signal::CtrlC);
            }
        },
    )
    .unwrap();
    let Ending::Stopped { cause, stage } = &first.sweep.ending else {
        panic!("{first:?}")
    };
    assert_eq!(
        (cause.kind, *stage),
        (Kind::Interrupted, StageEnd::Retracted)
    );
    assert_eq!(bench.true_stage().1, 0.0);
    let before = rows(&order.folder).rows.len();
    order.resume = true;
    let second = go(&order).unwrap();
    assert_eq!(second.sweep.ending, Ending::Finished, "{second:?}");
    // What the first run lost is still lost: the exit code, run.json and session.toml say so.
    assert_eq!(
        (second.sweep.counts.lost, second.exit_code()),
        (0, 3),
        "{:?}",
        second.warnings()
    );
    assert!(
        second
            .warnings()
            .iter()
            .any(|w| w == "37 scans lost in 1 gaps"),
        "{:?}",
        second.warnings()
    );
    let run = std::fs::read_to_string(order.folder.join("run.json")).unwrap();
    let runs = RunFile::parse(&run).unwrap().runs;
    let [stopped, finished] = &runs[..] else {
        panic!("{runs:?}")
    };
    assert_eq!(
        (stopped.ending.as_str(), stopped.lost_scans),
        ("stopped", 37),
        "{runs:?}"
    );
    assert_eq!(
        (finished.ending.as_str(), finished.recording.as_str()),
        ("finished", "recording-2.mcap")
    );
    assert_eq!(finished.warnings, second.warnings());
    let session = std::fs::read_to_string(order.folder.join("session.toml")).unwrap();
    assert!(
        session.contains("lost_scans = 37") && session.contains("37 scans lost in 1 gaps"),
        "{session}"
    );
    let data = rows(&order.folder);
    assert_eq!(data.rows.len(), 6, "{before} rows before");
    assert!(before < 6 && second.sweep.done < 8);
    let mut poses: Vec<_> = data
        .rows
        .iter()
        .map(|r| (r.trajectory, (r.stage_mm.unwrap() * 10.0).round() as i64))
        .collect();
    poses.sort_unstable();
    poses.dedup();
    assert_eq!(poses.len(), 6, "no pose twice");
    // Another plan is not the same session.
    order.plan = order.plan.replace("3.0]", "3.5]");
    assert!(go(&order).unwrap_err().to_string().contains("same content"));
}

#[test]
fn nothing_moves_when_the_plan_leaves_the_limits_or_the_reference_is_missing() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let before = bench.true_stage();
    let wide = order(&bench, &PLAN.replace("3.0]", "30.0]"), dir.path());
    assert!(
        go(&wide)
            .unwrap_err()
            .to_string()
            .contains("stage position")
    );
    let unreferenced = RecordRequest {
        home: false,
        ..order(&bench, PLAN, &dir.path().join("b"))
    };
    let why = go(&unreferenced).unwrap_err().to_string();
    assert!(
        why.contains("`--home` searches the reference") && why.contains("[not-homed]"),
        "{why}"
    );
    assert!(!unreferenced.folder.exists());
    assert_eq!(bench.true_stage(), before);
}

/// Live and replayed scans are the same to the monitor: rate, counts and the last wavelengths.
#[test]
fn a_recording_is_an_interrogator_again() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let live = go(&order).unwrap().sweep.counts;
    let rig = Rig::parse("rig.toml", &order.rig).unwrap();
    let mut replay = ReplayInterrogator::open(&order.folder.join("recording.mcap")).unwrap();
    assert!(
        (replay.rate_hz() - 500.0).abs() < 1.0,
        "{}",
        replay.rate_hz()
    );
    let monitor = Mutex::new(Monitor::new(
        ChannelMap::new(&rig),
        [1.0, 1.0],
        rig.clock_scale,
    ));
    let again = Recorder::create(&dir.path().join("again.mcap"), Default::default()).unwrap();
    acquire(&mut replay, &monitor, &again, &AtomicBool::new(false));
    again.finish().unwrap();
    let monitor = monitor.into_inner().unwrap();
    assert_eq!(
        (monitor.counts().scans, monitor.counts().lost),
        (live.scans, 0)
    );
    assert_eq!(
        monitor.fault().unwrap().kind,
        Kind::Disconnected,
        "the end of a recording is an end"
    );
    assert!(monitor.latest().usable().is_some());
    assert!(ReplayInterrogator::open(&dir.path().join("none.mcap")).is_err());
}

/// A wire that holds the whole bench up, once, at its first contact.
struct Stalls(Box<dyn Plant>, bool);

impl Plant for Stalls {
    fn moment_nmm(&mut self, trajectory: u32, depth_mm: f64) -> [f64; 2] {
        if depth_mm > 1.0 && !std::mem::replace(&mut self.1, true) {
            std::thread::sleep(Duration::from_secs(3));
        }
        self.0.moment_nmm(trajectory, depth_mm)
    }
}

/// Neither its stage nor its interrogator is blamed for a bench that did not get to run: its time
/// stood, and it knows for how long. A device that is silent while its bench runs is (faults.rs).
#[test]
fn a_bench_that_does_not_run_lets_its_time_stand() {
    let text = format!(
        "format = \"wcal-scenario/1\"\nspeed = {SPEED}\n[interrogator]\nrate_hz = 500\n[cameras]\ncount = 0\n"
    );
    let scenario = Scenario::parse(&text).unwrap();
    let wire = crate::cantilever::Cantilever::of(&scenario);
    let (bench, dir) = (
        VirtualBench::start(scenario, Box::new(Stalls(wire, false))).unwrap(),
        tempfile::tempdir().unwrap(),
    );
    let recorded = go(&order(&bench, PLAN, dir.path())).unwrap();
    assert_eq!(recorded.sweep.ending, Ending::Finished, "{recorded:?}");
    assert!(
        !recorded.warnings().iter().any(|w| w.contains(" late")),
        "{:?}",
        recorded.warnings()
    );
    let found = bench.fell_behind_s();
    assert!(found.is_some_and(|s| s > 2.5 * SPEED), "{found:?}");
}

/// Every settled pose has its pair of pictures, in the session and, the same bytes, in the
/// recording; between them there are small ones.
#[test]
fn settled_poses_have_their_pictures_and_reduce_rebuilds_them_bit_for_bit() {
    let bench = bench("\n[cameras]\ncount = 2\n");
    let dir = tempfile::tempdir().unwrap();
    let order = order(&bench, PLAN, dir.path());
    let recorded = go(&order).unwrap();
    let reduction = recorded.reduction.unwrap();
    let rows = rows(&order.folder);
    assert_eq!(
        reduction.pictures,
        [2 * rows.rows.len(), 0],
        "{:?}",
        recorded.sweep
    );
    let pictures = order.folder.join("pictures");
    let all = |folder: &std::path::Path| -> Vec<(String, Vec<u8>)> {
        let mut found = Vec::new();
        for camera in ["left", "right"] {
            for row in &rows.rows {
                let name = format!("{camera}/{:05}.png", row.point);
                found.push((name.clone(), std::fs::read(folder.join(&name)).unwrap()));
            }
        }
        found.push((
            "table".to_owned(),
            std::fs::read(folder.join("pictures.csv")).unwrap(),
        ));
        found
    };
    let before = all(&pictures);
    // Each was exposed while its pose was held: after arrival and not long after the averaging
    // window, whose end is t_s of the row.
    let table = String::from_utf8(before.last().unwrap().1.clone()).unwrap();
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let (point, t_s): (i64, f64) = (cells[0].parse().unwrap(), cells[3].parse().unwrap());
        let row = rows.rows.iter().find(|r| r.point == point).unwrap();
        let after_s = t_s - (row.t_s.unwrap() - row.dwell_s.unwrap());
        assert!(
            after_s > 0.0 && after_s < row.dwell_s.unwrap() + 3.0 * SPEED,
            "{line}: {after_s} s after arrival"
        );
        assert!(
            (cells[5].parse::<f64>().unwrap() - 0.005).abs() < 1e-9,
            "{line}"
        );
    }
    std::fs::remove_dir_all(&pictures).unwrap();
    wcal_acquisition::reduce::reduce(&order.folder).unwrap();
    assert!(all(&pictures) == before, "the same bytes");
    // A preview is not a pose's picture: the recording is far smaller than its frames.
    let bytes = std::fs::metadata(order.folder.join("recording.mcap"))
        .unwrap()
        .len();
    let raw = recorded.sweep.counts.pairs * 2 * 640 * 480;
    assert!(bytes < raw / 3, "{bytes} of {raw}");
    let loaded = wcal_session::load(&order.folder).unwrap();
    // A busy machine may deliver scans late, which a row says; nothing else is wrong.
    let late =
        |w: &wcal_session::SessionWarning| matches!(w.kind, wcal_session::WarningKind::ScansLate);
    assert!(
        loaded.pictures.is_some() && loaded.warnings.iter().all(late),
        "{:?}",
        loaded.warnings
    );
    // Control: a session that names a folder outside is refused.
    let toml = order.folder.join("session.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    std::fs::write(&toml, text.replace("pictures/", "../pictures")).unwrap();
    assert!(
        wcal_session::load(&order.folder)
            .unwrap_err()
            .to_string()
            .contains("files.pictures")
    );
}
