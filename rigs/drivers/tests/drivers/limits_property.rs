//! Random rigs, plans and faults, held against the bytes that the virtual units hear: no command
//! moves the stage past a limit, no run ends with the stage moving or a stop unconfirmed, and the
//! units keep the speeds that they had. Each run is its number's: `WCAL_PROPERTY_FIRST` and
//! `WCAL_PROPERTY_RUNS` say which.

use crate::cantilever::Cantilever;
use crate::common::{Disk, NoMount};
use crate::tap::{Order, Tap, TapFault};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Duration;
use wcal_acquisition::record::{RecordRequest, RecordResult, record};
use wcal_acquisition::sweep::{Ending, StageEnd};
use wcal_core::deadline::{Interrupt, Signal};
use wcal_drivers::bench::scenario::Scenario;

/// Half a microstep: what rounding may add, mm.
const STEP_MM: f64 = 2.4e-5;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    Nothing,
    Stall,
    LateReply,
    LoseReply,
    LosePort(usize),
    CtrlC,
    Panic,
    FullDisk,
}

/// What a run is made of.
#[derive(Debug, Clone)]
struct Case {
    rig: String,
    plan: String,
    binary: bool,
    limits_mm: [f64; 2],
    trouble: Trouble,
    /// Which command of the run it comes at, as a share of those of a run without trouble.
    at: f64,
}

fn draw(number: u64) -> Case {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let mut between = |low: f64, high: f64| (random.random_range(low..high) * 1e3).round() / 1e3;
    // Limits that sometimes leave no room for a sync move, an approach, or the plan itself.
    let zero = between(5.0, 60.0);
    let limits_mm = [
        (zero - between(2.5, 5.0)).max(0.0),
        zero + between(0.2, 6.0),
    ];
    let (retract, approach) = (-between(0.1, 3.0), between(0.01, 3.0));
    let speed = between(2.0, 20.0);
    let depths: Vec<f64> = (0..(between(1.0, 4.0) as usize))
        .map(|_| between(0.05, 2.5))
        .collect();
    let sided = ["direct", "one-sided"][usize::from(between(0.0, 1.0) < 0.5)];
    let binary = between(0.0, 1.0) < 0.3;
    let text = include_str!("../../../virtual/rig.toml");
    let rig = text
        .split("[[camera]]")
        .next()
        .unwrap()
        .replace(
            "tcp://127.0.0.1:PORT",
            &format!("tcp://property:{}-{number}", std::process::id()),
        )
        .replace("clock_scale = 4.0", "clock_scale = 1.0")
        .replace("rate_hz = 2000.0", "rate_hz = 100.0")
        .replace(
            "soft_limits_mm = [0.0, 40.0]",
            &format!("soft_limits_mm = {limits_mm:?}"),
        )
        .replace("zero_mm = 20.0", &format!("zero_mm = {zero:?}"))
        .replace("speed_mm_s = 8.0", &format!("speed_mm_s = {speed:?}"))
        .replace(
            "approach = \"direct\"",
            &format!("approach = \"{sided}\"\napproach_mm = {approach:?}"),
        )
        .replace("retract_mm = -2.0", &format!("retract_mm = {retract:?}"));
    let rig = if binary { without_mount(&rig) } else { rig };
    let flag = |on: bool, line: &str| {
        if on {
            format!("{line}\n")
        } else {
            String::new()
        }
    };
    let (sync, back, fly) = (
        between(0.0, 1.0) < 0.7,
        between(0.0, 1.0) < 0.5,
        between(0.0, 1.0) < 0.3,
    );
    let plan = format!(
        "format = \"wcal-plan/1\"\nname = \"p\"\nsync_move = {sync}\n[settle]\ngate_pm_per_s = 1e6\nwindow_s = 0.05\ntimeout_s = 0.2\n\
         [[block]]\nrole = \"calibration\"\ntrajectories = [1]\ndepths_mm = {depths:?}\ndwell_s = 0.05\naverage_s = 0.1\n{}{}",
        flag(back, "unloading = true"),
        flag(fly, "on_the_fly_hz = 20")
    );
    let at = between(0.0, 1.0);
    let trouble = match between(0.0, 8.0) as usize {
        0 => Trouble::Nothing,
        1 => Trouble::Stall,
        2 => Trouble::LateReply,
        3 => Trouble::LoseReply,
        4 => Trouble::LosePort(between(0.0, 4.0) as usize),
        5 => Trouble::CtrlC,
        6 => Trouble::Panic,
        _ => Trouble::FullDisk,
    };
    Case {
        rig,
        plan,
        binary,
        limits_mm,
        trouble,
        at,
    }
}

