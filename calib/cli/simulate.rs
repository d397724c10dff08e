//! `wcal simulate`: sweeps of the simulated whisker over objects, as shards.

mod report;
mod slurm;

use crate::picture_output::{provenance, write};
use anyhow::{Context, bail, ensure};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use slurm::{Handed, SlurmArgs};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::Provenance;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_mujoco::mjcf::MjcfOptions;
use wcal_mujoco::rod_engine::LINKS;
use wcal_mujoco::{Dataset, Mesh, Missing, SweepEngine, SweepPlan, Total, objects, shard};

/// Arguments of `wcal simulate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal simulate --object can --object vase --sweeps 50 --out sweeps
  wcal simulate --meshes ycb/meshes --sweeps 200 --seed 1 --out sweeps
  wcal simulate --meshes ycb/meshes --sweeps 200 --out /shared/sweeps --slurm --slurm-partition long --slurm-time 1:00:00

Writes for every 25 sweeps over an object three Parquet tables (sweeps, samples, contacts) and a manifest with their checksums, and
dataset.json. A second run with the same arguments goes on where the first stopped. Everything here is SIMULATED. Exit code 3: made,
with objects left out, meshes that are not closed or not in millimetres, or objects without a usable sweep; with --check, 4: shards are missing or damaged.")]
pub struct SimulateArgs {
    /// Model of the wire: the quasi-static rod, or MuJoCo (inertia, damping, convex parts of the object; some 100 times slower)
    #[arg(long, value_enum, default_value = "rod")]
    pub engine: Engine,
    /// Built-in object (may be repeated); \"all\" takes every one
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
    /// Whisker (whisker.toml of `wcal fit-whisker`); the nominal one without it
    #[arg(long, value_name = "TOML")]
    pub whisker: Option<PathBuf>,
    /// How sweeps are drawn, and their physics (`wcal init --kind sweeps` writes every key with its default)
    #[arg(long, value_name = "TOML")]
    pub plan: Option<PathBuf>,
    /// Share of the work, \"i/n\" from 1: the shards of all shares together are the dataset
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

#[derive(Debug, Deserialize)]
struct WhiskerFile {
    whisker: WhiskerKeys,
}

/// Keys of `[whisker]` as in session.toml.
#[derive(Debug, Deserialize)]
struct WhiskerKeys {
    diameter_mm: f64,
    length_mm: f64,
    straight_mm: f64,
    arc_radius_mm: f64,
    #[serde(default = "youngs_gpa")]
    youngs_gpa: f64,
    #[serde(default = "shear_gpa")]
    shear_gpa: f64,
}

/// NiTi (SYSTEM).
fn youngs_gpa() -> f64 {
    75.0
}

fn shear_gpa() -> f64 {
    28.2
}

/// `dataset.json`.
#[derive(Debug, Serialize)]
struct DatasetDocument {
    format: &'static str,
    simulated: bool,
    engine: String,
    seed: u64,
    sweeps_per_object: u64,
    share: String,
    plan: SweepPlan,
    whisker: String,
    sweeps: u64,
    kept: u64,
    samples: u64,
    verdicts: BTreeMap<String, u64>,
    events: BTreeMap<String, u64>,
    objects: BTreeMap<String, ObjectRow>,
    left_out: Vec<String>,
    notes: Vec<String>,
    /// Shards that are not there, with the reason (`--check`).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    missing: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sweeps_per_core_s: Option<f64>,
    /// What the paper's whole set would take at this rate, processor hours.
    #[serde(skip_serializing_if = "Option::is_none")]
    core_h_per_15600_sweeps: Option<f64>,
    provenance: Provenance,
}

#[derive(Debug, Serialize)]
struct ObjectRow {
    sweeps: u64,
    kept: u64,
    verdicts: BTreeMap<String, u64>,
    events: BTreeMap<String, u64>,
}

/// Sweeps of the paper's set: 78 objects, 200 each.
const PAPER_SWEEPS: f64 = 15_600.0;

/// Runs the command: 0, 3 where objects were left out or are doubtful, or 4 where a check finds shards missing.
///
/// # Errors
/// Where nothing can be simulated, or the folder cannot be written.
pub fn run(args: &SimulateArgs) -> anyhow::Result<ExitCode> {
    let share = share(&args.shard)?;
    ensure!(args.sweeps > 0, "--sweeps: expected 1 or more, found 0");
    let whisker = whisker(args.whisker.as_deref())?;
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
    let engine = match args.engine {
        Engine::Rod => SweepEngine::Rod,
        Engine::Mujoco => SweepEngine::Mujoco(Box::default()),
    };
    let dataset = Dataset { engine, whisker, plan, objects, sweeps: args.sweeps, seed: args.seed, share };
    if let Some(jobs) = args.jobs {
        ensure!(jobs > 0, "--jobs: expected 1 or more, found 0");
        rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global().context("starting threads")?;
    }
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
        let survey = dataset.survey(&args.out);
        (survey.totals, survey.missing)
    } else {
        let bar = bar();
        let totals = dataset.make(&args.out, |done, all| {
            bar.set_length(all);
            bar.set_position(done);
        })?;
        bar.finish_and_clear();
        (totals, Vec::new())
    };
    for (name, total) in totals.iter().filter(|(_, t)| t.kept() == 0) {
        let note = format!("{name}: none of {} sweeps is kept", total.sweeps);
        eprintln!("simulate: warning: {note}");
        notes.push(note);
    }
    let missing: Vec<String> =
        missing.iter().map(|Missing { name, why, .. }| format!("{name} is missing: {why}")).collect();
    for line in &missing {
        eprintln!("simulate: {line}");
    }
    let document = document(args, &dataset, &totals, Faults { left_out, notes, missing });
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
        write(&args.out, "report.html", page.as_bytes())?;
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

/// What the summary warns of.
struct Faults {
    left_out: Vec<String>,
    notes: Vec<String>,
    missing: Vec<String>,
}

fn share(text: &str) -> anyhow::Result<[usize; 2]> {
    let parts: Vec<Option<usize>> = text.split('/').map(|p| p.parse().ok()).collect();
    match parts[..] {
        [Some(i), Some(n)] if i >= 1 && i <= n => Ok([i - 1, n]),
        _ => bail!("--shard: expected i/n with 1 <= i <= n, found {text:?}"),
    }
}

/// Whisker of a file, or the nominal one.
///
/// # Errors
/// Where the file cannot be read.
pub fn whisker(path: Option<&Path>) -> anyhow::Result<WhiskerSpec> {
    let keys = match path {
        Some(path) => {
            let text =
                std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
            toml::from_str::<WhiskerFile>(&text)
                .with_context(|| format!("reading {}", path.display()))?
                .whisker
        }
        None => WhiskerKeys {
            diameter_mm: 0.3,
            length_mm: 60.0,
            straight_mm: 30.0,
            arc_radius_mm: 20.0,
            youngs_gpa: youngs_gpa(),
            shear_gpa: shear_gpa(),
        },
    };
    Ok(WhiskerSpec {
        diameter_mm: keys.diameter_mm,
        youngs_gpa: keys.youngs_gpa,
        shear_gpa: keys.shear_gpa,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc {
            straight_mm: keys.straight_mm,
            arc_radius_mm: keys.arc_radius_mm,
            length_mm: keys.length_mm,
        },
        gravity_direction: None,
    })
}

/// Usable objects, and those left out with the reason.
fn objects_of(args: &SimulateArgs) -> anyhow::Result<(Vec<Mesh>, Vec<String>)> {
    let (mut all, mut left_out) = (Vec::new(), Vec::new());
    for name in &args.object {
        if name == "all" {
            for name in objects::NAMES {
                all.push(objects::built_in(name)?);
            }
        } else {
            all.push(objects::built_in(name)?);
        }
    }
    for path in &args.meshes {
        for file in stl_files(path)? {
            match Mesh::read(&file) {
                Ok(mesh) => all.push(mesh),
                Err(e) => left_out.push(format!("{} is left out: {e}", file.display())),
            }
        }
    }
    let mut names: Vec<&str> = all.iter().map(|m| m.name.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|w| w[0] == w[1]) {
        bail!("expected objects of different names, found {:?} twice", twice[0]);
    }
    ensure!(
        !all.is_empty(),
        "expected an object (--object NAME or --meshes PATH), found none{}",
        if left_out.is_empty() { String::new() } else { format!(": {}", left_out.join("; ")) }
    );
    Ok((all, left_out))
}

fn stl_files(path: &Path) -> anyhow::Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).with_context(|| format!("reading {}", path.display()))? {
        let file = entry?.path();
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("stl")) {
            files.push(file);
        }
    }
    ensure!(!files.is_empty(), "{}: expected STL files, found none", path.display());
    files.sort();
    Ok(files)
}

