//! What the units are told in a sweep, byte by byte: order of the motions, speeds put back, lost
//! ports, flags after a stall, T-series.

use crate::cantilever::Cantilever;
use crate::common::{NoMount, PLAN, rows};
use crate::tap::{Command, Order, Tap, TapFault};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use wcal_acquisition::AcquisitionError;
use wcal_acquisition::record::{RecordRequest, RecordResult, record};
use wcal_acquisition::sweep::Ending;
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::DeviceErrorKind as Kind;
use wcal_drivers::bench::scenario::Scenario;

/// Where the stage waits, mm of its own scale, by `rigs/virtual`.
const RETRACTED_MM: f64 = 18.0;
/// Half a microstep, mm.
const STEP_MM: f64 = 2.4e-5;

pub(crate) fn tap(extra: &str) -> Tap {
    let text = format!(
        "format = \"wcal-scenario/1\"\nseed = 4\n[interrogator]\nrate_hz = 500\n[cameras]\ncount = 0\n{extra}"
    );
    let scenario = Scenario::parse(&text).unwrap();
    let plant = Cantilever::of(&scenario);
    Tap::new(scenario, plant)
}

/// The rig of `rigs/virtual` without cameras; its ports are not looked at.
pub(crate) fn rig() -> String {
    let text = include_str!("../../../virtual/rig.toml");
    let text = text.split("[[camera]]").next().unwrap();
    // Each test has a stage of its own.
    static NUMBER: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(0);
    let number = NUMBER.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
    text.replace(
        "tcp://127.0.0.1:PORT",
        &format!("tcp://tap:{}-{number}", std::process::id()),
    )
    .replace("clock_scale = 4.0", "clock_scale = 1.0")
    .replace("rate_hz = 2000.0", "rate_hz = 500.0")
}

/// The same rig with a binary stage, whose mount is turned by hand.
pub(crate) fn binary(rig: &str) -> String {
    let (head, rest) = rig.split_once("[mount]").unwrap();
    let (_, rest) = rest.split_once("[interrogator]").unwrap();
    format!("{head}[interrogator]{rest}").replace("zaber-ascii", "zaber-binary")
}

pub(crate) fn order(rig: &str, folder: &Path) -> RecordRequest {
    RecordRequest {
        rig: rig.to_owned(),
        plan: PLAN.to_owned(),
        places: ["rig.toml", "plan.toml"].map(str::to_owned),
        folder: folder.join("session"),
        resume: false,
        home: true,
        created: "2026-01-02T03:04:05Z".to_owned(),
        command: vec!["test".to_owned()],
    }
}

fn go(
    tap: &Tap,
    order: &RecordRequest,
    interrupt: &Interrupt,
) -> Result<RecordResult, AcquisitionError> {
    let mut pause = |time: Duration| tap.pause(time);
    record(
        order,
        &mut tap.devices(interrupt),
        &mut NoMount,
        interrupt,
        &mut pause,
        &mut |_| {},
    )
}

fn finished(recorded: &RecordResult) {
    assert_eq!(
        recorded.sweep.ending,
        Ending::Finished,
        "{:?}",
        recorded.warnings()
    );
    assert_eq!(recorded.exit_code(), 0, "{:?}", recorded.warnings());
}

pub(crate) fn moves(commands: &[Command], unit: u8) -> Vec<&Command> {
    let motion = |c: &&Command| c.unit == unit && matches!(c.order, Order::Home | Order::Move(_));
    commands.iter().filter(motion).collect()
}

/// Speeds of stage and mount.
fn speeds(tap: &Tap) -> [i64; 2] {
    [0, 1].map(|index| tap.speed_data(index))
}

#[test]
fn the_mount_moves_only_where_the_stage_is_retracted() {
    let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
    let start_mm = tap.stage_mm();
    finished(&go(&tap, &order(&rig(), folder.path()), &Interrupt::default()).unwrap());
    assert!(!tap.is_moving());
    let commands = tap.commands();
    let of_mount = moves(&commands, 2);
    assert_eq!(
        of_mount.first().unwrap().order,
        Order::Home,
        "it had no reference"
    );
    assert_eq!(
        of_mount.len(),
        4,
        "one for the sync move, and two trajectories"
    );
    for command in of_mount {
        assert!(
            (command.stage_mm - RETRACTED_MM).abs() < STEP_MM && !command.stage_moves,
            "{command:?}"
        );
    }
    // Control: the tap sees where the stage is.
    let first = moves(&commands, 1)[0];
    assert!(
        first.order == Order::Home && (first.stage_mm - start_mm).abs() < STEP_MM,
        "{first:?}"
    );
    let [low_mm, high_mm] = [0.0, 40.0];
    let within = |c: &&Command| matches!(c.order, Order::Move(mm) if mm < low_mm || mm > high_mm);
    assert!(!moves(&commands, 1).iter().any(within), "soft limits");
}

