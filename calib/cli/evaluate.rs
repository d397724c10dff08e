//! `wcal evaluate`: a trained tracker beside the baselines, on sweeps that it did not see.

mod tables;
mod virtual_bench;

use crate::picture_output::{provenance, write};
use crate::train::burn_device;
use anyhow::{Context, ensure};
use clap::Args;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use wcal_mujoco::{Mesh, objects};
use wcal_track::bayes::BayesSettings;
use wcal_track::evaluate::{Method, ObjectScores, over_objects};
use wcal_track::model_file::load;
use wcal_track::{Course, InverseGrid, Sample, StaticInverse, Tracker, course};

/// Arguments of `wcal evaluate`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal evaluate sweeps --model model --meshes ycb/meshes --out evaluation

Scores the objects that the model's card calls unseen, and the sweeps over the other objects that were kept back. Everything here is
SIMULATED. Writes evaluation.json.")]
pub struct EvaluateArgs {
    /// Folder of shards from `wcal simulate`
    pub sweeps: PathBuf,
    /// Folder of `wcal train`
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
    /// Seed of the virtual bench and of the sweeps that are drawn on the spot
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Leave out the virtual real bench, the tables over speed and medium, and the ablations
    #[arg(long)]
    pub simulation_only: bool,
    /// Print the document on stdout
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// Where model, sweeps or meshes cannot be used.
pub fn run(args: &EvaluateArgs) -> anyhow::Result<ExitCode> {
    let (tracker, card) = load(&args.model, &burn_device())?;
    let pick = |names: &[String], from: u64| -> anyhow::Result<BTreeMap<String, Vec<Course>>> {
        let names: Vec<String> = names.iter().take(args.objects).cloned().collect();
        if names.is_empty() {
            return Ok(BTreeMap::new());
        }
        let mut courses = course::read_courses(&args.sweeps, &names)?;
        for of_object in courses.values_mut() {
            of_object.retain(|c| c.sweep >= from);
            of_object.truncate(args.sweeps_each);
        }
        courses.retain(|_, c| !c.is_empty());
        Ok(courses)
    };
    let sets = [
        ("seen", pick(&card.objects.training, card.sweeps_trained)?),
        ("unseen", pick(&card.objects.unseen, 0)?),
    ];
    ensure!(sets.iter().any(|s| !s.1.is_empty()), "{}: no sweep that was kept back", args.sweeps.display());
    let fine = StaticInverse::new(&card.whisker, InverseGrid::default())?;
    // Two thirds out: the middle of what sweeps touch.
    let middle = fine.nodes.last().map_or(40.0, |n| n.arclength_mm) * 2.0 / 3.0;
    let settings = BayesSettings::default();
    let methods = [
        ("network, speed known", Method::Network(&tracker, true)),
        ("network", Method::Network(&tracker, false)),
        ("bayes, speed known", Method::Bayes(&fine, true, settings)),
        ("bayes", Method::Bayes(&fine, false, settings)),
        ("static inverse", Method::Static(&fine, middle)),
        ("constant", Method::Constant([middle, 0.0, 0.0].into())),
    ];
    let mut rows: Vec<(&str, &str, Vec<ObjectScores>)> = Vec::new();
    for (set, courses) in &sets {
        let meshes = meshes(courses.keys(), args)?;
        for (name, method) in methods {
            rows.push((set, name, over_objects(&|c: &Course| method.run(c), courses, &meshes)?));
        }
    }
    let streaming = streaming(&tracker, sets.iter().flat_map(|s| s.1.values().flatten()));
    let mut document = document(&rows, &streaming, &card.weights_sha256, args);
    if !args.simulation_only {
        let folder = tempfile::tempdir().context("making a folder for what is in between")?;
        let maker = tables::Maker { tracker: &tracker, card: &card, args, folder: folder.path() };
        for (name, table) in maker.tables()? {
            document[name] = table;
        }
    }
    write(
        &args.out,
        "evaluation.json",
        format!("{}\n", serde_json::to_string_pretty(&document)?).as_bytes(),
    )?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        print(&rows);
        println!("streaming: {} samples/s, p99 {} us", streaming["samples_per_s"], streaming["p99_us"]);
        print_tables(&document);
    }
    Ok(ExitCode::SUCCESS)
}

fn meshes<'a>(
    names: impl Iterator<Item = &'a String>,
    args: &EvaluateArgs,
) -> anyhow::Result<BTreeMap<String, Mesh>> {
    names
        .map(|name| {
            let mesh = match objects::built_in(name) {
                Ok(mesh) => mesh,
                Err(_) => {
                    let folder = args
                        .meshes
                        .as_ref()
                        .with_context(|| format!("object {name}: expected --meshes DIR"))?;
                    Mesh::read(&folder.join(format!("{name}.stl")))?
                }
            };
            Ok((name.clone(), mesh))
        })
        .collect()
}

