//! Claimed against observed coverage on simulated sensors, and what breaks it.
#![allow(
    clippy::needless_range_loop,
    reason = "one index for both moments, as in the formulas"
)]

use crate::support::Plant;
use wcal_gpr::{
    FitOptions, Kernel, MapKind, MapPredictor, Process, ProcessModel, Trend, binomial_bounds,
    fit_map, half95,
};

const DRAWS: u64 = 120;

/// Draws whose new label at one fresh reading lies in its stated 95 % interval, per moment (one a
/// draw: independent).
fn hits(plant: &Plant, candidates: &[MapKind], inflate: bool) -> [usize; 2] {
    let mut hits = [0, 0];
    for seed in 0..DRAWS {
        let training = plant.draw(9, 1000 + seed);
        let fresh = plant.draw(1, 900_000 + seed);
        let options = FitOptions {
            candidates: candidates.to_vec(),
            ..FitOptions::default()
        };
        let mut artefact = fit_map(&training, &options).unwrap().artefact;
        if !inflate {
            artefact.outputs.iter_mut().for_each(|o| o.inflation = 1.0);
        }
        // The innermost reading of a fresh trajectory lies well inside the region.
        let p = MapPredictor::new(&artefact)
            .unwrap()
            .predict(fresh.shifts_pm[0]);
        for m in 0..2 {
            hits[m] +=
                usize::from((fresh.moments_nmm[0][m] - p.moment_nmm[m]).abs() <= p.half95_nmm[m]);
        }
    }
    hits
}

#[test]
fn intervals_of_the_affine_map_cover_an_affine_sensor() {
    let found = hits(
        &Plant {
            bend: 0.0,
            noise_nmm: 0.1,
        },
        &[MapKind::Affine],
        false,
    );
    let bounds = binomial_bounds(DRAWS as usize, 0.95);
    assert!(
        found.iter().all(|h| (bounds[0]..=bounds[1]).contains(h)),
        "{found:?} of {DRAWS}, bounds {bounds:?}"
    );
}

#[test]
fn intervals_of_the_thin_plate_cover_a_bent_sensor() {
    let plant = Plant {
        bend: 0.3,
        noise_nmm: 0.03,
    };
    let bounds = binomial_bounds(DRAWS as usize, 0.95);
    let found = hits(&plant, &[MapKind::ThinPlate], true);
    assert!(
        found.iter().all(|h| *h >= bounds[0]),
        "{found:?} of {DRAWS}, bounds {bounds:?}"
    );
}

#[test]
fn understated_noise_is_seen_as_missing_coverage() {
    let training = Plant {
        bend: 0.0,
        noise_nmm: 0.1,
    }
    .draw(20, 5);
    let inputs: Vec<[f64; 2]> = training
        .shifts_pm
        .iter()
        .map(|s| s.map(|v| v / 60.0))
        .collect();
    let singles: Vec<Vec<usize>> = (0..inputs.len()).map(|i| vec![i]).collect();
    let inside = |noise_nmm: f64| {
        let model = ProcessModel {
            trend: Trend::Affine,
            kernel: Kernel::None,
            nugget: 1.0,
            fixed_variance: Some(noise_nmm * noise_nmm),
        };
        let left = Process::fit(model, &inputs, &training.moment_nmm(0))
            .unwrap()
            .leave_out(&singles);
        left.iter()
            .filter(|e| e.error.abs() <= half95(e.dof) * e.sd)
            .count()
    };
    let bounds = binomial_bounds(inputs.len(), 0.95);
    assert!(
        inside(0.1) >= bounds[0],
        "{} of {}",
        inside(0.1),
        inputs.len()
    );
    assert!(
        inside(0.03) < bounds[0],
        "{} of {}",
        inside(0.03),
        inputs.len()
    );
}

#[test]
fn the_thin_plate_is_chosen_where_the_sensor_bends_and_the_affine_map_where_it_does_not() {
    let options = FitOptions {
        candidates: vec![MapKind::Affine, MapKind::ThinPlate, MapKind::Matern52],
        ..FitOptions::default()
    };
    let bent = fit_map(
        &Plant {
            bend: 0.5,
            noise_nmm: 0.01,
        }
        .draw(12, 3),
        &options,
    )
    .unwrap();
    assert_ne!(bent.artefact.name, "affine");
    let straight = fit_map(
        &Plant {
            bend: 0.0,
            noise_nmm: 0.05,
        }
        .draw(12, 3),
        &options,
    )
    .unwrap();
    assert_eq!(straight.artefact.name, "affine");
}