/// A T-series stage has the port to itself.
fn without_mount(rig: &str) -> String {
    let (head, rest) = rig.split_once("[mount]").unwrap();
    let (_, rest) = rest.split_once("[interrogator]").unwrap();
    format!("{head}[mount]\nkind = \"manual\"\n[interrogator]{rest}")
        .replace("zaber-ascii", "zaber-binary")
}

struct ByHand;

impl wcal_core::device::Mount for ByHand {
    fn select(&mut self, _: u32) -> Result<(), wcal_core::device::DeviceError> {
        Ok(())
    }
}

fn tap(case: &Case) -> Tap {
    let binary = if case.binary {
        "[mount]\npresent = false\n[stage]\nprotocol = \"binary\"\n"
    } else {
        ""
    };
    let text = format!(
        "format = \"wcal-scenario/1\"\nseed = 4\n[interrogator]\nrate_hz = 100\n[cameras]\ncount = 0\n{binary}"
    );
    let scenario = Scenario::parse(&text).unwrap();
    let plant = Cantilever::of(&scenario);
    Tap::new(scenario, plant)
}

/// Speeds that the units were given.
fn speeds(case: &Case, tap: &Tap) -> Vec<i64> {
    (0..if case.binary { 1 } else { 2 })
        .map(|unit| tap.speed_data(unit))
        .collect()
}

fn run(
    case: &Case,
    tap: &Tap,
    folder: &Path,
    interrupt: &Interrupt,
) -> Result<RecordResult, String> {
    let request = RecordRequest {
        rig: case.rig.clone(),
        plan: case.plan.clone(),
        places: ["rig.toml", "plan.toml"].map(str::to_owned),
        folder: folder.to_owned(),
        resume: false,
        home: true,
        created: "2026-01-02T03:04:05Z".to_owned(),
        command: vec!["test".to_owned()],
    };
    let mut pause = |time: Duration| tap.pause(time);
    let mut devices = tap.devices(interrupt);
    let done = catch_unwind(AssertUnwindSafe(|| match case.binary {
        true => record(
            &request,
            &mut devices,
            &mut ByHand,
            interrupt,
            &mut pause,
            &mut |_| {},
        ),
        false => record(
            &request,
            &mut devices,
            &mut NoMount,
            interrupt,
            &mut pause,
            &mut |_| {},
        ),
    }));
    match done {
        Ok(recorded) => recorded.map_err(|e| e.to_string()),
        Err(_) => Err("a panic".to_owned()),
    }
}

/// The first wrong thing of a run: a command past a limit, a stage that moves or a stop that is not
/// confirmed at the end, another speed.
fn wrong(case: &Case, tap: &Tap, result: &Result<RecordResult, String>) -> Option<String> {
    let [low, high] = case.limits_mm;
    let past = |mm: f64| !(low - STEP_MM..=high + STEP_MM).contains(&mm);
    let stage = tap.commands().into_iter().filter(|c| c.unit == 1);
    let moves = stage
        .filter(|c| matches!(c.order, Order::Move(_)))
        .collect::<Vec<_>>();
    if let Some(c) = moves
        .iter()
        .find(|c| matches!(c.order, Order::Move(mm) if past(mm)))
    {
        return Some(format!("{c:?}, limits {low}..{high}"));
    }
    if tap.is_moving() {
        return Some(format!("the stage moves at the end of {result:?}"));
    }
    if let Ok(RecordResult { sweep, .. }) = result
        && matches!(sweep.ending, Ending::Stopped { stage, .. } if !stage.stands())
    {
        return Some(format!("the stop is not confirmed: {result:?}"));
    }
    // Nothing is wrong with the stage: the wire is left free, unless its reference was still being
    // searched.
    if let (Trouble::FullDisk, Ok(RecordResult { sweep, .. })) = (case.trouble, result)
        && !moves.is_empty()
        && matches!(&sweep.ending, Ending::Stopped { stage, cause } if cause.device == "recorder" && *stage != StageEnd::Retracted)
    {
        return Some(format!("pressed on: {result:?}"));
    }
    let before = speeds(case, &self::tap(case));
    (speeds(case, tap) != before).then(|| format!("speeds {:?} for {before:?}", speeds(case, tap)))
}

