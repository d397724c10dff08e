//! Sweeps against the virtual bench: good weather, and one test for every fault with its named outcome.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use wcal_core::device::{DeviceError, DeviceErrorKind as Kind};
use wcal_core::{Role, SessionData};
use wcal_drivers::bench::VirtualBench;
use wcal_drivers::bench::faults::Fault;
use wcal_drivers::bench::scenario::Scenario;
use wcal_drivers::record::{Order, Recorded, record};
use wcal_session::recording::RecordingError;
use wcal_session::recording::sweep::{Ending, Mount};

const SPEED: f64 = 8.0;
const PLAN: &str = r#"
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

struct NoMount;

impl Mount for NoMount {
    fn select(&mut self, _: u32) -> Result<(), DeviceError> {
        panic!("the virtual bench has a motorised mount");
    }
}

fn bench(extra: &str) -> VirtualBench {
    let text = format!(
        "format = \"wcal-scenario/1\"\nseed = 4\nspeed = {SPEED}\n[interrogator]\nrate_hz = 500\n\
         [cameras]\ncount = 0\n{extra}"
    );
    VirtualBench::start(Scenario::parse(&text).unwrap(), None).unwrap()
}

fn rig(bench: &VirtualBench) -> String {
    let text = include_str!("../../virtual/rig.toml");
    let a = bench.addresses();
    text.replace("tcp://127.0.0.1:PORT", &format!("tcp://{}", a.stage_tcp))
        .replace("127.0.0.1:PORT", &a.sm130.to_string())
        .replace("clock_scale = 10.0", &format!("clock_scale = {SPEED:?}"))
        .replace("rate_hz = 2000.0", "rate_hz = 500.0")
}

fn order(bench: &VirtualBench, plan: &str, folder: &Path) -> Order {
    Order {
        rig: rig(bench),
        plan: plan.to_owned(),
        folder: folder.join("session"),
        resume: false,
        home: true,
        created: "2026-01-02T03:04:05Z".to_owned(),
        command: vec!["test".to_owned()],
    }
}

fn go(order: &Order) -> Result<Recorded, RecordingError> {
    record(order, &mut NoMount, &AtomicBool::new(false), &mut |_| {})
}

fn rows(folder: &Path) -> wcal_core::WhiskerData {
    let loaded = wcal_session::load(folder).unwrap();
    match loaded.data {
        SessionData::Whisker(data) => data,
        other => panic!("{:?}", other.kind()),
    }
}

#[test]
fn a_plan_becomes_a_session_that_loads_and_agrees_with_the_plant() {
    let (bench, dir) = (bench("clock_offset_s = 120.0\nclock_drift_ppm = 200"), tempfile::tempdir().unwrap());
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
    assert!(count(Role::Verification) > 10, "{} rows on the fly", count(Role::Verification));
    assert_eq!(data.holdout.len(), 2, "the holdout with its own rest");
    // What the plant does at trajectory 1: K m with m = (-, 0) for a push along +z.
    let scenario = Scenario::parse("format = \"wcal-scenario/1\"").unwrap();
    let mut plant = wcal_drivers::bench::plant::Cantilever::new(&scenario);
    let settled: Vec<_> =
        data.rows.iter().filter(|r| r.role == Role::Calibration && r.trajectory == Some(1)).collect();
    for row in &settled {
        let depth = row.stage_mm.unwrap();
        let m = wcal_drivers::bench::plant::Plant::moment_nmm(&mut plant, 1, depth);
        let expected = 72.0 * m[0] + 9.0 * m[1] + 3.0;
        let heat = row.reference_shift_pm.unwrap();
        assert!((row.shift_pm[0] - heat - expected).abs() < 0.6, "{} against {expected}", row.shift_pm[0]);
        assert!((row.groove_mm.unwrap().z - depth).abs() < 1e-6);
        assert!((0.8..1.2).contains(&row.shift_sd_pm.unwrap()[0]));
        assert!((180..=205).contains(&row.samples.unwrap()), "{:?}", row.samples);
    }
    // Rows on the fly are where the stage was: their shifts lie on the settled curve.
    for row in data.rows.iter().filter(|r| r.role == Role::Verification && r.trajectory == Some(1)) {
        let m = wcal_drivers::bench::plant::Plant::moment_nmm(&mut plant, 1, row.stage_mm.unwrap());
        let off = row.shift_pm[0] - row.reference_shift_pm.unwrap() - (72.0 * m[0] + 9.0 * m[1] + 3.0);
        assert!(off.abs() < 20.0, "{off} pm at {:?} mm", row.stage_mm);
    }
    // The device clock is two minutes ahead of the host's; the delay between the devices is below the poll.
    assert!(reduction.clocks[0].offset_s > 60.0, "{:?}", reduction.clocks);
    assert!(reduction.lag_s.iter().all(|s| s.abs() < 0.25), "{:?}", reduction.lag_s);
    let again = wcal_session::recording::reduce::reduce(&order.folder).unwrap();
    assert_eq!(again.rows, reduction.rows, "reducing twice gives the same");
    assert!(go(&order).is_err(), "a session is never overwritten");
}

