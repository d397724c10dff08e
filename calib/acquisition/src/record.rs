//! One recorded sweep from rig and plan to a reduced session.

use crate::AcquisitionError;
use crate::assign::ChannelMap;
use crate::camera_pair::CameraPair;
use crate::camera_watch::watch;
use crate::limits::{LimitedStage, Limits};
use crate::message::Refused;
use crate::monitor::Monitor;
use crate::plan::{Plan, Step};
use crate::recorder::Recorder;
use crate::reduce::{Reduction, recordings, reduce};
use crate::reference::check;
use crate::replay_interrogator::ReplayInterrogator;
use crate::rig::Rig;
use crate::run_file::{RUN_FORMAT, RunFile, RunOutcome};
use crate::session_begin::{OwnedSessionFolder, stage_lock};
pub use crate::session_begin::{RecordRequest, is_finished};
use crate::steps::disk;
use crate::sweep::{Ending, Progress, StageEnd, SweepBench, SweepReport, acquire, run};
use crate::tables::temperature_ratio;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::{DeviceError, DeviceIdentity, Interrogator, Mount, Permission};
use wcal_core::files::write_atomic;
use wcal_core::provenance::sha256_hex;
use wcal_core::rig_devices::{DeviceOpener, InterrogatorDriver, InterrogatorRig};

/// What came of it.
#[derive(Debug)]
pub struct RecordResult {
    /// The sweep.
    pub sweep: SweepReport,
    /// The tables, or why there are none: a sweep that stopped before its first window has nothing
    /// to reduce.
    pub reduction: Result<Reduction, AcquisitionError>,
    /// Questions to the stage that had to be repeated.
    pub repeats: u64,
    /// Whether the devices were simulated.
    pub simulated: bool,
    /// Messages that the recorder left out.
    pub refused: Refused,
}

impl RecordResult {
    /// What was lost or is not as it should be; each is a reason for exit code 3.
    pub fn warnings(&self) -> Vec<String> {
        let of_sweep = match &self.reduction {
            // The tables contain every run of the session, the sweep its own only.
            Ok(reduction) => [reduction.stream_warnings(), self.sweep.signal_warnings()].concat(),
            Err(_) => self.sweep.warnings(),
        };
        self.refused.text().into_iter().chain(of_sweep).collect()
    }

    /// 0 good, 1 stopped or without tables, 3 finished with warnings, 128 and its number ended by a
    /// signal.
    pub fn exit_code(&self) -> u8 {
        match &self.sweep.ending {
            Ending::Stopped { cause, .. } => Signal::of(cause).map_or(1, Signal::exit_code),
            Ending::Finished if self.reduction.is_err() => 1,
            Ending::Finished if self.warnings().is_empty() => 0,
            Ending::Finished => 3,
        }
    }
}

/// Reads rig and plan (place and text) and expands the steps against the travel the rig states;
/// moves nothing.
///
/// # Errors
/// Whatever does not fit.
pub fn plan_only(
    rig: (&str, &str),
    plan: (&str, &str),
) -> Result<(Rig, Plan, Vec<Step>), AcquisitionError> {
    let (rig, plan) = (Rig::parse(rig.0, rig.1)?, Plan::parse(plan.0, plan.1)?);
    let steps = plan.steps(&rig, [0.0, rig.stage.travel_mm])?;
    Ok((rig, plan, steps))
}

/// Opens the interrogator of a rig; with the driver `replay` that is a recording.
///
/// # Errors
/// As [`DeviceOpener::interrogator`], or when the recording cannot be read.
pub fn open_interrogator(
    devices: &mut dyn DeviceOpener,
    rig: &InterrogatorRig,
    clock: HostClock,
) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
    match rig.driver {
        InterrogatorDriver::Replay => {
            Ok(Box::new(ReplayInterrogator::open(Path::new(&rig.address))?))
        }
        _ => devices.interrogator(rig, clock),
    }
}

/// Opens the camera pair of a rig, if it has one.
fn open_cameras(
    devices: &mut dyn DeviceOpener,
    rig: &Rig,
    clock: HostClock,
) -> Result<Option<CameraPair>, DeviceError> {
    let [first, second] = rig.camera.as_slice() else {
        return Ok(None);
    };
    let cameras = [
        devices.camera(first, clock)?,
        devices.camera(second, clock)?,
    ];
    let alone = rig.camera.iter().any(|c| c.driver.counts_alone());
    let pair = if alone {
        CameraPair::by_time
    } else {
        CameraPair::new
    };
    Ok(Some(pair(cameras, rig.camera_skew_limit_ms)))
}

