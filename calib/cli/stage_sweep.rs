//! `wcal stage-sweep`: drives the stage, records all streams, reduces to points.

mod bench_rig;
mod live_sweep;

use crate::{interrupt, reduce};
use anyhow::{Context, Result, anyhow};
pub(crate) use bench_rig::with_addresses;
use clap::Args;
use live_sweep::LiveSweep;
use schemars::JsonSchema;
use serde::Serialize;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};
use wcal_acquisition::plan::{Plan, Step, duration_s};
use wcal_acquisition::record::{RecordRequest, RecordResult, is_finished, plan_only, record};
use wcal_acquisition::rig::Rig;
use wcal_acquisition::sweep::{Ending, Progress, StageEnd};
use wcal_core::device::{DeviceError, DeviceErrorKind, Mount, Permission};
use wcal_core::files::read_text;
use wcal_core::plan_check_document::PlanCheck;
use wcal_drivers::Drivers;
use wcal_drivers::bench::in_process::InProcess;

/// Arguments of `wcal stage-sweep`.
#[derive(Debug, Args)]
#[command(after_help = "Example, without hardware (two terminals):
  wcal virtual-bench --scenario rigs/virtual/scenario.toml > bench.json
  wcal stage-sweep --rig rigs/virtual --plan rigs/plans/paper-27.toml \\
      --bench bench.json --home --out session
  wcal fit-gpr session --out fit; wcal verify session --out verify