/// A fault in the middle of a sweep: kind of the ending, stage at rest, session readable.
fn stopped_by(fault: Fault, expected: Kind) {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let injected = AtomicBool::new(false);
    let recorded = record(&order, &mut NoMount, &AtomicBool::new(false), &mut |p| {
        // The second depth of the first trajectory: a rest and a depth have been recorded by then.
        if p.step >= 5 && !injected.swap(true, Ordering::SeqCst) {
            bench.inject(fault);
        }
    })
    .unwrap();
    let Ending::Stopped { cause, stage_stopped } = &recorded.sweep.ending else {
        panic!("{fault:?} did not stop the sweep: {recorded:?}");
    };
    assert_eq!(cause.kind, expected, "{fault:?}: {cause}");
    assert_eq!(recorded.sweep.exit_code(), 1);
    let unreachable = fault == Fault::UnplugStage;
    assert_eq!(*stage_stopped, !unreachable, "{fault:?}");
    if !unreachable {
        assert_eq!(bench.true_stage().1, 0.0, "{fault:?}: the stage moves");
    }
    let reduction = recorded.reduction.as_ref().unwrap();
    assert!(reduction.rows >= 2, "{fault:?}: {reduction:?}");
    assert_eq!(reduction.cut_off, 0);
    assert!(!rows(&order.folder).rows.is_empty());
}

#[test]
fn stage_faults_stop_the_sweep_by_name() {
    stopped_by(Fault::Stall, Kind::Stalled);
    stopped_by(Fault::Limit, Kind::OutOfRange);
    stopped_by(Fault::Displaced, Kind::Displaced);
    stopped_by(Fault::DriverOff, Kind::DriverOff);
    stopped_by(Fault::Critical, Kind::CriticalFault);
    stopped_by(Fault::UnplugStage, Kind::Disconnected);
}

#[test]
fn a_power_cut_of_the_stage_is_a_lost_reference() {
    stopped_by(Fault::PowerCut, Kind::NotHomed);
}

#[test]
fn stream_faults_stop_the_sweep_by_name() {
    stopped_by(Fault::CalibrationFault { on: true }, Kind::Health);
    stopped_by(Fault::TecFault { on: true }, Kind::Health);
    stopped_by(Fault::DataInvalid { on: true }, Kind::DataInvalid);
    stopped_by(Fault::PeakLost { grating: 1, on: true }, Kind::PeakLost);
    stopped_by(Fault::PeakCrossing { on: true }, Kind::PeakLost);
    stopped_by(Fault::UnplugInterrogator, Kind::Disconnected);
    stopped_by(Fault::StreamGap { seconds: 60.0 }, Kind::Timeout);
}

#[test]
fn lost_scans_and_garbage_are_counted_and_the_sweep_goes_on() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let step = std::cell::Cell::new(0);
    let recorded = record(&order, &mut NoMount, &AtomicBool::new(false), &mut |p| {
        if p.step >= 4 && step.replace(step.get() + 1) == 0 {
            bench.inject(Fault::LostSamples { count: 37 });
            bench.inject(Fault::StreamGarbage);
            bench.inject(Fault::CorruptReply);
        }
    })
    .unwrap();
    assert_eq!(recorded.sweep.ending, Ending::Finished, "{recorded:?}");
    assert_eq!((recorded.sweep.counts.gaps, recorded.sweep.counts.lost), (1, 37));
    assert_eq!(recorded.sweep.exit_code(), 3);
    assert_eq!(recorded.reduction.unwrap().lost, 37);
}

#[test]
fn ctrl_c_stops_the_stage_and_the_session_can_be_resumed() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let mut order = order(&bench, PLAN, dir.path());
    let interrupt = AtomicBool::new(false);
    let first = record(&order, &mut NoMount, &interrupt, &mut |p| {
        interrupt.store(p.step >= 5, Ordering::SeqCst);
    })
    .unwrap();
    let Ending::Stopped { cause, stage_stopped } = &first.sweep.ending else { panic!("{first:?}") };
    assert!(cause.kind == Kind::Interrupted && *stage_stopped);
    assert_eq!(bench.true_stage().1, 0.0);
    let before = rows(&order.folder).rows.len();
    order.resume = true;
    let second = go(&order).unwrap();
    assert_eq!(second.sweep.ending, Ending::Finished, "{second:?}");
    let data = rows(&order.folder);
    assert_eq!(data.rows.len(), 6, "{before} rows before");
    assert!(before < 6 && second.sweep.done < 8);
    let mut poses: Vec<_> =
        data.rows.iter().map(|r| (r.trajectory, (r.stage_mm.unwrap() * 10.0).round() as i64)).collect();
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
    assert!(go(&wide).unwrap_err().to_string().contains("stage position"));
    let unreferenced = Order { home: false, ..order(&bench, PLAN, &dir.path().join("b")) };
    let recorded = go(&unreferenced).unwrap();
    assert!(matches!(&recorded.sweep.ending, Ending::Stopped { cause, .. } if cause.kind == Kind::NotHomed));
    assert_eq!(bench.true_stage(), before);
}
