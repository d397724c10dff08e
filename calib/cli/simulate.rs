//! `wcal simulate`: sweeps of the simulated whisker over objects, as shards.

mod document;
mod inputs;
mod report;
mod slurm;

use crate::output::{Overwrite, ResultKind};
use crate::picture_output::write;
use crate::progress::Progress;
use anyhow::{Context, bail, ensure};
use clap::{Args, ValueEnum};
use document::{Faults, Twin, document, print};
pub use inputs::whisker;
use inputs::{mjcf_options, objects_of};
use slurm::{Handed, SlurmArgs};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use wcal_mujoco::MujocoSweeps;
use wcal_sim::{Dataset, Missing, RodSweeps, SweepEngine, SweepPlan};

/// Arguments of `wcal simulate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal simulate --object can --object vase --sweeps 50 --out sweeps
  wcal simulate --meshes ycb/meshes --sweeps 200 --seed 1 --out sweeps
  wcal simulate --meshes ycb/meshes --sweeps 200 --out /shared/sweeps --slurm --slurm-partition long --slurm-time 1:00:00

Writes for every 25 sweeps over an object three Parquet tables (sweeps, samples, contacts) and a manifest with their checksums, and
dataset.json. A second run with the same arguments goes on where the first stopped; one with another seed, plan, whisker, engine or other
objects is refused: one folder, one dataset (recipe.json says which). With --engine mujoco the rod runs on the same sweeps:
how far moments and contacts are from it, by speed, is printed and goes into dataset.json (against_rod) and the report, with the error of the
links alone and how far the convex parts are from each mesh. Everything here is SIMULATED. Exit code 3: made, with objects left out, meshes
that are not closed or not in millimetres, objects without a usable sweep, or an engine that died; with --check, 4: shards are missing or damaged.")]
pub struct SimulateArgs {
    /// Model of the wire: the quasi-static rod, or MuJoCo (inertia, damping, convex parts of the object; some 100 times slower)
    #[arg(long, value_enum, default_value = "rod")]
    pub engine: Engine,
    /// Built-in object (may be repeated); "all" takes every one
    #[arg(long, value_name = "NAME")]
    pub object: Vec<String>,
    /// STL file, or folder of them (may be repeated)
    #[arg(long, value_name = "PATH")]
    pub meshes: Vec<PathBuf>,
    /// Sweeps over each object
    #[arg(long, default_value_t = 200)]
    pub sweeps: u64,
    /// Seed of all draws
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Whisker (whisker.toml of `wcal fit-whisker`, with its damping and contact where they were fitted); the nominal one without it
    #[arg(long, value_name = "TOML")]
    pub whisker: Option<PathBuf>,
    /// How sweeps are drawn, and their physics (`wcal init --kind sweeps` writes every key with its default)
    #[arg(long, value_name = "TOML")]
    pub plan: Option<PathBuf>,
    /// Share of the work, "i/n" from 1: the shards of all shares together are the dataset
    #[arg(long, value_name = "i/n", default_value = "1/1")]
    pub shard: String,
    /// Cores
    #[arg(long)]
    pub jobs: Option<usize>,
    /// Make nothing: compare every shard with its checksums, name what is missing, write dataset.json
    #[arg(long)]
    pub check: bool,
    /// Folder for the shards
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write over what is no earlier result
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Write report.html: counts by verdict and event, objects, sweeps of each kind drawn; no network needed
    #[arg(long)]
    pub report: bool,
    /// Print the summary as JSON on stdout
    #[arg(long)]
    pub json: bool,
    /// For a cluster
    #[command(flatten)]
    pub slurm: SlurmArgs,
}

/// Models of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// Quasi-static rod on the exact mesh
    Rod,
    /// MuJoCo's cable on convex parts, labels on the exact mesh
    Mujoco,
}

/// Shards and what lies beside them; a second run goes on with them.
const RESULT: ResultKind<'_> = ResultKind {
    command: "simulate",
    document: "*.json",
    says: "\"wcal-sweep",
    files: &["*.parquet", "report.html", "report.json"],
    kept: &["convex", "slurm"],
    resumes: true,
};