#[test]
fn no_byte_moves_the_stage_past_a_limit_and_no_run_ends_with_it_moving() {
    let asked = |name: &str| std::env::var(name).ok().map(|n| n.parse::<u64>().unwrap());
    let (first, runs) = (
        asked("WCAL_PROPERTY_FIRST").unwrap_or(0),
        asked("WCAL_PROPERTY_RUNS").unwrap_or(200),
    );
    let (large, small) = (Disk::of("64m"), Disk::of("150k"));
    // What is drawn on purpose panics: the hook would print each.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let mut counts = std::collections::BTreeMap::<String, usize>::new();
    let mut failures = Vec::new();
    for number in first..first + runs {
        let case = draw(number);
        let folder = match case.trouble {
            Trouble::FullDisk => small.path().join("s"),
            _ => large.path().join("s"),
        };
        let (tap, interrupt) = (tap(&case), Interrupt::default());
        // Opening and homing are some dozen commands, a short plan some hundreds.
        let at = (case.at * 300.0) as usize;
        let user = interrupt.clone();
        match case.trouble {
            Trouble::Nothing | Trouble::FullDisk => {}
            Trouble::Stall => tap.at(at, TapFault::Stall),
            Trouble::LateReply => tap.at(at, TapFault::LateReply),
            Trouble::LoseReply => tap.at(at, TapFault::LoseReply),
            Trouble::LosePort(refusals) => tap.at(at, TapFault::LosePort(refusals)),
            Trouble::CtrlC => tap.at(at, TapFault::Do(Box::new(move || user.set(Signal::CtrlC)))),
            Trouble::Panic => tap.at(at, TapFault::Do(Box::new(|| panic!("on purpose")))),
        }
        let result = run(&case, &tap, &folder, &interrupt);
        let word = match &result {
            Ok(recorded) if recorded.sweep.ending == Ending::Finished => "finished",
            Ok(_) => "stopped",
            Err(why) if why == "a panic" => "panicked",
            Err(_) => "refused",
        };
        let name = format!("{:?}", case.trouble);
        let name = name.split('(').next().unwrap_or_default();
        *counts.entry(format!("{name} {word}")).or_default() += 1;
        failures.extend(
            wrong(&case, &tap, &result)
                .map(|what| format!("run {number}, {:?}: {what}", case.trouble)),
        );
        // A refusal leaves nothing.
        let _ = std::fs::remove_dir_all(&folder);
    }
    std::panic::set_hook(hook);
    println!("{runs} runs: {counts:?}");
    assert!(
        failures.is_empty(),
        "{} of {runs}: {}",
        failures.len(),
        failures.join("\n")
    );
    // Controls: every kind of end was met.
    for met in [
        "Nothing finished",
        "Nothing refused",
        "Stall stopped",
        "CtrlC stopped",
        "LosePort stopped",
        "Panic panicked",
        "FullDisk stopped",
    ] {
        assert!(counts.get(met).is_some_and(|n| *n > 0), "{met}: {counts:?}");
    }
}

/// Control of the check itself: a narrower limit than the rig's is seen to be passed.
#[test]
fn a_move_past_a_limit_would_be_seen() {
    let dir = tempfile::tempdir().unwrap();
    let case = (0..).map(draw).find(|c| {
        let free = Case {
            trouble: Trouble::Nothing,
            ..c.clone()
        };
        let tap = tap(&free);
        let result = run(&free, &tap, &dir.path().join("s"), &Interrupt::default());
        let finished = result.is_ok_and(|r| r.sweep.ending == Ending::Finished);
        let _ = std::fs::remove_dir_all(dir.path().join("s"));
        finished
    });
    let case = case.unwrap();
    let tap = tap(&case);
    let result = run(&case, &tap, &dir.path().join("s"), &Interrupt::default());
    assert_eq!(wrong(&case, &tap, &result), None);
    let middle = (case.limits_mm[0] + case.limits_mm[1]) / 2.0;
    let narrow = Case {
        limits_mm: [middle - 1e-3, middle],
        ..case
    };
    assert!(wrong(&narrow, &tap, &result).is_some_and(|what| what.contains("Move")));
}