Ctrl-C, SIGTERM, SIGHUP and every fault stop the stage and leave a readable session; `--resume SESSION` continues it.
A session and a stage each allow one sweep at a time.
Exit code 0: good; 1: stopped by a fault, or nothing could be recorded; 3: finished, with data lost or warnings that matter; 130: stopped by
Ctrl-C (143 SIGTERM, 129 SIGHUP).")]
pub(crate) struct StageSweepArgs {
    /// Rig: rig.toml or the folder that holds it
    #[arg(long, value_name = "RIG")]
    pub rig: PathBuf,
    /// Plan file
    #[arg(long, value_name = "plan.toml")]
    pub plan: PathBuf,
    /// Session folder to create; earlier measurements are never replaced
    #[arg(long, value_name = "SESSION", required_unless_present_any = ["resume", "dry_run"])]
    pub out: Option<PathBuf>,
    /// Resume an interrupted session
    #[arg(long, value_name = "SESSION", conflicts_with = "out")]
    pub resume: Option<PathBuf>,
    /// Addresses as `wcal virtual-bench` prints them; they replace those of the rig
    #[arg(long, value_name = "ADDRESSES.json")]
    pub bench: Option<PathBuf>,
    /// Use a scenario's virtual bench in this process instead of the rig's devices, faster than
    /// real time; without cameras
    #[arg(long, value_name = "S.toml", conflicts_with = "bench")]
    pub scenario: Option<PathBuf>,
    /// Home the stage if it has no reference (moves to the home switch)
    #[arg(long)]
    pub home: bool,
    /// Check limits and print how long it takes, and what the plan can show of each effect, without
    /// moving
    #[arg(long)]
    pub dry_run: bool,
    /// Serve a page on 127.0.0.1 that shows the sweep as it goes; its address is printed on stderr
    ///
    /// PORT: default a free one. The page with its last state is kept as live.html in the session.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "0", conflicts_with = "dry_run")]
    pub live_page: Option<u16>,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// What the steps of a plan on a rig can show; an error where that cannot be said.
type ShowsOfPlan = fn(&Rig, &Plan, &[Step]) -> Result<PlanCheck>;

/// Runs a sweep; `shows` is asked by `--dry-run` alone. Exit codes: 0 good, 1 stopped by a fault
/// (the session is intact), 3 finished with warnings, 130 stopped by Ctrl-C.
///
/// # Errors
/// When rig, plan, folder or devices cannot be used.
pub(crate) fn run(arguments: &StageSweepArgs, shows: ShowsOfPlan) -> Result<ExitCode> {
    let rig_file = if arguments.rig.is_dir() {
        arguments.rig.join("rig.toml")
    } else {
        arguments.rig.clone()
    };
    let (mut rig, plan) = (read_text(&rig_file)?, read_text(&arguments.plan)?);
    // A virtual bench takes free ports at every start: no rig can state them.
    if let Some(bench) = &arguments.bench {
        rig = with_addresses(&rig, &read_text(bench)?)
            .with_context(|| format!("addresses in {}", bench.display()))?;
    }
    let own_bench = arguments
        .scenario
        .as_deref()
        .map(crate::virtual_bench::load)
        .transpose()?;
    if let Some((scenario, _)) = &own_bench {
        let own_rig = bench_rig::in_this_process(&rig, scenario.interrogator.rate_hz);
        rig = own_rig.with_context(|| rig_file.display().to_string())?;
    }
    // A dry run opens no device and makes no folder.
    if arguments.dry_run {
        let (rig, plan) = ((&*rig_file, &*rig), (&*arguments.plan, &*plan));
        return dry_run(rig, plan, shows, arguments.json);
    }
    let (resume, folder) = match (&arguments.resume, &arguments.out) {
        (Some(folder), _) => (true, folder.clone()),
        (None, Some(folder)) => (false, folder.clone()),
        (None, None) => {
            return Err(anyhow!(
                "expected --out SESSION or --resume SESSION, found neither"
            ));
        }
    };
    if !resume {
        crate::output::check_new(&folder, " (or --resume SESSION)")?;
    } else if is_finished(&folder, &rig, &plan)? {
        eprintln!(
            "{}: this sweep is finished: nothing is recorded anew",
            folder.display()
        );
        return Ok(ExitCode::SUCCESS);
    }
    // A port that is taken is known before anything opens.
    let mut live = arguments
        .live_page
        .map(|port| LiveSweep::open(port, &rig, &plan, &folder))
        .transpose()?;
    // From here on Ctrl-C brings the stage to rest instead of ending the program at once.
    let interrupt = interrupt::watch()?;
    let order = RecordRequest {
        rig,
        plan,
        places: [&rig_file, &arguments.plan].map(|p| p.display().to_string()),
        folder: folder.clone(),
        resume,
        home: arguments.home,
        created: created(),
        command: std::env::args().collect(),
    };
    let mut view = View::new();
    let mut progress = |p: &Progress| {
        view.show(p);
        live.iter_mut()
            .for_each(|live| live.show(p, view.left_s(p)));
    };
    let recorded = match own_bench {
        Some((scenario, plant)) => {
            let mut bench = InProcess::new(scenario, plant);
            if resume {
                bench.pass(bench_rig::ahead_s(&folder)?.max(0.0));
            }
            // A pause passes in the bench's time: nobody waits for it.
            let mut pause = {
                let bench = bench.clone();
                move |time: Duration| bench.pause(time)
            };
            record(
                &order,
                &mut bench,
                &mut ByHand,
                &interrupt,
                &mut pause,
                &mut progress,
            )?
        }
        None => {
            let mut devices = Drivers::new(&interrupt);
            record(
                &order,
                &mut devices,
                &mut ByHand,
                &interrupt,
                &mut std::thread::sleep,
                &mut progress,
            )?
        }
    };
    view.end();
    if let Some(live) = live {
        live.end(&recorded);
    }
    report(&recorded, &folder, arguments)?;
    Ok(ExitCode::from(recorded.exit_code()))
}

/// Now, to the microsecond: the session's identifier is made of it, and two sessions of one second
/// have different ones.
fn created() -> String {
    jiff::Timestamp::now()
        .strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
        .to_string()
}

/// The steps of a plan on a rig.
#[derive(Serialize, JsonSchema)]
pub(crate) struct PathDocument {
    /// Format and version.
    #[schemars(extend("const" = "wcal-path/1"))]
    format: &'static str,
    /// Settled readings.
    readings: usize,
    /// Estimated duration, s.
    duration_s: f64,
    /// In order.
    steps: Vec<Step>,
    /// Which effects the plan can distinguish; null where that is not known.
    shows: Option<PlanCheck>,
}

/// What a sweep recorded.
#[derive(Serialize, JsonSchema)]
pub(crate) struct SweepDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-sweep/1"))]
    format: &'static str,
    /// Folder.
    session: &'a Path,
    /// From simulated devices.
    simulated: bool,
    /// How it ended.
    #[schemars(extend("enum" = ["finished", "stopped"]))]
    ending: &'static str,
    /// What was lost or not as it should be.
    warnings: Vec<String>,
    /// Why it stopped.
    cause: Option<CauseDocument>,
    /// The stage confirmed its stop.
    stage_stopped: bool,
    /// Steps done.
    steps_done: usize,
    /// Readings whose signal did not settle.
    unsettled: usize,
    /// Scans.
    scans: u64,
    /// Gaps.
    gaps: u64,
    /// Scans lost.
    lost_scans: u64,
    /// Questions to the stage that were repeated.
    stage_repeats: u64,
    /// Pairs of pictures.
    camera_pairs: u64,
    /// Pairs refused.
    camera_pairs_refused: u64,
    /// Largest skew of a pair, ms.
    worst_skew_ms: f64,
    /// Rows; null where reducing failed.
    rows: Option<usize>,
    /// Holdout rows; null where reducing failed.
    holdout: Option<usize>,
    /// Delay between stage and stream at each sync move, s.
    lag_s: Option<&'a [f64]>,
}

