//! `wcal-lab evaluate`: a trained tracker beside the baselines, on sweeps that it did not see.

mod bench_calibration;
mod text;

use super::simulate::MAX_SWEEPS;
use crate::dataset::read::manifests;
use crate::evaluation::{Model, Order, Sets, Surroundings, evaluate};
use crate::model_file::{Card, load};
use crate::sweep_series::{self, SweepSeries};
use anyhow::ensure;
use clap::Args;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::ExitCode;
use wcal::output::{OutputFolder, Overwrite, ResultKind, within};
use wcal::picture_output::provenance;
use wcal::progress::Progress;
use wcal::track::filters_for;

/// Arguments of `wcal-lab evaluate`.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:
  wcal-lab evaluate sweeps --model model --meshes ycb/meshes --out evaluation

Scores the objects that the model's card calls unseen, and the sweeps over the other objects that were kept back. Everything here is
SIMULATED. Intervals are 95 %, by bootstrap over whole objects (means) or over whole sweeps (one object). Writes evaluation.json.")]
pub struct EvaluateArgs {
    /// Folder of shards from `wcal-lab simulate`
    pub sweeps: PathBuf,
    /// Folder of `wcal-lab train`
    #[arg(long, value_name = "DIR")]
    pub model: PathBuf,
    /// Folder of the objects' STL files; built-in objects need none
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Objects of each kind at most
    #[arg(long, default_value_t = 10)]
    pub objects: usize,
    /// Sweeps over each object at most
    #[arg(long, default_value_t = 10)]
    pub sweeps_each: usize,
    /// Folder for evaluation.json
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Seed of the virtual bench and of the sweeps that are drawn on the spot
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Leave out the virtual bench and the objects set aside for tests
    #[arg(long)]
    pub simulation_only: bool,
    /// Print the document on stdout
    #[arg(long)]
    pub json: bool,
}

const RESULT: ResultKind<'_> =
    ResultKind::new("evaluate", "evaluation.json", "wcal-evaluation/", &[]);
/// Runs the command.
///
/// # Errors
/// Where model, sweeps or meshes cannot be used.
pub fn run(args: &EvaluateArgs) -> anyhow::Result<ExitCode> {
    within("--objects", args.objects as u64, MAX_SWEEPS)?;
    within("--sweeps-each", args.sweeps_each as u64, MAX_SWEEPS)?;
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let progress = Progress::new("evaluate");
    progress.stage("reading model and sweeps");
    let (tracker, card) = load(&args.model)?;
    let model = Model {
        tracker: &tracker,
        card: &card,
    };
    let sets = sets(args, &card)?;
    let order = Order {
        meshes: args.meshes.as_deref(),
        objects: args.objects,
        sweeps_each: args.sweeps_each,
        seed: args.seed,
        simulation_only: args.simulation_only,
    };
    let around = Surroundings {
        calibrate: &|session| bench_calibration::calibrate(session, args.seed).map_err(Into::into),
        filters_for,
        progress: &|stage| progress.stage(stage),
        note: &|remark| eprintln!("{remark}"),
        provenance: provenance([args.model.join("model.json").as_path()]),
    };
    let (document, scores) = evaluate(&model, &sets, &order, &around)?;
    drop(progress);
    let document = serde_json::to_value(&document)?;
    let text = format!("{}\n", serde_json::to_string_pretty(&document)?);
    out.put("evaluation.json", text.clone());
    out.finish()?;
    if args.json {
        print!("{text}");
    } else {
        text::print(&scores, &document);
    }
    Ok(ExitCode::SUCCESS)
}

/// The sweeps of the dataset: those over objects of the training that were kept back, and those
/// over objects that it did not see.
fn sets(args: &EvaluateArgs, card: &Card) -> anyhow::Result<Sets> {
    let there: BTreeSet<String> = manifests(&args.sweeps)?
        .into_iter()
        .map(|(_, m)| m.object)
        .collect();
    let pick =
        |names: &[String], kept_back: bool| -> anyhow::Result<BTreeMap<String, Vec<SweepSeries>>> {
            let names: Vec<String> = names
                .iter()
                .filter(|n| there.contains(*n))
                .take(args.objects)
                .cloned()
                .collect();
            if names.is_empty() {
                return Ok(BTreeMap::new());
            }
            let mut all_series = sweep_series::read_sweep_series(&args.sweeps, &names)?;
            for of_object in all_series.values_mut() {
                of_object.retain(|c| !kept_back || card.kept_back(c.sweep));
                of_object.truncate(args.sweeps_each);
            }
            all_series.retain(|_, c| !c.is_empty());
            Ok(all_series)
        };
    let sets = Sets {
        seen: pick(&card.objects.training, true)?,
        unseen: pick(&card.objects.unseen, false)?,
    };
    ensure!(
        !sets.seen.is_empty() || !sets.unseen.is_empty(),
        "{}: no sweep that was kept back",
        args.sweeps.display()
    );
    Ok(sets)
}
