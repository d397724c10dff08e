//! Models of one split on the same sweeps (SIMULATED):
//! `compare_models MESHES OBJECTS SWEEPS_EACH SEED MODEL...`
//!
//! Sweeps over the first objects that the models were trained on and the first that they never saw,
//! drawn anew: no model was trained on one of them. Three kinds, as `wcal-lab evaluate` has them:
//! random turns; upright in four faces, without jumps; and another wire (straight part -0.1 mm,
//! radius +0.15 mm, Young's modulus -1.5 %) with friction 0.05 to 0.25, weight and the drag of air,
//! its moments without error. Prints the RMSE from the surface, mean over objects with its 95 %
//! interval, mm, and the share of 90 % regions that hold the true contact.
#![allow(missing_docs, clippy::print_stdout, reason = "an example")]

use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_lab::SweepSeries;
use wcal_lab::bootstrap::mean_interval95;
use wcal_lab::evaluate::{Method, ObjectScores, score_objects};
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab::model_file::{Card, load};
use wcal_lab_sweeps::physics::{Medium, PhysicsPlan};
use wcal_lab_sweeps::{SweepPlan, Turn, objects};
use wcal_mesh::Mesh;
use wcal_network::Tracker;

type Failure = Box<dyn std::error::Error>;
type Series = BTreeMap<String, Vec<SweepSeries>>;
type Meshes = BTreeMap<String, Mesh>;

/// Sweeps that are trained on have small seeds: the same number must not draw the same ones here.
const DRAWN_ANEW: u64 = 0x636f_6d70_6172_6500;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().collect();
    let [_, meshes, count, each, seed, models @ ..] = &args[..] else {
        return Err("compare_models MESHES OBJECTS SWEEPS_EACH SEED MODEL...".into());
    };
    let (count, each, seed): (usize, usize, u64) = (count.parse()?, each.parse()?, seed.parse()?);
    let all: Vec<(Tracker, Card)> = models
        .iter()
        .map(|m| load(Path::new(m)))
        .collect::<Result<_, _>>()?;
    let first = &all.first().ok_or("expected a model")?.1;
    if all.iter().any(|(_, card)| card.objects != first.objects) {
        return Err("expected models of one split".into());
    }
    let of = |names: &[String]| -> Result<Meshes, Failure> {
        let named = |n: &String| Ok((n.clone(), objects::named(n, Some(Path::new(meshes)))?));
        names.iter().take(count).map(named).collect()
    };
    let sets = [of(&first.objects.training)?, of(&first.objects.unseen)?];
    println!(
        "{:<34} {:<24} {:<26} {:<26} regions",
        "sweeps (SIMULATED)", "model", "seen, mm", "unseen, mm"
    );
    for (kind, whisker, plan, each) in kinds(&first.whisker, each) {
        let request = SweepRequest {
            whisker: &whisker,
            plan: &plan,
            seed: seed ^ DRAWN_ANEW,
            sweeps: each,
        };
        let series = [swept(&sets[0], &request)?, swept(&sets[1], &request)?];
        for known in [true, false] {
            for ((tracker, _), name) in all.iter().zip(models) {
                let method = Method::Network(tracker, known);
                let score = |k: usize| {
                    score_objects(&|c: &SweepSeries| method.run(c), &series[k], &sets[k])
                };
                let rows = [score(0)?, score(1)?];
                let speed = if known { "known" } else { "not known" };
                let [seen, unseen] = [0, 1].map(|k| mean(&rows[k]));
                let held = rows.iter().flatten().filter_map(|o| o.all.coverage90);
                let held = held.sum::<f64>() / (rows[0].len() + rows[1].len()) as f64;
                let name = Path::new(name)
                    .file_name()
                    .unwrap_or_default()
                    .to_string_lossy();
                println!(
                    "{:<34} {name:<24} {seen:<26} {unseen:<26} {held:.2}",
                    format!("{kind}, speed {speed}")
                );
            }
        }
    }
    Ok(())
}

/// Name, wire, plan, and sweeps over an object.
fn kinds(whisker: &WhiskerSpec, each: usize) -> [(&'static str, WhiskerSpec, SweepPlan, usize); 3] {
    let random = SweepPlan {
        rate_hz: 10.0,
        ..SweepPlan::default()
    };
    let upright = SweepPlan {
        turn: Turn::Faces,
        keep_jumps: false,
        step_mm: 0.1,
        ..random.clone()
    };
    let physics = PhysicsPlan {
        friction: [0.05, 0.25],
        medium: Medium::Air,
        weight: true,
        ..PhysicsPlan::default()
    };
    let mut other = whisker.clone();
    if let RestShape::StraightArc {
        straight_mm,
        arc_radius_mm,
        ..
    } = &mut other.rest_shape
    {
        (*straight_mm, *arc_radius_mm) = (*straight_mm - 0.1, *arc_radius_mm + 0.15);
    }
    (other.youngs_gpa, other.shear_gpa) = (other.youngs_gpa * 0.985, other.shear_gpa * 0.985);
    let friction = SweepPlan {
        physics,
        ..random.clone()
    };
    [
        ("random turns", whisker.clone(), random, each),
        (
            "upright",
            whisker.clone(),
            upright,
            each.next_multiple_of(4),
        ),
        ("other wire, friction", other, friction, each),
    ]
}

fn swept(meshes: &Meshes, request: &SweepRequest<'_>) -> Result<Series, Failure> {
    let one = |(name, mesh): (&String, &Mesh)| Ok((name.clone(), generate_sweeps(mesh, request)?));
    let all: Result<Series, Failure> = meshes.iter().map(one).collect();
    all.map(|mut all| {
        all.retain(|_, series| !series.is_empty());
        all
    })
}

fn mean(rows: &[ObjectScores]) -> String {
    let mean = rows.iter().map(|o| o.all.rmse_mm).sum::<f64>() / rows.len().max(1) as f64;
    mean_interval95(rows, |s| s.surface).map_or_else(
        || format!("{mean:.2}"),
        |[low, high]| format!("{mean:.2} [{low:.2}, {high:.2}]"),
    )
}
