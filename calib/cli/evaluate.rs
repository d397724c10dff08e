//! `wcal evaluate`: a trained tracker beside the baselines, on sweeps that it did not see.

mod document;
pub mod report;
mod tables;
mod test_objects;
mod text;
mod virtual_bench;
mod work;

use crate::output::{OutputFolder, Overwrite, ResultKind};
use crate::progress::Progress;
use crate::simulate::{MAX_SWEEPS, within};
use crate::train::burn_device;
use anyhow::{Context, ensure};
use clap::Args;
use document::document;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use text::{print, print_tables, print_told};
use wcal_sim::read::manifests;
use wcal_sim::{Mesh, objects};
use wcal_track::classes::coverage_by_class;
use wcal_track::evaluate::{Method, ObjectScores, score_objects};
use wcal_track::filter::BayesSettings;
use wcal_track::model_file::{Card, SplitBy, load};
use wcal_track::two_contacts::{
    contact_evidence, network_evidence, two_contacts, two_contacts_given_previous,
};
use wcal_track::{InverseGrid, Sample, StaticInverse, SweepSeries, Tracker, sweep_series};
use work::{STREAMING, TWO_CONTACTS, Work, cost};

/// Arguments of `wcal evaluate`.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:
  wcal evaluate sweeps --model model --meshes ycb/meshes --out evaluation

Scores the objects that the model's card calls unseen, and the sweeps over the other objects that were kept back. Everything here is
SIMULATED. Intervals are 95 %, by bootstrap over whole objects (means) or over whole sweeps (one object). Writes evaluation.json and
report.html.")]
pub struct EvaluateArgs {
    /// Folder of shards from `wcal simulate`
    pub sweeps: PathBuf,
    /// Folder of `wcal train`
    #[arg(long, value_name = "DIR")]
    pub model: PathBuf,
    /// Folder of `wcal train --preset baseline` on the same split: a small transformer, printed beside; MODEL/baseline where it is there
    #[arg(long, value_name = "DIR")]
    pub baseline: Option<PathBuf>,
    /// Folder of the objects' STL files; built-in objects need none
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Objects of each kind at most
    #[arg(long, default_value_t = 10)]
    pub objects: usize,
    /// Sweeps over each object at most
    #[arg(long, default_value_t = 10)]
    pub sweeps_each: usize,
    /// Folder for evaluation.json and report.html
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write over what is no earlier result
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Seed of the virtual bench and of the sweeps that are drawn on the spot
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Leave out the virtual real bench, the tables over speed and medium, and the ablations
    #[arg(long)]
    pub simulation_only: bool,
    /// Two objects of each kind, four sweeps over each, no tables over speed and medium: under two minutes on two cores. Intervals are wide, and the result says that it is quick
    #[arg(long)]
    pub quick: bool,
    /// Print the document on stdout
    #[arg(long)]
    pub json: bool,
}

/// Format of evaluation.json.
pub const FORMAT: &str = "wcal-evaluation/1";

const RESULT: ResultKind<'_> = ResultKind {
    command: "evaluate",
    document: "evaluation.json",
    says: "wcal-evaluation/",
    files: &["report.html"],
    kept: &[],
    resumes: false,
};
/// Objects of each kind and sweeps over each with `--quick`.
const QUICK: [usize; 2] = [2, 4];

impl EvaluateArgs {
    /// The arguments with what `--quick` makes of them.
    fn quickened(&self) -> Self {
        let mut args = self.clone();
        if args.quick {
            (args.objects, args.sweeps_each) = (args.objects.min(QUICK[0]), args.sweeps_each.min(QUICK[1]));
        }
        args
    }
}