/// Why a sweep stopped.
#[derive(Serialize, JsonSchema)]
struct CauseDocument {
    /// Kind of the fault.
    kind: String,
    /// In words.
    text: String,
}

fn dry_run(
    rig: (&Path, &str),
    plan: (&Path, &str),
    shows: ShowsOfPlan,
    as_json: bool,
) -> Result<ExitCode> {
    let (rig, plan, steps) = plan_only(
        (&rig.0.display().to_string(), rig.1),
        (&plan.0.display().to_string(), plan.1),
    )?;
    let readings = steps
        .iter()
        .filter(|s| matches!(s, Step::Settled(_)))
        .count();
    let time_s = duration_s(&steps, &rig, &plan);
    // A path can be driven although the wire has no equilibrium on it.
    let shows = shows(&rig, &plan, &steps);
    if let Err(why) = &shows {
        eprintln!("warning: what the plan can show is not known: {why:#}");
    }
    if as_json {
        let document = PathDocument {
            format: "wcal-path/1",
            readings,
            duration_s: time_s,
            steps,
            shows: shows.ok(),
        };
        println!("{}", serde_json::to_string(&document)?);
    } else {
        println!(
            "{readings} settled readings, about {:.0} min; limits hold",
            (time_s / 60.0).ceil()
        );
        if let Ok(shows) = &shows {
            print!("{}", shows.text());
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn report(recorded: &RecordResult, folder: &Path, arguments: &StageSweepArgs) -> Result<()> {
    let sweep = &recorded.sweep;
    let (ending, cause, stage) = match &sweep.ending {
        Ending::Finished => ("finished", None, None),
        Ending::Stopped { cause, stage } => ("stopped", Some(cause), Some(*stage)),
    };
    let warnings = recorded.warnings();
    for warning in &warnings {
        eprintln!("stage-sweep: warning: {warning}");
    }
    if let Err(e) = &recorded.reduction {
        eprintln!("stage-sweep: the raw streams are kept, but reducing them failed: {e}");
    }
    let tables = recorded.reduction.as_ref().ok();
    if arguments.json {
        let document = SweepDocument {
            format: "wcal-sweep/1",
            session: folder,
            simulated: recorded.simulated,
            ending,
            warnings,
            cause: cause.map(|c| CauseDocument {
                kind: c.kind.name(),
                text: c.to_string(),
            }),
            stage_stopped: stage.is_none_or(StageEnd::stands),
            steps_done: sweep.done,
            unsettled: sweep.unsettled,
            scans: sweep.counts.scans,
            gaps: sweep.counts.gaps,
            lost_scans: sweep.counts.lost,
            stage_repeats: recorded.repeats,
            camera_pairs: sweep.counts.pairs,
            camera_pairs_refused: sweep.counts.pairs_refused,
            worst_skew_ms: sweep.counts.worst_skew_ms,
            rows: tables.map(|r| r.rows),
            holdout: tables.map(|r| r.holdout),
            lag_s: tables.map(|r| r.lag_s.as_slice()),
        };
        println!("{}", serde_json::to_string(&document)?);
        return Ok(());
    }
    if let Some(cause) = cause {
        eprintln!("stage-sweep: stopped: {cause}");
        let stands = match stage {
            Some(StageEnd::Unknown) => {
                "THE STAGE DID NOT CONFIRM ITS STOP: look at it before anything else"
            }
            Some(StageEnd::Stands) => "the stage stands where it was stopped, perhaps in contact",
            _ => "the stage stands, retracted from the wire",
        };
        eprintln!("stage-sweep: {stands}");
        // A bench in this process has ended with it: the next one has no reference.
        let bench = if arguments.scenario.is_some() {
            ", scenario, --home"
        } else {
            ""
        };
        eprintln!(
            "go on with the same rig and plan{bench} and --resume {}",
            folder.display()
        );
    }
    if recorded.simulated {
        eprintln!("SIMULATED: recorded on a virtual bench; session.toml and run.json say so");
    }
    eprintln!(
        "{} steps; {} scans, {} lost in {} gaps; {} windows not settled; {} questions to the stage repeated",
        sweep.done,
        sweep.counts.scans,
        sweep.counts.lost,
        sweep.counts.gaps,
        sweep.unsettled,
        recorded.repeats
    );
    tables.map_or(Ok(()), |r| reduce::report(r, false))?;
    if cause.is_none() {
        eprintln!("next: wcal verify {}", folder.display());
    }
    Ok(())
}

/// How often somebody who waits for Enter listens for a signal.
const ENTER_POLL: Duration = Duration::from_millis(50);

/// Nobody turned the mount.
fn not_turned(kind: DeviceErrorKind, found: &str) -> DeviceError {
    DeviceError::new(
        kind,
        "mount",
        "turn by hand",
        "a person at the terminal",
        found,
    )
}

/// Asks a person to turn the mount and waits for Enter.
fn by_hand(trajectory: u32) -> Result<(), DeviceError> {
    let refuse = |found: &str| not_turned(DeviceErrorKind::Interrupted, found);
    // Without a terminal to write to there is nobody to read it either.
    let question = format!("\nturn the mount to trajectory {trajectory}, then press Enter ");
    let _ = std::io::stderr().write_all(question.as_bytes());
    // The line is read in its own thread: a read from a terminal does not end with a signal.
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut line = String::new();
        let read = std::io::stdin().lock().read_line(&mut line);
        // Whoever waited may be gone by now.
        let _ = sender.send(read.is_ok_and(|count| count > 0));
    });
    loop {
        match (receiver.recv_timeout(ENTER_POLL), interrupt::signal()) {
            (Ok(true), _) => return Ok(()),
            (_, Some(signal)) => return Err(refuse(signal.name())),
            (Err(RecvTimeoutError::Timeout), None) => {}
            _ => return Err(refuse("the end of the input")),
        }
    }
}

/// A mount that a person turns.
struct ByHand;

impl Mount for ByHand {
    /// Nobody at the terminal can turn it; a plan of one trajectory needs nobody.
    fn check(&mut self, trajectories: &[u32], _: Permission) -> Result<(), DeviceError> {
        let several = trajectories.iter().any(|t| Some(t) != trajectories.first());
        match several && !std::io::stdin().is_terminal() {
            true => Err(not_turned(
                DeviceErrorKind::Configuration,
                "an input that is no terminal",
            )),
            false => Ok(()),
        }
    }

    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        if !std::io::stdin().is_terminal() {
            eprintln!(
                "stage-sweep: the mount is taken to stand at trajectory {trajectory}, the only one of the plan"
            );
            return Ok(());
        }
        by_hand(trajectory)
    }
}

