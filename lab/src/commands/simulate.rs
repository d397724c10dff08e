//! `wcal-lab simulate`: sweeps of the simulated whisker over objects, as shards.

mod arguments;
pub mod document;
mod inputs;
mod order;
pub mod slurm;

use anyhow::{Context, bail};
pub use arguments::{Engine, SimulateArgs};
use document::print;
pub use inputs::whisker;
pub use order::Order;
pub use slurm::SlurmArgs;
use std::process::ExitCode;
use wcal::output::{ResultKind, within};
use wcal::progress::Progress;
use wcal_lab_sweeps::SweepPlan;

/// Shards and what lies beside them; a second run goes on with them.
const RESULT: ResultKind<'_> = ResultKind {
    kept: &["convex", "slurm"],
    resumes: true,
    ..ResultKind::new("simulate", "*.json", "\"wcal-sweep", &["*.parquet"])
};

/// Runs the command: 0, 3 where objects were left out or are doubtful, or 4 where a check finds
/// shards missing.
///
/// # Errors
/// Where nothing can be simulated, or the folder cannot be written.
pub fn run(args: &SimulateArgs) -> anyhow::Result<ExitCode> {
    let share = share(&args.shard)?;
    RESULT.check(&args.out, args.overwrite.force)?;
    within("--sweeps", args.sweeps, MAX_SWEEPS)?;
    let plan = match &args.plan {
        Some(path) => {
            let text = wcal_core::files::read_text(path)?;
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
            Some(submission) if args.json => {
                println!("{}", serde_json::to_string_pretty(&submission)?)
            }
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