fn document(
    args: &SimulateArgs,
    dataset: &Dataset,
    totals: &BTreeMap<String, Total>,
    faults: Faults,
) -> DatasetDocument {
    let summed = |of: fn(&Total) -> &BTreeMap<String, u64>| {
        let mut sum: BTreeMap<String, u64> = BTreeMap::new();
        for (name, count) in totals.values().flat_map(of) {
            *sum.entry(name.clone()).or_default() += count;
        }
        sum
    };
    let row = |t: &Total| ObjectRow {
        sweeps: t.sweeps,
        kept: t.kept(),
        verdicts: t.verdicts.clone(),
        events: t.events.clone(),
    };
    let (made, core_s) = totals.values().fold((0, 0.0), |a, t| (a.0 + t.made, a.1 + t.core_s));
    let rate = (core_s > 0.0).then(|| made as f64 / core_s);
    DatasetDocument {
        format: shard::FORMAT,
        simulated: true,
        engine: match &dataset.engine {
            SweepEngine::Rod => format!("rod, quasi-static, {LINKS} links"),
            SweepEngine::Mujoco(options) => {
                let MjcfOptions { links, damping_s, step_s, .. } = &**options;
                format!("MuJoCo, {links} links, damping {damping_s} s, step {step_s} s, convex parts")
            }
        },
        seed: dataset.seed,
        sweeps_per_object: dataset.sweeps,
        share: args.shard.clone(),
        plan: dataset.plan.clone(),
        whisker: format!("{:?}", dataset.whisker),
        sweeps: totals.values().map(|t| t.sweeps).sum(),
        kept: totals.values().map(Total::kept).sum(),
        samples: totals.values().map(|t| t.samples).sum(),
        verdicts: summed(|t| &t.verdicts),
        events: summed(|t| &t.events),
        objects: totals.iter().map(|(name, t)| (name.clone(), row(t))).collect(),
        left_out: faults.left_out,
        notes: faults.notes,
        missing: faults.missing,
        sweeps_per_core_s: rate,
        core_h_per_15600_sweeps: rate.map(|rate| PAPER_SWEEPS / rate / 3600.0),
        provenance: provenance(
            args.whisker.iter().chain(&args.plan).chain(&args.meshes).map(PathBuf::as_path),
        ),
    }
}

fn print(document: &DatasetDocument, totals: &BTreeMap<String, Total>) {
    println!("{:<32} {:>7} {:>7}  rejected", "object (SIMULATED)", "sweeps", "kept");
    for (name, total) in totals {
        let why: Vec<String> =
            total.verdicts.iter().filter(|(v, _)| *v != "kept").map(|(v, n)| format!("{v} {n}")).collect();
        println!("{name:<32} {:>7} {:>7}  {}", total.sweeps, total.kept(), why.join(", "));
    }
    let events: Vec<String> = document.events.iter().map(|(e, n)| format!("{n} {e}")).collect();
    println!("{} sweeps, {} kept, {} samples", document.sweeps, document.kept, document.samples);
    println!("events: {}", if events.is_empty() { "none".to_owned() } else { events.join(", ") });
    if let Some(rate) = document.sweeps_per_core_s {
        println!("{rate:.1} sweeps a second and core");
    }
    if let Some(hours) = document.core_h_per_15600_sweeps {
        println!("15,600 sweeps (78 objects, 200 each) at this rate: {hours:.2} core hours");
    }
}

fn bar() -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} sweeps, {eta} left") {
        bar.set_style(style);
    }
    bar
}
