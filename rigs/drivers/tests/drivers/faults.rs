//! The fault table: every fault of the virtual bench has a named outcome, a stage that stands, a
//! session that opens, and the documented exit code. Two runs a fault: on the move, and at rest at
//! another step.

use crate::common::{NoMount, PLAN, bench, order, rows};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use wcal_acquisition::record::{RecordResult, record};
use wcal_acquisition::sweep::Ending;
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::DeviceErrorKind as Kind;
use wcal_drivers::Drivers;
use wcal_drivers::bench::VirtualBench;
use wcal_drivers::bench::faults::Fault;

/// What the sweep makes of a fault.
#[derive(Debug, Clone, Copy)]
enum Outcome {
    /// It stops with a fault of this kind, exit code 1.
    Stops(Kind),
    /// It goes on and finishes: nothing is lost, exit code 0 (3 where the computer itself was
    /// late).
    Survives,
    /// It finishes with exit code 3, and a warning says so.
    Warns(&'static str),
}

/// One run: the fault comes at a step of its own, on the move when `moving`.
fn run(
    fault: Fault,
    extra: &str,
    step: usize,
    moving: bool,
) -> (VirtualBench, tempfile::TempDir, RecordResult) {
    let (bench, dir) = (bench(extra), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let injected = AtomicBool::new(false);
    let recorded = std::thread::scope(|scope| {
        record(
            &order,
            &mut Drivers::default(),
            &mut NoMount,
            &Interrupt::default(),
            &mut std::thread::sleep,
            &mut |p| {
                let state = (bench.true_stage().1 != 0.0) == moving;
                if p.step >= step && state && !injected.swap(true, Ordering::SeqCst) {
                    bench.inject(fault);
                    // A cable that is plugged in again: the stage is reached again and stopped.
                    if fault == Fault::UnplugStage {
                        scope.spawn(|| {
                            std::thread::sleep(Duration::from_millis(120));
                            bench.inject(Fault::PlugStage);
                        });
                    }
                }
            },
        )
    });
    assert!(
        injected.load(Ordering::SeqCst),
        "{fault:?} was never injected"
    );
    (bench, dir, recorded.unwrap())
}

fn judge(fault: Fault, extra: &str, outcome: Outcome, moving: bool) {
    // Step 3 is the first rest reading: from step 4 on there is a row to keep.
    let (bench, dir, recorded) = run(fault, extra, if moving { 4 } else { 5 }, moving);
    let k = if moving { "on the move" } else { "at rest" };
    let warnings = recorded.warnings();
    match (outcome, &recorded.sweep.ending) {
        (Outcome::Stops(kind), Ending::Stopped { cause, stage }) => {
            assert_eq!(cause.kind, kind, "{fault:?} {k}: {cause}");
            assert!(stage.stands(), "{fault:?} {k}: the stop was not confirmed");
            assert_eq!(recorded.exit_code(), 1);
        }
        (Outcome::Survives, Ending::Finished) => {
            // A computer that is busy with other things delays scans, which is said; the fault
            // itself leaves no warning.
            let busy = |w: &String| {
                w.contains(" scans late, by up to ")
                    || w.starts_with("0 rows with scans missing and ")
            };
            assert!(warnings.iter().all(busy), "{fault:?} {k}: {warnings:?}");
            let expected = if warnings.is_empty() { 0 } else { 3 };
            assert_eq!(
                recorded.exit_code(),
                expected,
                "{fault:?} {k}: {warnings:?}"
            );
        }
        (Outcome::Warns(word), Ending::Finished) => {
            assert_eq!(recorded.exit_code(), 3, "{fault:?} {k}");
            assert!(
                warnings.iter().any(|w| w.contains(word)),
                "{fault:?} {k}: {warnings:?}"
            );
        }
        (_, ending) => panic!("{fault:?} {k}: expected {outcome:?}, found {ending:?}"),
    }
    assert_eq!(bench.true_stage().1, 0.0, "{fault:?} {k}: the stage moves");
    let reduction = recorded.reduction.unwrap();
    assert_eq!(reduction.cut_off, 0, "{fault:?} {k}");
    // The first rest was read before every fault; a finished sweep has all six rows.
    let finished = matches!(recorded.sweep.ending, Ending::Finished);
    let count = rows(&dir.path().join("session")).rows.len();
    assert!(
        if finished {
            count == 6
        } else {
            (1..6).contains(&count)
        },
        "{fault:?} {k}: {count} rows"
    );
}

fn several(fault: Fault, extra: &str, outcome: Outcome) {
    // Two at a time: more benches than cores starve each other.
    std::thread::scope(|scope| {
        for moving in [true, false] {
            scope.spawn(move || judge(fault, extra, outcome, moving));
        }
    });
}

const CAMERAS: &str = "[cameras]\nrate_hz = 2\nsize_px = [64, 48]\n";

#[test]
fn a_stalled_or_pushed_stage_stops_the_sweep_by_name() {
    several(Fault::Stall, "", Outcome::Stops(Kind::Stalled));
    several(Fault::Limit, "", Outcome::Stops(Kind::OutOfRange));
    several(Fault::Displaced, "", Outcome::Stops(Kind::Displaced));
}

#[test]
fn a_stage_that_switches_off_stops_the_sweep_by_name() {
    several(Fault::DriverOff, "", Outcome::Stops(Kind::DriverOff));
    several(Fault::Critical, "", Outcome::Stops(Kind::CriticalFault));
}

#[test]
fn a_reset_or_power_cut_in_mid_move_is_a_lost_reference() {
    several(Fault::Reset, "", Outcome::Stops(Kind::NotHomed));
    several(Fault::PowerCut, "", Outcome::Stops(Kind::NotHomed));
}

#[test]
fn an_unplugged_stage_is_a_disconnection_and_is_stopped_once_reached() {
    several(Fault::UnplugStage, "", Outcome::Stops(Kind::Disconnected));
}

#[test]
fn disturbed_replies_are_asked_for_again() {
    for fault in [
        Fault::CorruptReply,
        Fault::SplitReply,
        Fault::LoseReply,
        Fault::DoubleReply,
        Fault::NoiseReply,
    ] {
        several(fault, "", Outcome::Survives);
    }
}

#[test]
fn late_foreign_and_further_lines_are_no_replies() {
    for fault in [Fault::LateReply, Fault::ForeignReply, Fault::InfoLines] {
        several(fault, "", Outcome::Survives);
    }
}

#[test]
fn a_stage_that_stays_busy_stops_the_sweep() {
    several(Fault::BusyForEver, "", Outcome::Stops(Kind::Timeout));
}

/// Without a reply the stop is not confirmed, but it was sent, and the stage stands.
#[test]
fn a_flood_stops_the_sweep_and_one_that_ends_does_not() {
    for fault in [
        Fault::AlertFlood { on: true },
        Fault::ForeignFlood { on: true },
    ] {
        let (bench, dir, recorded) = run(fault, "", 4, true);
        let Ending::Stopped { cause, stage } = &recorded.sweep.ending else {
            panic!("{fault:?}")
        };
        assert_eq!(
            (cause.kind, stage.stands(), recorded.exit_code()),
            (Kind::Timeout, false, 1),
            "{cause}"
        );
        assert!(cause.to_string().contains("none among"), "{cause}");
        assert_eq!(bench.true_stage().1, 0.0, "{fault:?}");
        assert!(!rows(&dir.path().join("session")).rows.is_empty());
    }
    // Control: over within the time of a question's repetitions.
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let injected = AtomicBool::new(false);
    let recorded = std::thread::scope(|scope| {
        record(
            &order,
            &mut Drivers::default(),
            &mut NoMount,
            &Interrupt::default(),
            &mut std::thread::sleep,
            &mut |p| {
                if p.step >= 4 && !injected.swap(true, Ordering::SeqCst) {
                    bench.inject(Fault::AlertFlood { on: true });
                    scope.spawn(|| {
                        std::thread::sleep(Duration::from_millis(600));
                        bench.inject(Fault::AlertFlood { on: false });
                    });
                }
            },
        )
    })
    .unwrap();
    assert_eq!(recorded.sweep.ending, Ending::Finished);
    assert!(recorded.repeats > 0);
}

#[test]
fn a_clock_that_is_set_or_stands_still_stops_the_sweep() {
    for seconds in [-3600.0, -5.0, 5.0, 3600.0] {
        several(
            Fault::ClockStep { seconds },
            "",
            Outcome::Stops(Kind::Clock),
        );
    }
    several(
        Fault::ClockStop { on: true },
        "",
        Outcome::Stops(Kind::Clock),
    );
}

#[test]
fn a_peak_without_a_value_is_counted_and_twenty_in_a_row_are_a_lost_peak() {
    let words = "1 scans with a lost or crossing peak";
    several(
        Fault::NanPeak {
            grating: 2,
            count: 1,
        },
        "",
        Outcome::Warns(words),
    );
    several(
        Fault::NanPeak {
            grating: 2,
            count: 30,
        },
        "",
        Outcome::Stops(Kind::PeakLost),
    );
}

/// The user wants an end while no reply comes: the sweep hears it at once, and tries to stop all
/// the same.
#[test]
fn an_interrupt_is_heard_while_a_question_waits() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let interrupt = Interrupt::default();
    let recorded = record(
        &order,
        &mut Drivers::new(&interrupt),
        &mut NoMount,
        &interrupt,
        &mut std::thread::sleep,
        &mut |p| {
            if p.step >= 4 {
                bench.inject(Fault::AlertFlood { on: true });
                interrupt.set(Signal::Terminate);
            }
        },
    )
    .unwrap();
    let Ending::Stopped { cause, .. } = &recorded.sweep.ending else {
        panic!("{recorded:?}")
    };
    assert_eq!(cause.kind, Kind::Interrupted, "{cause}");
    assert!(cause.to_string().contains("SIGTERM"), "{cause}");
    assert_eq!(bench.true_stage().1, 0.0);
}

#[test]
fn lost_samples_and_gaps_are_counted_and_a_dead_stream_stops_the_sweep() {
    several(
        Fault::LostSamples { count: 37 },
        "",
        Outcome::Warns("37 scans lost in 1 gaps"),
    );
    several(
        Fault::StreamGap { seconds: 2.0 },
        "buffer = 200",
        Outcome::Warns("scans lost"),
    );
    several(Fault::StreamGap { seconds: 1.0 }, "", Outcome::Survives);
    several(Fault::StreamGarbage, "", Outcome::Survives);
    several(
        Fault::StreamGap { seconds: 60.0 },
        "",
        Outcome::Stops(Kind::Timeout),
    );
    several(
        Fault::UnplugInterrogator,
        "",
        Outcome::Stops(Kind::Disconnected),
    );
}

#[test]
fn an_interrogator_that_says_it_is_unwell_stops_the_sweep() {
    several(
        Fault::CalibrationFault { on: true },
        "",
        Outcome::Stops(Kind::Health),
    );
    several(
        Fault::TecFault { on: true },
        "",
        Outcome::Stops(Kind::Health),
    );
    several(
        Fault::DataInvalid { on: true },
        "",
        Outcome::Stops(Kind::DataInvalid),
    );
    several(
        Fault::PeakLost {
            grating: 1,
            on: true,
        },
        "",
        Outcome::Stops(Kind::PeakLost),
    );
    several(
        Fault::PeakCrossing { on: true },
        "",
        Outcome::Stops(Kind::PeakLost),
    );
}

#[test]
fn a_frozen_camera_and_a_skewed_pair_stop_the_sweep() {
    several(
        Fault::FrozenCamera { on: true },
        CAMERAS,
        Outcome::Stops(Kind::DataInvalid),
    );
    several(
        Fault::CameraSkew { ms: 5.0 },
        CAMERAS,
        Outcome::Stops(Kind::DataInvalid),
    );
}

#[test]
fn drifts_of_the_clock_and_of_the_signal_are_warned_of() {
    several(
        Fault::ClockDrift { ppm: 20_000.0 },
        "",
        Outcome::Warns("clock drifts"),
    );
    // Past the gate of 3 pm/s, and slow enough that no peak leaves its window of 0.7 nm while the
    // sweep lasts.
    several(
        Fault::SignalDrift { pm_per_s: 8.0 },
        "",
        Outcome::Warns("did not settle"),
    );
}

/// Negative control: without a fault nothing stops and nothing is warned of, cameras included.
#[test]
fn without_a_fault_there_is_no_outcome() {
    several(Fault::PlugStage, "", Outcome::Survives);
    several(Fault::PlugStage, CAMERAS, Outcome::Survives);
}

/// A cable that stays out: the report says that the stop was not confirmed.
#[test]
fn a_stage_that_cannot_be_reached_is_reported_as_not_stopped() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let order = order(&bench, PLAN, dir.path());
    let recorded = record(
        &order,
        &mut Drivers::default(),
        &mut NoMount,
        &Interrupt::default(),
        &mut std::thread::sleep,
        &mut |p| {
            if p.step >= 4 {
                bench.inject(Fault::UnplugStage);
            }
        },
    )
    .unwrap();
    let Ending::Stopped { cause, stage } = &recorded.sweep.ending else {
        panic!("{recorded:?}")
    };
    assert_eq!(
        (cause.kind, stage.stands(), recorded.exit_code()),
        (Kind::Disconnected, false, 1)
    );
    assert!(!rows(&order.folder).rows.is_empty());
}