#[test]
fn without_home_nothing_moves_and_nothing_is_created() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |tap: &Tap, device: &str| {
        let mut order = order(&rig(), folder.path());
        order.home = false;
        let why = go(tap, &order, &Interrupt::default())
            .unwrap_err()
            .to_string();
        assert!(
            why.starts_with(device) && why.contains("`--home` searches the reference"),
            "{why}"
        );
        assert!(moves(&tap.commands(), 1).is_empty() && moves(&tap.commands(), 2).is_empty());
        assert!(!order.folder.exists(), "{why}");
    };
    refused(&tap(""), "stage");
    // The stage has a reference, the mount has none.
    refused(&tap("[stage.unit]\nhomed = true\n"), "mount");
}

#[test]
fn a_mount_that_stands_elsewhere_stops_the_sweep() {
    for elsewhere in [true, false] {
        let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
        // A run without a fault tells which command turns the mount, and is the same up to there.
        let plain = self::tap("");
        finished(
            &go(
                &plain,
                &order(&rig(), &folder.path().join("a")),
                &Interrupt::default(),
            )
            .unwrap(),
        );
        let turn = |c: &Command| c.unit == 2 && matches!(c.order, Order::Move(_));
        let turned = plain.commands().iter().position(turn).unwrap();
        let bench = tap.bench().clone();
        let push = move || {
            let t_s = bench.state().clock.now_s();
            let axis = &mut bench.state().world().units[1].axis;
            let steps = axis.steps(t_s);
            axis.move_to(t_s, if elsewhere { steps + 300 } else { 10_000 }, None)
                .unwrap();
        };
        // While it turns.
        tap.at(turned + 1, TapFault::Do(Box::new(push)));
        let recorded = go(
            &tap,
            &order(&rig(), &folder.path().join("b")),
            &Interrupt::default(),
        )
        .unwrap();
        match (&recorded.sweep.ending, elsewhere) {
            (Ending::Stopped { cause, .. }, true) => {
                let said = cause.to_string();
                assert!(
                    said.starts_with("mount: turn to trajectory 1: expected 1.0000 mm, found"),
                    "{said}"
                );
            }
            (Ending::Finished, false) => {}
            (other, _) => panic!("{other:?}"),
        }
    }
}

#[test]
fn the_units_keep_the_speeds_that_they_had() {
    let interrupt = Interrupt::default();
    let count = {
        let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
        let before = speeds(&tap);
        finished(&go(&tap, &order(&rig(), folder.path()), &interrupt).unwrap());
        assert_eq!(speeds(&tap), before, "finished");
        let set = |c: &&Command| c.bytes.windows(12).any(|w| w == b"set maxspeed");
        assert!(
            tap.commands().iter().filter(set).count() > 4,
            "control: the sweep has changed them"
        );
        tap.commands().len()
    };
    // A stop by the user, and a port that is lost and found, in mid sweep.
    for lost in [false, true] {
        let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
        let before = speeds(&tap);
        let user = interrupt.clone();
        let fault = match lost {
            true => TapFault::LosePort(2),
            false => TapFault::Do(Box::new(move || user.set(Signal::CtrlC))),
        };
        tap.at(count / 2, fault);
        let recorded = go(&tap, &order(&rig(), folder.path()), &interrupt).unwrap();
        let Ending::Stopped { cause, stage } = &recorded.sweep.ending else {
            panic!("{recorded:?}")
        };
        assert_eq!(
            cause.kind,
            if lost {
                Kind::Disconnected
            } else {
                Kind::Interrupted
            },
            "{cause}"
        );
        assert!(stage.stands() && !tap.is_moving(), "{cause}");
        assert_eq!(speeds(&tap), before, "{cause}");
    }
}

/// The unit keeps FS until somebody says that he has looked.
#[test]
fn after_a_stall_the_message_says_what_to_do_and_home_and_resume_do_it() {
    let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
    let mut order = order(&rig(), folder.path());
    // In a move of the stage after the first rows.
    let plain = self::tap("");
    finished(
        &go(
            &plain,
            &self::order(&rig(), &folder.path().join("plain")),
            &Interrupt::default(),
        )
        .unwrap(),
    );
    let commands = plain.commands();
    let last = commands
        .iter()
        .rposition(|c| matches!(c.order, Order::Move(mm) if mm > 20.0))
        .unwrap();
    tap.at(last, TapFault::Stall);
    let stopped = go(&tap, &order, &Interrupt::default()).unwrap();
    let Ending::Stopped { cause, .. } = &stopped.sweep.ending else {
        panic!("{stopped:?}")
    };
    assert_eq!(cause.kind, Kind::Stalled, "{cause}");
    let told = tap.commands().len();
    let refused = |order: &RecordRequest| {
        let why = go(&tap, order, &Interrupt::default())
            .unwrap_err()
            .to_string();
        assert!(
            why.contains("FS: stalled and stopped")
                && why.contains("then `--home --resume SESSION` clears"),
            "{why}"
        );
        assert!(
            !tap.commands()[told..]
                .iter()
                .any(|c| c.bytes.ends_with(b"clear")),
            "{why}"
        );
    };
    order.resume = true;
    order.home = false;
    refused(&order);
    // A new session with `--home` does not take back what it did not see.
    refused(&RecordRequest {
        resume: false,
        home: true,
        folder: folder.path().join("new"),
        ..order.clone()
    });
    assert!(
        moves(&tap.commands()[told..], 1).is_empty()
            && moves(&tap.commands()[told..], 2).is_empty()
    );
    order.home = true;
    finished(&go(&tap, &order, &Interrupt::default()).unwrap());
    let commands = tap.commands().split_off(told);
    assert_eq!(
        moves(&commands, 1)[0].order,
        Order::Home,
        "the reference is searched anew"
    );
    assert_eq!(rows(&order.folder).rows.len(), 6);
}

