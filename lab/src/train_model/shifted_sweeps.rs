//! Sweep series that calibrate the stated regions: held-out objects on whiskers that differ from
//! the one trained on. All of them are SIMULATED.

use super::request::TrainingRequest;
use crate::LabError;
use crate::generate_sweeps::{SweepRequest, generate_sweeps};
use crate::sweep_series;
use crate::sweep_series::SweepSeries;
use crate::train::{SensorErrors, uniform};
use crate::training_sweeps::friction_plan;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_network::filter::FilterBank;

/// Wires, and sweeps over each held-out object with each: fewer where many objects are held out (a
/// split by sweeps).
const WIRES: u64 = 8;
const SWEEPS: usize = 5;
const SWEEPS_OF_WIRE: usize = 60;
/// How far a wire may be from the declared one: straight part and radius of the tip, mm, Young's
/// modulus, share. Assumed, not measured: twice what the virtual bench of `wcal-lab evaluate` is
/// off.
const STRAIGHT_MM: f64 = 0.2;
const RADIUS_MM: f64 = 0.3;
const YOUNGS: f64 = 0.03;

/// Sweeps, each with filters that have the measurement noise of its bench.
pub(super) type SweepsWithFilters = Vec<(SweepSeries, FilterBank)>;

/// A wire as it may be where this one is declared.
fn perturbed_whisker(declared: &WhiskerSpec, rng: &mut ChaCha8Rng) -> WhiskerSpec {
    let mut off = |max: f64| uniform(rng, -max, max);
    let stiffer = 1.0 + off(YOUNGS);
    let rest_shape = match &declared.rest_shape {
        RestShape::StraightArc {
            straight_mm,
            arc_radius_mm,
            length_mm,
        } => RestShape::StraightArc {
            straight_mm: straight_mm + off(STRAIGHT_MM),
            arc_radius_mm: arc_radius_mm + off(RADIUS_MM),
            length_mm: *length_mm,
        },
        polyline => polyline.clone(),
    };
    WhiskerSpec {
        youngs_gpa: declared.youngs_gpa * stiffer,
        shear_gpa: declared.shear_gpa * stiffer,
        rest_shape,
        ..declared.clone()
    }
}

/// Held-out objects under other wires than the declared one, with friction, weight and the drag of
/// air; where an object's mesh is not known, its sweeps as they are, of every kind that was trained
/// on. Each on a bench of its own.
pub(super) fn on_shifted_sensors(
    request: &TrainingRequest<'_>,
    objects: &[String],
    held_out: &[SweepSeries],
) -> Result<SweepsWithFilters, LabError> {
    let mut rng = ChaCha8Rng::seed_from_u64(request.settings.seed ^ 0xbe_4c4);
    let plan = friction_plan();
    let names: BTreeSet<&String> = held_out.iter().map(|c| &c.object).collect();
    let (known, unknown): (Vec<&String>, Vec<&String>) = names
        .into_iter()
        .partition(|n| request.meshes.contains_key(*n));
    let sweeps = (SWEEPS_OF_WIRE / known.len().max(1)).clamp(1, SWEEPS);
    let mut all = Vec::new();
    for wire in 0..WIRES {
        let whisker = perturbed_whisker(&request.whisker, &mut rng);
        for mesh in known.iter().filter_map(|n| request.meshes.get(*n)) {
            let seed = request.settings.seed ^ (wire + 1) << 40;
            let order = SweepRequest {
                whisker: &whisker,
                plan: &plan,
                seed,
                sweeps,
            };
            all.extend(generate_sweeps(mesh, &order)?);
        }
    }
    let some = |all_series: &mut dyn Iterator<Item = &SweepSeries>| -> Vec<SweepSeries> {
        all_series.take(WIRES as usize * SWEEPS).cloned().collect()
    };
    for name in &unknown {
        all.extend(some(&mut held_out.iter().filter(|c| c.object == **name)));
    }
    for folder in request.additional.iter().filter(|_| !unknown.is_empty()) {
        // Objects that are held out need not be among the other folder's.
        for all_series in sweep_series::read_sweep_series(folder, &[])?
            .iter()
            .filter(|(n, _)| objects.contains(n))
        {
            all.extend(some(&mut all_series.1.iter()));
        }
    }
    let on_bench = |series: &SweepSeries| {
        let errors = SensorErrors::draw(&request.settings, &mut rng);
        (
            errors.apply(series, &mut rng),
            errors.with_measurement_noise(request.settings.filters()),
        )
    };
    Ok(all.iter().map(on_bench).collect())
}