/// Runs the command.
///
/// # Errors
/// Where model, sweeps or meshes cannot be used.
pub fn run(args: &EvaluateArgs) -> anyhow::Result<ExitCode> {
    within("--objects", args.objects as u64, MAX_SWEEPS)?;
    within("--sweeps-each", args.sweeps_each as u64, MAX_SWEEPS)?;
    let args = &args.quickened();
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let progress = Progress::new("evaluate");
    progress.says("reading model and sweeps");
    let (tracker, card) = load(&args.model, &burn_device())?;
    let there: BTreeSet<String> = manifests(&args.sweeps)?.into_iter().map(|(_, m)| m.object).collect();
    let pick = |names: &[String], kept_back: bool| -> anyhow::Result<BTreeMap<String, Vec<SweepSeries>>> {
        let names: Vec<String> =
            names.iter().filter(|n| there.contains(*n)).take(args.objects).cloned().collect();
        if names.is_empty() {
            return Ok(BTreeMap::new());
        }
        let mut all_series = sweep_series::read_sweep_series(&args.sweeps, &names)?;
        for of_object in all_series.values_mut() {
            of_object.retain(|c| !kept_back || card.kept_back(&c.object, c.sweep));
            of_object.truncate(args.sweeps_each);
        }
        all_series.retain(|_, c| !c.is_empty());
        Ok(all_series)
    };
    let sets =
        [("seen", pick(&card.objects.training, true)?), ("unseen", pick(&card.objects.unseen, false)?)];
    ensure!(sets.iter().any(|s| !s.1.is_empty()), "{}: no sweep that was kept back", args.sweeps.display());
    let fine = StaticInverse::new(&card.whisker, InverseGrid::default())?;
    // Two thirds out: the middle of what sweeps touch.
    let middle = fine.nodes.last().map_or(40.0, |n| n.arclength_mm) * 2.0 / 3.0;
    let (settings, multi_mu) = (BayesSettings::default(), BayesSettings::multi_mu());
    let shipped = || Some(args.model.join("baseline")).filter(|folder| folder.join("model.json").is_file());
    let baseline = args.baseline.clone().or_else(shipped).map(|f| baseline(&f, &card)).transpose()?;
    let mut methods = vec![
        ("network, speed known", Method::Network(&tracker, true)),
        ("network", Method::Network(&tracker, false)),
        ("bayes, speed known", Method::Bayes(&fine, true, &multi_mu)),
        ("bayes", Method::Bayes(&fine, false, &multi_mu)),
        ("static inverse", Method::Static(&fine, middle)),
        ("constant", Method::Constant([middle, 0.0, 0.0].into())),
    ];
    methods.extend(baseline.iter().map(|b| ("small transformer", Method::Network(b, true))));
    let count = |k: usize| sets[k].1.values().map(Vec::len).sum::<usize>() as f64;
    let work = Work::new(
        &progress,
        count(0) + count(1),
        methods.iter().map(|m| cost(&m.1)).sum(),
        tables::cost(&card, args) + test_objects::cost(args),
    );
    let mut rows: Vec<(&str, &str, Vec<ObjectScores>)> = Vec::new();
    for (k, (set, all_series)) in sets.iter().enumerate() {
        let meshes = meshes(all_series.keys(), args)?;
        for (name, method) in &methods {
            work.next(&format!("{name}, {set} objects"), count(k) * cost(method));
            let run = |c: &SweepSeries| method.run(c);
            rows.push((set, name, score_objects(&run, all_series, &meshes)?));
        }
    }
    work.next("time of one sample", STREAMING);
    let streaming = streaming(&tracker, sets.iter().flat_map(|s| s.1.values().flatten()));
    let mut document = document(&rows, &streaming, &card.weights_sha256, args);
    work.next("two contacts", (count(0) + count(1)) * TWO_CONTACTS);
    let of = |given_truth: bool| {
        [0, 1].map(|k| contact_evidence(&fine, sets[k].1.values().flatten(), settings, given_truth))
    };
    let [seen, unseen] = of(false);
    // The limit is chosen on other objects than it is judged on.
    document["two_contacts"] = json!(two_contacts(&seen, &unseen));
    let [seen, unseen] = [0, 1].map(|k| network_evidence(&tracker, sets[k].1.values().flatten()));
    document["two_contacts_network"] = json!(two_contacts(&seen, &unseen));
    let [seen, unseen] = of(true);
    document["two_contacts_told_before"] = json!(two_contacts_given_previous(&seen, &unseen));
    if !card.sd_factors_by_class.is_empty() {
        let of = |set: usize| -> Vec<SweepSeries> { sets[set].1.values().flatten().cloned().collect() };
        let rows = |set: usize| {
            let (classes, by_class) = (&card.object_classes, &card.sd_factors_by_class);
            coverage_by_class(&tracker, &of(set), classes, by_class, card.sd_factors)
        };
        document["classes"] = json!({"seen": rows(0), "unseen": rows(1)});
    }
    if card.split == SplitBy::Sweeps {
        document["leak"] = json!({"split": "sweeps at random", "random_split_mm": document["simulation"]["seen_mean_mm"],
            "unseen_objects_mm": document["simulation"]["unseen_mean_mm"], "interval95": {
                "random_split_mm": document["simulation"]["interval95"]["seen_mean_mm"],
                "unseen_objects_mm": document["simulation"]["interval95"]["unseen_mean_mm"]}});
    }
    if !args.simulation_only {
        let folder = tempfile::tempdir().context("making a folder for what is in between")?;
        let maker = tables::Maker {
            tracker: &tracker,
            card: &card,
            args,
            folder: folder.path(),
            work: &work,
            curve: &fine,
        };
        for (name, table) in maker.tables()? {
            document[name] = table;
        }
        let of = (&tracker, &card.whisker);
        document["test_objects"] = test_objects::table(of, args, &work)?;
    }
    drop(progress);
    out.put("evaluation.json", format!("{}\n", serde_json::to_string_pretty(&document)?));
    out.put("report.html", report::page(&document)?);
    out.finish()?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        if args.quick {
            println!("QUICK: few objects and sweeps, wide intervals");
        }
        print(&rows);
        println!("streaming: {} samples/s, p99 {} us", streaming["samples_per_s"], streaming["p99_us"]);
        print_told(&document);
        print_tables(&document);
        test_objects::print(&document);
    }
    Ok(ExitCode::SUCCESS)
}