#[test]
fn a_binary_stage_is_homed_and_runs_a_whole_sweep() {
    let scenario = "[mount]\npresent = false\n[stage]\nprotocol = \"binary\"\n";
    let (tap, folder) = (tap(scenario), tempfile::tempdir().unwrap());
    let mut order = order(&binary(&rig()), folder.path());
    order.plan = PLAN.replace("trajectories = [1, 5]", "trajectories = [1]");
    struct ByHand(Arc<Mutex<usize>>);
    impl wcal_core::device::Mount for ByHand {
        fn select(&mut self, _: u32) -> Result<(), wcal_core::device::DeviceError> {
            *self.0.lock().unwrap() += 1;
            Ok(())
        }
    }
    let turned = Arc::new(Mutex::new(0));
    let go = |order: &RecordRequest| {
        let mut pause = |time: Duration| tap.pause(time);
        let never = Interrupt::default();
        record(
            order,
            &mut tap.devices(&never),
            &mut ByHand(turned.clone()),
            &never,
            &mut pause,
            &mut |_| {},
        )
    };
    let before = tap.speed_data(0);
    let unhomed = RecordRequest {
        home: false,
        ..order.clone()
    };
    let why = go(&unhomed).unwrap_err().to_string();
    assert!(
        why.contains("`--home` searches it") && !order.folder.exists(),
        "{why}"
    );
    assert!(moves(&tap.commands(), 1).is_empty());
    finished(&go(&order).unwrap());
    let commands = tap.commands();
    assert_eq!(moves(&commands, 1)[0].order, Order::Home);
    assert_eq!(
        (rows(&order.folder).rows.len(), *turned.lock().unwrap()),
        (3, 2),
        "once for the sync move"
    );
    assert!(!tap.is_moving() && tap.speed_data(0) == before);
    // It says that it has been homed: the next sweep needs no `--home`.
    let told = commands.len();
    order.folder = folder.path().join("again");
    order.home = false;
    finished(&go(&order).unwrap());
    assert!(
        !moves(&tap.commands()[told..], 1)
            .iter()
            .any(|c| c.order == Order::Home)
    );
}

/// A microstep size that is wrong by 0.2 % scales every position by as much.
#[test]
fn a_travel_that_is_not_the_stated_one_is_refused() {
    for (from, to, device) in [
        (
            "microstep_um = 0.047625",
            "microstep_um = 0.04772025",
            Some("stage"),
        ),
        (
            "microstep_um = 0.047625",
            "microstep_um = 0.04752975",
            Some("stage"),
        ),
        ("travel_mm = 1000.0", "travel_mm = 1002.0", Some("mount")),
        ("microstep_um = 0.1", "microstep_um = 0.0998", Some("mount")),
        ("microstep_um = 0.047625", "microstep_um = 0.0476726", None),
        ("microstep_um = 0.1", "microstep_um = 0.1", None),
    ] {
        let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
        let rig = rig();
        assert!(rig.contains(from), "{from}");
        let rig = rig.replace(from, to);
        let done = go(&tap, &order(&rig, folder.path()), &Interrupt::default());
        match device {
            Some(device) => {
                let why = done.unwrap_err().to_string();
                assert!(
                    why.starts_with(device) && why.contains("expected the rig's travel of"),
                    "{why}"
                );
                assert!(
                    moves(&tap.commands(), 1).is_empty() && moves(&tap.commands(), 2).is_empty()
                );
            }
            None => finished(&done.unwrap()),
        }
    }
}

/// A trajectory past the mount's travel is refused before anything moves.
#[test]
fn a_trajectory_past_the_mounts_travel_is_refused() {
    let (tap, folder) = (tap(""), tempfile::tempdir().unwrap());
    let rig = rig().replace(
        "steps_per_trajectory = 10000",
        "steps_per_trajectory = 10000000",
    );
    let why = go(&tap, &order(&rig, folder.path()), &Interrupt::default())
        .unwrap_err()
        .to_string();
    assert!(
        why.starts_with("mount: turn to trajectory 5: expected a target in 0.000..1000.000 mm"),
        "{why}"
    );
    assert!(moves(&tap.commands(), 1).is_empty());
}