/// Terminal view: position, wavelengths, rate, losses, time left.
struct View {
    shown: Option<Instant>,
    /// When it was shown first, with the scans and the step of then.
    first: Option<(Instant, u64, usize)>,
    live: bool,
}

impl View {
    fn new() -> Self {
        Self {
            shown: None,
            first: None,
            live: std::io::stderr().is_terminal(),
        }
    }

    fn show(&mut self, p: &Progress) {
        // On a terminal one line is redrawn; in a log file every one stays.
        let period = if self.live {
            Duration::from_millis(200)
        } else {
            Duration::from_secs(10)
        };
        if self.shown.is_some_and(|t| t.elapsed() < period) {
            return;
        }
        self.shown = Some(Instant::now());
        let (since, scans, _) = *self
            .first
            .get_or_insert((Instant::now(), p.counts.scans, p.step));
        let rate = (p.counts.scans - scans) as f64 / since.elapsed().as_secs_f64().max(1e-3);
        let left = self.left_s(p);
        let left = left.map_or_else(|| "?".to_owned(), |s| format!("{s:.0} s"));
        let nm = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |nm| format!("{nm:.4}"));
        let [reference, first, second] = p.wavelengths_nm.map(nm);
        let line = format!(
            "step {}/{} at {:+.3} mm  ref {reference} fbg {first} {second} nm  {rate:.0}/s  {} lost  {left} left",
            p.step, p.steps, p.stage_mm, p.counts.lost
        );
        let text = if self.live {
            format!("\r{line}\x1b[K")
        } else {
            format!("{line}\n")
        };
        // A view that cannot be shown must not stop a sweep.
        let _ = std::io::stderr().write_all(text.as_bytes());
    }

    /// Estimated time left, s.
    fn left_s(&self, p: &Progress) -> Option<f64> {
        // A resumed sweep begins in mid plan: only its own steps tell how long one takes.
        let (since, _, first) = self.first?;
        let done = p.step.checked_sub(first).filter(|done| *done > 0)?;
        Some(since.elapsed().as_secs_f64() / done as f64 * (p.steps - p.step) as f64)
    }

    fn end(&self) {
        if self.live {
            let _ = std::io::stderr().write_all(b"\n");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::created;

    #[test]
    fn the_time_of_creation_tells_sessions_of_one_second_apart() {
        let first = created();
        std::thread::sleep(std::time::Duration::from_millis(1));
        assert_ne!(first, created());
        assert!(first.parse::<jiff::Timestamp>().is_ok(), "{first}");
    }
}