/// Records a sweep on the rig's devices. `manual` presents trajectories where the rig has no
/// motorised mount; `pause` waits between two looks at the devices (`std::thread::sleep`, but for a
/// bench in this process).
///
/// # Errors
/// When the devices cannot be opened, the plan does not fit, or the folder cannot be used; a fault
/// during the sweep is no error but part of the report.
pub fn record(
    request: &RecordRequest,
    devices: &mut dyn DeviceOpener,
    manual: &mut dyn Mount,
    interrupt: &Interrupt,
    pause: &mut dyn FnMut(Duration),
    progress: &mut dyn FnMut(&Progress),
) -> Result<RecordResult, AcquisitionError> {
    let (rig, plan, _) = plan_only(
        (&request.places[0], &request.rig),
        (&request.places[1], &request.plan),
    )?;
    let (mut begun, skip) = OwnedSessionFolder::open(request)?;
    // Before the first byte on its line: another sweep may be driving this stage.
    let _lock = stage_lock(&rig.stage, &request.folder)?;
    // One host clock for all devices: their times are compared by it.
    let clock = HostClock::start(rig.clock_scale);
    let mut stage = devices.stage(&rig.stage, clock)?;
    let mut interrogator = open_interrogator(devices, &rig.interrogator, clock)?;
    let mut identities = BTreeMap::from([("stage".to_owned(), stage.identity()?)]);
    identities.insert("interrogator".to_owned(), interrogator.identity()?);
    let mut cameras = open_cameras(devices, &rig, clock)?;
    let names: [String; 2] = std::array::from_fn(|k| {
        rig.camera
            .get(k)
            .map_or_else(String::new, |c| c.name.clone())
    });
    if let Some(pair) = &mut cameras {
        let own = names.iter().cloned().zip(pair.identities()?);
        identities.extend(own.map(|(name, identity)| (format!("camera_{name}"), identity)));
    }
    // Every position is checked against the unit's own travel before the first move, and again when
    // it is commanded.
    let travel_mm = stage.travel_mm()?;
    let steps = plan.steps(&rig, travel_mm)?;
    let limits = Limits::new(&rig.stage, travel_mm);
    let mut motor = devices.mount(&rig.mount, clock)?;
    let mount: &mut dyn Mount = match &mut motor {
        Some(motor) => motor.as_mut(),
        None => manual,
    };
    let allowed = Permission {
        // After a stall the stage may count from where it is not: flags go only with a new search.
        home: request.home,
        clear_flags: request.home && request.resume,
    };
    // What forbids the first move is found out while nothing has moved and nothing is recorded.
    check(stage.as_mut(), mount, &steps, allowed)?;
    let (about, simulated) = describe(request, &rig, &plan, identities, &mut begun)?;
    let earlier = recordings(&request.folder);
    let number = earlier.len() + 1;
    // What an earlier run recorded is never written to again.
    let name = if number == 1 {
        "recording.mcap".to_owned()
    } else {
        format!("recording-{number}.mcap")
    };
    begun.reserve(tables_bytes(&steps))?;
    let recorder = Recorder::create(&begun.makes(&name), about)?;
    // Everything is open: from here on there is something to keep.
    begun.keep();
    let monitor = Mutex::new(Monitor::new(
        ChannelMap::new(&rig),
        temperature_ratio(&rig),
        rig.clock_scale,
    ));
    let done = AtomicBool::new(false);
    // A stage that is opened again stands behind the same limits.
    let mut reopen = || Ok(LimitedStage::new(devices.stage(&rig.stage, clock)?, limits));
    let mut sweep = std::thread::scope(|scope| {
        // Whoever leaves this block, by a panic too, ends the threads that record.
        let ended = SetOnDrop(&done);
        let reader = scope.spawn(|| acquire(interrogator.as_mut(), &monitor, &recorder, &done));
        let watcher = cameras.as_mut().map(|pair| {
            let (names, monitor, recorder, done, rig) = (&names, &monitor, &recorder, &done, &rig);
            scope.spawn(move || watch(pair, names, monitor, recorder, done, rig.clock_scale))
        });
        let bench = SweepBench {
            stage: LimitedStage::new(stage, limits),
            reopen: &mut reopen,
            mount,
            monitor: &monitor,
            recorder: &recorder,
            interrupt,
            pause,
        };
        let report = run(bench, &rig, &plan, &steps, &skip, allowed, progress);
        // Only now: the way to a safe state is recorded, too.
        drop(ended);
        // A thread that panicked has been a fault of the sweep: what was recorded is kept.
        for thread in std::iter::once(reader).chain(watcher) {
            let _ = thread.join();
        }
        report
    });
    // Scans that came while the last step ended are in the recording as well.
    sweep.counts = monitor
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner)
        .counts();
    let refused = recorder.refused();
    // The stage is safe by now, but a recording that was not closed is no finished sweep.
    if let (Err(e), Ending::Finished) = (recorder.finish(), &sweep.ending) {
        sweep.ending = Ending::Stopped {
            cause: disk(&e),
            stage: StageEnd::Retracted,
        };
    }
    begun.release();
    let reduction = reduce(&request.folder);
    let mut recorded = RecordResult {
        sweep,
        reduction,
        repeats: devices.repeats(),
        simulated,
        refused,
    };
    if let Err(e) = add_outcome(&request.folder, name, &recorded) {
        recorded.reduction = Err(e);
    }
    Ok(recorded)
}

