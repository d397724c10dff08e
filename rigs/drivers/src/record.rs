//! One recorded sweep from rig and plan to a reduced session.

use crate::bench_files::{ZaberMount, open_interrogator, open_stage};
use crate::host::HostClock;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use wcal_core::device::{DeviceError, Stage};
use wcal_core::provenance::sha256_hex;
use wcal_session::recording::RecordingError;
use wcal_session::recording::assign::ChannelMap;
use wcal_session::recording::monitor::Monitor;
use wcal_session::recording::plan::{Plan, Step};
use wcal_session::recording::recorder::Recorder;
use wcal_session::recording::reduce::{Reduction, recordings, reduce};
use wcal_session::recording::replay::completed_steps;
use wcal_session::recording::rig::Rig;
use wcal_session::recording::run_file::{RUN_FORMAT, RunFile};
use wcal_session::recording::sweep::{Mount, Progress, SweepBench, SweepReport, acquire, run};
use wcal_session::recording::tables::temperature_ratio;
use wcal_session::write_atomic;

/// What to record and where.
#[derive(Debug, Clone)]
pub struct Order {
    /// Text of rig.toml.
    pub rig: String,
    /// Text of the plan.
    pub plan: String,
    /// Session folder; new, or with `resume` one that was begun.
    pub folder: PathBuf,
    /// Go on where an earlier run stopped.
    pub resume: bool,
    /// Search the reference where there is none.
    pub home: bool,
    /// Time of creation, RFC 3339.
    pub created: String,
    /// Command line.
    pub command: Vec<String>,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// The sweep.
    pub sweep: SweepReport,
    /// The tables; absent when nothing could be reduced.
    pub reduction: Option<Reduction>,
    /// Questions to the stage that had to be repeated.
    pub repeats: u64,
}

/// Reads rig and plan and expands the steps against the travel the rig states; moves nothing.
///
/// # Errors
/// Whatever does not fit.
pub fn plan_only(rig: &str, plan: &str) -> Result<(Rig, Plan, Vec<Step>), RecordingError> {
    let rig = Rig::parse("rig.toml", rig)?;
    let plan = Plan::parse("plan.toml", plan)?;
    let steps = plan.steps(&rig, [0.0, rig.stage.travel_mm])?;
    Ok((rig, plan, steps))
}