/// Runs the command: 0, 3 where objects were left out or are doubtful, or 4 where a check finds shards missing.
///
/// # Errors
/// Where nothing can be simulated, or the folder cannot be written.
pub fn run(args: &SimulateArgs) -> anyhow::Result<ExitCode> {
    let share = share(&args.shard)?;
    RESULT.check(&args.out, args.overwrite.force)?;
    ensure!(args.sweeps > 0, "--sweeps: expected 1 or more, found 0");
    let (whisker, options) = (whisker(args.whisker.as_deref())?, mjcf_options(args.whisker.as_deref())?);
    let plan = match &args.plan {
        Some(path) => {
            let text =
                std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
            toml::from_str(&text).with_context(|| format!("reading {}", path.display()))?
        }
        None => SweepPlan::default(),
    };
    plan.check()?;
    let (objects, left_out) = objects_of(args)?;
    let mut notes: Vec<String> = Vec::new();
    for mesh in &objects {
        notes.extend(mesh.notes.iter().map(|note| format!("{}: {note}", mesh.name)));
    }
    for line in left_out.iter().chain(&notes) {
        eprintln!("simulate: warning: {line}");
    }
    let mujoco = (args.engine == Engine::Mujoco).then_some(options);
    let engine: Arc<dyn SweepEngine> = match &mujoco {
        None => Arc::new(RodSweeps),
        Some(options) => Arc::new(MujocoSweeps::new(options.clone())),
    };
    let dataset = Dataset { engine, whisker, plan, objects, sweeps: args.sweeps, seed: args.seed, share };
    if let Some(jobs) = args.jobs {
        ensure!(jobs > 0, "--jobs: expected 1 or more, found 0");
        rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global().context("starting threads")?;
    }
    // Before a job is handed in, and before a check writes its dataset.json over another's.
    dataset.check_folder(&args.out)?;
    let mut check = args.check;
    if args.slurm.slurm {
        match slurm::submit(&args.slurm, &args.out, &dataset)? {
            Handed::Printed => return Ok(ExitCode::SUCCESS),
            Handed::Submitted(submission) => {
                if args.json {
                    println!("{}", serde_json::to_string_pretty(&submission)?);
                } else {
                    submission.print();
                }
                return Ok(ExitCode::SUCCESS);
            }
            Handed::Complete => {
                eprintln!("simulate: every shard is there already: nothing is submitted, only checked");
                check = true;
            }
        }
    }
    let (totals, missing) = if check {
        let survey = dataset.survey(&args.out)?;
        (survey.totals, survey.missing)
    } else {
        let progress = Progress::new("simulate");
        let totals = dataset.make(&args.out, |done, all| {
            progress.at(&format!("{done} of {all} sweeps"), done as f64 / all.max(1) as f64);
        })?;
        drop(progress);
        let again: Vec<&String> = totals.values().flat_map(|t| &t.again).collect();
        for line in again.iter().take(MAX_REPEATS_SHOWN) {
            eprintln!("simulate: made again: {line}");
        }
        if again.len() > MAX_REPEATS_SHOWN {
            eprintln!("simulate: made again: {} more", again.len() - MAX_REPEATS_SHOWN);
        }
        (totals, Vec::new())
    };
    let known = notes.len();
    for (name, total) in &totals {
        notes.extend(total.notes.iter().map(|note| format!("{name}: {note}")));
        if let Some(died) = total.verdicts.get("engine-died") {
            notes.push(format!("{name}: the engine died in {died} sweeps: a second run makes them again"));
        }
        if total.kept() == 0 {
            notes.push(format!("{name}: none of {} sweeps is kept", total.sweeps));
        }
    }
    for note in &notes[known..] {
        eprintln!("simulate: warning: {note}");
    }
    let missing: Vec<String> =
        missing.iter().map(|Missing { name, why, .. }| format!("{name} is missing: {why}")).collect();
    for line in &missing {
        eprintln!("simulate: {line}");
    }
    let twin = Twin::of(&dataset, mujoco.as_ref(), &args.out)?;
    let document =
        document(args, &dataset, mujoco.as_ref(), &totals, Faults { left_out, notes, missing }, twin);
    let text = serde_json::to_string_pretty(&document)?;
    let [share, shares] = dataset.share;
    let name = if shares == 1 {
        "dataset.json".to_owned()
    } else {
        format!("dataset-{}-of-{shares}.json", share + 1)
    };
    write(&args.out, &name, text.as_bytes())?;
    if args.report {
        let page = report::page(&document, &args.out, &dataset.shards())?;
        write(&args.out, "report.json", page.to_json()?.as_bytes())?;
        write(&args.out, "report.html", page.render().as_bytes())?;
    }
    if args.json {
        println!("{text}");
    } else {
        print(&document, &totals);
    }
    let clean = document.left_out.is_empty() && document.notes.is_empty();
    Ok(match (document.missing.is_empty(), clean) {
        (true, true) => ExitCode::SUCCESS,
        (true, false) => ExitCode::from(3),
        (false, _) => ExitCode::from(4),
    })
}

fn share(text: &str) -> anyhow::Result<[usize; 2]> {
    let parts: Vec<Option<usize>> = text.split('/').map(|p| p.parse().ok()).collect();
    match parts[..] {
        [Some(i), Some(n)] if i >= 1 && i <= n => Ok([i - 1, n]),
        _ => bail!("--shard: expected i/n with 1 <= i <= n, found {text:?}"),
    }
}

/// Shards made again that are named one by one.
const MAX_REPEATS_SHOWN: usize = 5;
