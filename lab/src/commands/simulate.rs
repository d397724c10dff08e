//! `wcal-lab simulate`: sweeps of the simulated whisker over objects, as shards.

pub mod document;
mod inputs;
mod order;
pub mod slurm;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use document::print;
pub use inputs::whisker;
pub use order::Order;
pub use slurm::SlurmArgs;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal::output::{Overwrite, ResultKind, unsaid, within};
use wcal::progress::Progress;
use wcal_lab_sweeps::SweepPlan;

/// Arguments of `wcal-lab simulate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal-lab simulate --object can --object vase --sweeps 50 --out sweeps
  wcal-lab simulate --meshes ycb/meshes --sweeps 200 --seed 1 --out sweeps
  wcal-lab simulate --meshes ycb/meshes --sweeps 200 --out /shared/sweeps --slurm header.sh

Writes for every 25 sweeps over an object three Parquet tables (sweeps, samples, contacts) and a manifest with their checksums, and
dataset.json. A second run with the same arguments goes on where the first stopped; one with another seed, plan, whisker, engine or other
objects is refused: one folder, one dataset (recipe.json says which). With --engine mujoco the rod runs on the same sweeps:
how far moments and contacts are from it, by speed, is printed and goes into dataset.json (against_rod), with
how far the convex parts are from each mesh. Everything here is SIMULATED. It runs on all
cores; RAYON_NUM_THREADS=N asks for N. Exit code 3: made, with objects left out, meshes
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
    /// How sweeps are drawn, and their physics (lab/sweeps.toml has every key with its default)
    #[arg(long, value_name = "TOML")]
    pub plan: Option<PathBuf>,
    /// Share of the work, "i/n" from 1: the shards of all shares together are the dataset
    #[arg(long, value_name = "i/n", default_value = "1/1")]
    pub shard: String,
    /// Make nothing: compare every shard with its checksums, name what is missing, write dataset.json
    #[arg(long)]
    pub check: bool,
    /// Folder for the shards
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
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
    format_prefix: "\"wcal-sweep",
    files: &["*.parquet"],
    kept: &["convex", "slurm"],
    resumes: true,
    made_of: unsaid,
};

/// Runs the command: 0, 3 where objects were left out or are doubtful, or 4 where a check finds shards missing.
///
/// # Errors
/// Where nothing can be simulated, or the folder cannot be written.
pub fn run(args: &SimulateArgs) -> anyhow::Result<ExitCode> {
    let share = share(&args.shard)?;
    RESULT.check(&args.out, args.overwrite.force)?;
    within("--sweeps", args.sweeps, MAX_SWEEPS)?;
    let plan = match &args.plan {
        Some(path) => {
            let text =
                wcal_core::files::read_text(path).with_context(|| format!("reading {}", path.display()))?;
            SweepPlan::from_toml(&text).with_context(|| format!("reading {}", path.display()))?
        }
        None => SweepPlan::default(),
    };
    let order = Order::new(args, plan, share)?;
    let dataset = &order.dataset;
    // Before a job is handed in, and before a check writes its dataset.json over another's.
    dataset.check_folder(&args.out)?;
    if let Some(header) = &args.slurm.slurm {
        match slurm::submit((&args.slurm, header), &args.out, dataset)? {
            None => {}
            Some(submission) if args.json => println!("{}", serde_json::to_string_pretty(&submission)?),
            Some(submission) => submission.print(),
        }
        return Ok(ExitCode::SUCCESS);
    }
    let (totals, missing) = if args.check {
        let survey = dataset.survey(&args.out)?;
        (survey.totals, survey.missing)
    } else {
        let progress = Progress::new("simulate");
        (order.make(&args.out, &progress, "sweeps")?, Vec::new())
    };
    let document = order.write_document(args, &totals, missing)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&document)?);
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

/// Most sweeps over an object: their shards' names alone fill the memory past it.
pub const MAX_SWEEPS: u64 = 10_000_000;

fn share(text: &str) -> anyhow::Result<[usize; 2]> {
    let parts: Vec<Option<usize>> = text.split('/').map(|p| p.parse().ok()).collect();
    match parts[..] {
        [Some(i), Some(n)] if i >= 1 && i <= n => Ok([i - 1, n]),
        _ => bail!("--shard: expected i/n with 1 <= i <= n, found {text:?}"),
    }
}