/// Records a sweep. `manual` presents trajectories where the rig has no motorised mount.
///
/// # Errors
/// When the devices cannot be opened, the plan does not fit, or the folder cannot be used; a fault during the sweep is
/// no error but part of the report.
pub fn record(
    order: &Order,
    manual: &mut dyn Mount,
    interrupt: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Recorded, RecordingError> {
    let (rig, plan, _) = plan_only(&order.rig, &order.plan)?;
    let skip = prepare_folder(order)?;
    let clock = HostClock::start(rig.clock_scale);
    let (mut stage, chain) = open_stage(&rig.stage, clock)?;
    let mut interrogator = open_interrogator(&rig.interrogator, clock)?;
    let mut devices = BTreeMap::from([("stage".to_owned(), stage.identity()?)]);
    devices.insert("interrogator".to_owned(), interrogator.identity()?);
    // Every position is checked against the unit's own travel before the first move.
    let steps = plan.steps(&rig, stage.travel_mm()?)?;
    let mut motor = match &chain {
        Some(chain) => ZaberMount::open(&rig.mount, std::rc::Rc::clone(chain), clock)?,
        None => None,
    };
    let mount: &mut dyn Mount = match &mut motor {
        Some(motor) => motor,
        None => manual,
    };
    let about = describe(order, &rig, &plan, devices)?;
    let number = recordings(&order.folder).len() + 1;
    let name = if number == 1 { "recording.mcap".to_owned() } else { format!("recording-{number}.mcap") };
    let recorder = Recorder::create(&order.folder.join(name), about)?;
    let monitor = Mutex::new(Monitor::new(ChannelMap::new(&rig), temperature_ratio(&rig)));
    let done = AtomicBool::new(false);
    let mut reopen = || -> Result<Box<dyn Stage>, DeviceError> { Ok(open_stage(&rig.stage, clock)?.0) };
    let sweep = std::thread::scope(|scope| {
        scope.spawn(|| acquire(interrogator.as_mut(), &monitor, &recorder, &done));
        let bench = SweepBench {
            stage,
            reopen: &mut reopen,
            mount,
            monitor: &monitor,
            recorder: &recorder,
            interrupt,
        };
        let report = run(bench, &rig, &plan, &steps, &skip, order.home, progress);
        done.store(true, Ordering::SeqCst);
        report
    });
    recorder.finish()?;
    // A sweep that stopped before its first window has nothing to reduce; the raw streams are there.
    let reduction = reduce(&order.folder).ok();
    let repeats = chain.map_or(0, |c| c.borrow().repeats());
    Ok(Recorded { sweep, reduction, repeats })
}

/// A new folder with copies of rig and plan, or an old one that has the same; steps done already.
fn prepare_folder(order: &Order) -> Result<BTreeSet<u32>, RecordingError> {
    let folder = &order.folder;
    let place = folder.display().to_string();
    let begun = folder.join("rig.toml").exists();
    if order.resume {
        for (name, text) in [("rig.toml", &order.rig), ("plan.toml", &order.plan)] {
            same(folder, name, text)?;
        }
        let mut skip = BTreeSet::new();
        for part in recordings(folder) {
            skip.extend(completed_steps(&part)?);
        }
        return Ok(skip);
    }
    if begun {
        let expected = "a new folder (or --resume)";
        return Err(RecordingError::input(place, expected, "one that holds a session"));
    }
    let io = |source| RecordingError::Io { action: "creating", path: folder.clone(), source };
    std::fs::create_dir_all(folder).map_err(io)?;
    for (name, text) in [("rig.toml", &order.rig), ("plan.toml", &order.plan)] {
        save(&folder.join(name), text)?;
    }
    Ok(BTreeSet::new())
}

/// Ports may differ between the runs of one session, plans and geometry may not.
fn same(folder: &Path, name: &str, text: &str) -> Result<(), RecordingError> {
    let path = folder.join(name);
    let io = |source| RecordingError::Io { action: "reading", path: path.clone(), source };
    let old = std::fs::read_to_string(&path).map_err(io)?;
    let bare = |t: &str| -> String {
        let keep = |l: &&str| {
            !["port ", "port=", "address ", "address=", "peaks_address"].iter().any(|k| l.starts_with(k))
        };
        t.lines().filter(keep).collect::<Vec<_>>().join("\n")
    };
    if bare(&old) == bare(text) {
        return Ok(());
    }
    Err(RecordingError::input(
        path.display().to_string(),
        "the same content as when the session was begun",
        "other content",
    ))
}

fn save(path: &Path, text: &str) -> Result<(), RecordingError> {
    write_atomic(path, text.as_bytes()).map_err(|e| RecordingError::Recorder(e.to_string()))
}

/// Writes run.json; the same facts go into the recording.
fn describe(
    order: &Order,
    rig: &Rig,
    plan: &Plan,
    devices: BTreeMap<String, wcal_core::device::DeviceIdentity>,
) -> Result<BTreeMap<String, String>, RecordingError> {
    let stamp: String = order.created.chars().filter(char::is_ascii_digit).take(14).collect();
    let run = RunFile {
        format: RUN_FORMAT.to_owned(),
        id: format!("{}-{}-{stamp}", rig.name, plan.name),
        medium: plan.medium.clone(),
        created: order.created.clone(),
        program: format!("wcal {}", env!("CARGO_PKG_VERSION")),
        command: order.command.clone(),
        rig_sha256: sha256_hex(order.rig.as_bytes()),
        plan_sha256: sha256_hex(order.plan.as_bytes()),
        devices,
        clock_scale: rig.clock_scale,
    };
    let text = serde_json::to_string_pretty(&run).map_err(|e| RecordingError::Recorder(e.to_string()))?;
    let path = order.folder.join("run.json");
    // A resumed session keeps the identity it was begun with.
    if !path.exists() {
        save(&path, &text)?;
    }
    Ok(BTreeMap::from([
        ("run".to_owned(), text),
        ("rig".to_owned(), order.rig.clone()),
        ("plan".to_owned(), order.plan.clone()),
    ]))
}