/// Sets a flag when it goes.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Space that the tables of a session need at most, bytes: about a kilobyte a row in all of them.
fn tables_bytes(steps: &[Step]) -> u64 {
    let rows = |step: &Step| match step {
        Step::Settled(_) => 1.0,
        Step::Moving {
            from_mm,
            rows_hz,
            pose,
        } => (rows_hz * (pose.stage_mm - from_mm).abs() / pose.speed_mm_s).ceil(),
        Step::Soak | Step::Sync { .. } | Step::Mount { .. } => 0.0,
    };
    64 * 1024 + 1024 * steps.iter().map(rows).sum::<f64>().min(1e6) as u64
}

/// Adds to run.json what came of this run.
fn add_outcome(
    folder: &Path,
    recording: String,
    recorded: &RecordResult,
) -> Result<(), AcquisitionError> {
    let path = folder.join("run.json");
    let mut run = RunFile::read(&path)?;
    let (ending, cause) = match &recorded.sweep.ending {
        Ending::Finished => ("finished", None),
        Ending::Stopped { cause, .. } => ("stopped", Some(cause.to_string())),
    };
    run.runs.push(RunOutcome {
        recording,
        ending: ending.to_owned(),
        cause,
        scans: recorded.sweep.counts.scans,
        lost_scans: recorded.sweep.counts.lost,
        warnings: recorded.warnings(),
    });
    Ok(write_atomic(&path, as_text(&run)?.as_bytes())?)
}

fn as_text(run: &RunFile) -> Result<String, AcquisitionError> {
    serde_json::to_string_pretty(run).map_err(|e| AcquisitionError::Recorder(e.to_string()))
}

/// Rig, plan and time of creation, to the fraction of a second that it states.
fn session_id(rig: &str, plan: &str, created: &str) -> String {
    let stamp: String = created.chars().filter(char::is_ascii_digit).collect();
    format!("{rig}-{plan}-{stamp}")
}

/// Writes run.json; the same facts go into the recording. Says whether the devices are simulated,
/// too.
fn describe(
    request: &RecordRequest,
    rig: &Rig,
    plan: &Plan,
    devices: BTreeMap<String, DeviceIdentity>,
    begun: &mut OwnedSessionFolder,
) -> Result<(BTreeMap<String, String>, bool), AcquisitionError> {
    let run = RunFile {
        format: RUN_FORMAT.to_owned(),
        id: session_id(&rig.name, &plan.name, &request.created),
        medium: plan.medium.clone(),
        created: request.created.clone(),
        program: format!("wcal {}", env!("CARGO_PKG_VERSION")),
        command: request.command.clone(),
        rig_sha256: sha256_hex(request.rig.as_bytes()),
        plan_sha256: sha256_hex(request.plan.as_bytes()),
        devices,
        clock_scale: rig.clock_scale,
        runs: Vec::new(),
        simulated: false,
    };
    let run = RunFile {
        simulated: run.is_simulated(),
        ..run
    };
    let text = as_text(&run)?;
    let path = request.folder.join("run.json");
    // A resumed session keeps the identity it was begun with.
    if path.exists() {
        same_bench(&path, run.simulated)?;
    } else {
        write_atomic(&begun.makes("run.json"), text.as_bytes())?;
    }
    // The recording tells by itself how it was made, should the folder's other files be lost.
    let about = BTreeMap::from([
        ("run".to_owned(), text),
        ("rig".to_owned(), request.rig.clone()),
        ("plan".to_owned(), request.plan.clone()),
    ]);
    Ok((about, run.simulated))
}

/// Measured and simulated scans never share a session.
fn same_bench(run_file: &Path, simulated: bool) -> Result<(), AcquisitionError> {
    let begun = RunFile::read(run_file)?;
    if begun.is_simulated() == simulated {
        return Ok(());
    }
    let name = |simulated: bool| {
        if simulated {
            "a virtual bench"
        } else {
            "a real bench"
        }
    };
    Err(AcquisitionError::input(
        run_file.display().to_string(),
        format!(
            "{}, as when the session was begun",
            name(begun.is_simulated())
        ),
        name(simulated),
    ))
}

#[cfg(test)]
mod tests {
    use super::session_id;

    #[test]
    fn sessions_of_one_second_have_different_identifiers() {
        let id = |created| session_id("bench", "paper-27", created);
        assert_eq!(
            id("2026-11-24T22:12:36.000125Z"),
            "bench-paper-27-20261124221236000125"
        );
        assert_ne!(
            id("2026-11-24T22:12:36.000125Z"),
            id("2026-11-24T22:12:36.000126Z")
        );
    }
}
