//! Whatever goes wrong at whatever command: stage and mount stand at the end, what they were told lies within their limits, and they keep
//! their speeds. Drawn runs on the tapped bench, both protocols.

use crate::tap::{Order, Tap, TapFault};
use crate::tapped::{binary, moves, order, rig, tap};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use wcal_acquisition::record::record;
use wcal_acquisition::sweep::Ending;
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::{DeviceError, Mount};

/// One depth after a rest, as short as the windows allow.
const PLAN: &str = r#"
format = "wcal-plan/1"
name = "shortest"
[settle]
gate_pm_per_s = 1e6
window_s = 0.05
timeout_s = 0.1
[[block]]
role = "calibration"
trajectories = [1]
depths_mm = [1.0]
dwell_s = 0.05
average_s = 0.05
"#;
/// Soft limits of `rigs/virtual`, mm.
const LIMITS_MM: [f64; 2] = [0.0, 40.0];
/// Drawn runs.
const RUNS: u64 = 200;

struct Turned;

impl Mount for Turned {
    fn select(&mut self, _: u32) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// What came of a run: commands heard, how it ended, and whether its stop was confirmed.
struct Outcome {
    commands: usize,
    finished: bool,
    confirmed: bool,
    cause: String,
}

/// A run with a fault at a command, or without one.
fn run(is_binary: bool, fault: Option<(usize, TapFault)>, interrupt: &Interrupt, name: &str) -> Outcome {
    let tap: Tap =
        tap(if is_binary { "[mount]\npresent = false\n[stage]\nprotocol = \"binary\"\n" } else { "" });
    let folder = tempfile::tempdir().unwrap();
    let rig = if is_binary { binary(&rig()) } else { rig() };
    let mut request = order(&rig, folder.path());
    request.plan = PLAN.to_owned();
    let units = if is_binary { 1 } else { 2 };
    let before: Vec<i64> = (0..units).map(|k| tap.speed_data(k)).collect();
    if let Some((at, fault)) = fault {
        tap.at(at, fault);
    }
    let mut pause = |time: Duration| tap.pause(time);
    let recorded =
        record(&request, &mut tap.devices(interrupt), &mut Turned, interrupt, &mut pause, &mut |_| {});
    let cause = match &recorded {
        Ok(recorded) => format!("{:?}", recorded.sweep.ending),
        Err(e) => e.to_string(),
    };
    let (finished, confirmed) = match recorded.as_ref().map(|r| &r.sweep.ending) {
        Ok(Ending::Finished) => (true, true),
        Ok(Ending::Stopped { stage_stopped, .. }) => (false, *stage_stopped),
        // It was not opened: nothing has moved.
        Err(_) => (false, moves(&tap.commands(), 1).is_empty()),
    };
    assert!(!confirmed || !tap.is_moving(), "{name}: it moves: {recorded:?}");
    let after: Vec<i64> = (0..units).map(|k| tap.speed_data(k)).collect();
    assert_eq!(after, before, "{name}: speeds: {recorded:?}");
    let commands = tap.commands();
    for command in moves(&commands, 1) {
        let within = match command.order {
            Order::Move(mm) => (LIMITS_MM[0]..=LIMITS_MM[1]).contains(&mm),
            _ => true,
        };
        assert!(within, "{name}: {command:?}");
    }
    Outcome { commands: commands.len(), finished, confirmed, cause }
}

/// A fault by its number, for messages too.
fn fault(kind: u32, draws: &mut ChaCha8Rng, interrupt: &Interrupt) -> (&'static str, TapFault) {
    match kind {
        0 => ("stall", TapFault::Stall),
        1 => ("late reply", TapFault::LateReply),
        2 => ("lost reply", TapFault::LoseReply),
        3 => ("lost port", TapFault::LosePort(draws.random_range(0..3))),
        _ => {
            let user = interrupt.clone();
            ("Ctrl-C", TapFault::Do(Box::new(move || user.set(Signal::CtrlC))))
        }
    }
}

#[test]
fn whatever_goes_wrong_the_units_stand_within_their_limits_and_keep_their_speeds() {
    let counts = [false, true].map(|is_binary| {
        let plain = run(is_binary, None, &Interrupt::default(), "control");
        assert!(plain.finished, "control: without a fault it finishes");
        plain.commands
    });
    let start = std::time::Instant::now();
    let drawn = |seed: u64| {
        let mut draws = ChaCha8Rng::seed_from_u64(seed);
        let (is_binary, interrupt) = (seed % 2 == 1, Interrupt::default());
        let at = draws.random_range(0..counts[usize::from(is_binary)]);
        let kind = draws.random_range(0..5);
        let (word, fault) = fault(kind, &mut draws, &interrupt);
        let name = format!("seed {seed}, binary {is_binary}, {word} at command {at}");
        let found = run(is_binary, Some((at, fault)), &interrupt, &name);
        assert!(found.confirmed, "{name}: the stop is not confirmed");
        // A reply that is late or lost is asked for again.
        assert!(found.finished || !matches!(kind, 1 | 2), "{name}: it stopped: {}", found.cause);
        found.finished
    };
    let stopped: usize = std::thread::scope(|scope| {
        let halves: Vec<_> = (0..2_u64)
            .map(|half| {
                let range = half * RUNS / 2..(half + 1) * RUNS / 2;
                scope.spawn(move || range.filter(|seed| !drawn(*seed)).count())
            })
            .collect();
        halves.into_iter().map(|half| half.join().unwrap()).sum()
    });
    println!("{RUNS} runs, {stopped} stopped, {:.1} s", start.elapsed().as_secs_f64());
    assert!(stopped > RUNS as usize / 5, "control: {stopped} of {RUNS} faults stopped a sweep");
}