/// The small transformer, trained on no object or sweep that the model was not.
fn baseline(folder: &Path, card: &Card) -> anyhow::Result<Tracker> {
    let (tracker, own) = load(folder, &burn_device())?;
    let split = |c: &Card| (c.objects.clone(), c.split, c.sweeps_trained);
    ensure!(
        split(&own) == split(card),
        "{}: objects: expected the split of the model (same sweeps, --seed, --split), found another",
        folder.display()
    );
    Ok(tracker)
}

fn meshes<'a>(
    names: impl Iterator<Item = &'a String>,
    args: &EvaluateArgs,
) -> anyhow::Result<BTreeMap<String, Mesh>> {
    names
        .map(|name| {
            let mesh = objects::named(name, args.meshes.as_deref()).with_context(|| {
                format!("object {name}: expected it built in, or its mesh in --meshes DIR")
            })?;
            for note in &mesh.notes {
                eprintln!("warning: object {name}: {note}");
            }
            Ok((name.clone(), mesh))
        })
        .collect()
}

/// Samples a second on one core, one by one, and the slowest of a hundred.
fn streaming<'a>(tracker: &Tracker, all_series: impl Iterator<Item = &'a SweepSeries>) -> Value {
    const SAMPLES: usize = 1000;
    let mut times_us: Vec<f64> = Vec::new();
    for series in all_series {
        let mut stream = tracker.stream();
        for i in &series.samples {
            let sample = Sample { t_s: i.t_s, moment_nmm: i.moment_nmm, base_mm_s: Some(i.speed_mm_s) };
            let begin = Instant::now();
            std::hint::black_box(stream.push(&sample));
            times_us.push(begin.elapsed().as_secs_f64() * 1e6);
        }
        if times_us.len() > SAMPLES {
            break;
        }
    }
    times_us.sort_by(f64::total_cmp);
    let total: f64 = times_us.iter().sum();
    let p99 = times_us.get(times_us.len() * 99 / 100).copied().unwrap_or(0.0);
    json!({"samples_per_s": (times_us.len() as f64 / total * 1e6).round(), "p99_us": p99.round()})
}