/// Samples a second on one core, one by one, and the slowest of a hundred.
fn streaming<'a>(tracker: &Tracker, courses: impl Iterator<Item = &'a Course>) -> Value {
    const SAMPLES: usize = 1000;
    let mut times_us: Vec<f64> = Vec::new();
    for course in courses {
        let mut stream = tracker.stream();
        for i in &course.instants {
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

fn mean(rows: &[ObjectScores], value: impl Fn(&ObjectScores) -> f64) -> f64 {
    rows.iter().map(value).sum::<f64>() / rows.len().max(1) as f64
}

fn document(
    rows: &[(&str, &str, Vec<ObjectScores>)],
    streaming: &Value,
    model: &str,
    args: &EvaluateArgs,
) -> Value {
    let of =
        |set: &str, name: &str| rows.iter().find(|r| r.0 == set && r.1 == name).map_or(&[][..], |r| &r.2[..]);
    let best = "network, speed known";
    let objects: Vec<Value> =
        ["seen", "unseen"].iter().flat_map(|set| of(set, best).iter().map(move |o| object(o, set))).collect();
    let methods: Vec<Value> = rows
        .iter()
        .map(|(set, name, r)| {
            json!({"set": set, "method": name, "rmse_mm": mean(r, |o| o.all.rmse_mm),
                "true_contact_rmse_mm": mean(r, |o| o.all.true_contact_rmse_mm), "p95_mm": mean(r, |o| o.all.p95_mm),
                "followed_rmse_mm": mean(r, |o| o.followed.rmse_mm),
                "followed_true_contact_rmse_mm": mean(r, |o| o.followed.true_contact_rmse_mm),
                "detection_f1": mean(r, |o| o.detection.f1)})
        })
        .collect();
    json!({
        "format": "wcal-evaluation/1", "simulated": true, "model": model, "calibration": null,
        "simulation": {"method": best, "seen_mean_mm": mean(of("seen", best), |o| o.all.rmse_mm),
            "unseen_mean_mm": mean(of("unseen", best), |o| o.all.rmse_mm), "objects": objects},
        "methods": methods, "streaming": streaming,
        "provenance": provenance([args.model.join("model.json").as_path()]),
    })
}

/// An object's row in evaluation.json.
fn object(o: &ObjectScores, set: &str) -> Value {
    json!({"name": o.name, "set": set, "rmse_mm": o.all.rmse_mm, "true_contact_rmse_mm": o.all.true_contact_rmse_mm,
        "along_track_mm": o.all.along_track_mm, "p95_mm": o.all.p95_mm, "coverage90": o.all.coverage90,
        "followed": o.followed, "detection": o.detection})
}

fn print_tables(document: &Value) {
    let number = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
    let real = &document["virtual_real"];
    if real.is_null() {
        return;
    }
    println!(
        "VIRTUAL real bench: seen {:.2}, unseen {:.2}, worst {:.2} mm (verify: {}, accepted {})",
        number(&real["seen_mean_mm"]),
        number(&real["unseen_mean_mm"]),
        number(&real["worst_mm"]),
        real["verdict"],
        real["accepted"]
    );
    let rows = |name: &str| document[name].as_array().cloned().unwrap_or_default();
    for r in rows("ablations") {
        println!(
            "  {:24} {:8.2} {:9.2}",
            r["name"].as_str().unwrap_or(""),
            number(&r["rmse_mm"]),
            number(&r["followed_rmse_mm"])
        );
    }
    let speeds = rows("speed");
    println!("speed mm/s: constant, random (mm)");
    for r in &speeds {
        println!(
            "  {:4.0} {:8.2} {:8.2}",
            number(&r["mm_s"]),
            number(&r["constant_mm"]),
            number(&r["random_mm"])
        );
    }
    println!(
        "  slope {:.3} s, {:.3} s",
        tables::slope_s(&speeds, "constant_mm"),
        tables::slope_s(&speeds, "random_mm")
    );
    println!("simulation, virtual air, virtual water (mm)");
    for r in rows("sim2real") {
        let [s, a, w] = ["simulation_mm", "air_mm", "water_mm"].map(|k| number(&r[k]));
        println!("  {:18} {s:8.2} {a:8.2} {w:8.2}", r["name"].as_str().unwrap_or(""));
    }
}

fn print(rows: &[(&str, &str, Vec<ObjectScores>)]) {
    println!(
        "SIMULATED; mean over objects of the RMSE in mm; followed: 2 mm of the base's way after an onset, jump or slip"
    );
    println!(
        "{:7} {:21} {:>8} {:>9} {:>8} {:>9} {:>8} {:>6}",
        "objects", "method", "surface", "followed", "contact", "followed", "cover90", "F1"
    );
    for (set, name, r) in rows.iter().filter(|r| !r.2.is_empty()) {
        let cover = r.iter().filter_map(|o| o.all.coverage90).collect::<Vec<_>>();
        let cover = if cover.is_empty() {
            "-".to_owned()
        } else {
            format!("{:.3}", cover.iter().sum::<f64>() / cover.len() as f64)
        };
        println!(
            "{set:7} {name:21} {:8.2} {:9.2} {:8.2} {:9.2} {cover:>8} {:6.3}",
            mean(r, |o| o.all.rmse_mm),
            mean(r, |o| o.followed.rmse_mm),
            mean(r, |o| o.all.true_contact_rmse_mm),
            mean(r, |o| o.followed.true_contact_rmse_mm),
            mean(r, |o| o.detection.f1)
        );
    }
}
