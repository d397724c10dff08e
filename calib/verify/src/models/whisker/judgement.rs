//! An existing calibration at the readings of a session, against the moments of the poses.

use super::physical::PhysicalModel;
use super::system::WhiskerSystem;
use crate::effect::EffectTerm;
use crate::levels::NORMAL_95;
use crate::verify::HeldOut;
use crate::verify::session_model::Quantity;
use wcal_gpr::{MapArtefact, MapPredictor};

/// Only moments are judged: a map has no other prediction.
pub const QUANTITIES: [Quantity; 1] = [Quantity {
    key: "moment_rmse_nmm",
    unit: "N mm",
}];

fn judged_reading(group: u32, inferred: [f64; 2], sd: [f64; 2], pose: [f64; 2]) -> HeldOut {
    let error = [0, 1].map(|c| inferred[c] - pose[c]);
    let inside95 = (0..2)
        .map(|c| error[c].abs() <= NORMAL_95 * sd[c])
        .collect();
    HeldOut {
        group,
        errors: vec![error.to_vec()],
        stated_sd: vec![sd.to_vec()],
        inside95,
    }
}

/// Readings to be judged: all, or those that were sealed.
fn scored_readings(system: &WhiskerSystem, only_sealed: bool) -> Vec<usize> {
    let [_, scored] = system.held_out();
    let readings = &system.path.readings;
    (0..readings.len())
        .filter(|&i| {
            if only_sealed {
                scored[i]
            } else {
                !readings[i].rest
            }
        })
        .collect()
}

/// Through sensitivity and accepted effects; those that act on the pose act on the moments that it
/// is judged by. None where the rod has no equilibrium at the poses.
pub fn of_model(
    system: &WhiskerSystem,
    model: &PhysicalModel,
    only_sealed: bool,
) -> Option<Vec<HeldOut>> {
    let terms: Vec<EffectTerm> = model.terms().into_iter().map(|a| a.term).collect();
    let (sensed, base) = system.moments(&terms)?;
    let memory: Vec<[f64; 2]> = base
        .iter()
        .zip(&sensed)
        .map(|(b, f)| [b[0] - f[0], b[1] - f[1]])
        .collect();
    let inferred = model.infer(&system.path, Some(&memory));
    let of = |i: usize| {
        let m = &inferred[i];
        judged_reading(
            system.path.readings[i].group,
            m.moment_nmm,
            m.sd_nmm,
            base[i],
        )
    };
    Some(
        scored_readings(system, only_sealed)
            .into_iter()
            .map(of)
            .collect(),
    )
}

/// Through a map of moments; none where it or the rod cannot be used.
pub fn of_map(
    system: &WhiskerSystem,
    map: &MapArtefact,
    only_sealed: bool,
) -> Option<Vec<HeldOut>> {
    let predictor = MapPredictor::new(map).ok()?;
    let (_, base) = system.moments(&[])?;
    let mut of = |i: usize| {
        let p = predictor.predict(system.path.readings[i].shift_pm);
        judged_reading(
            system.path.readings[i].group,
            p.moment_nmm,
            p.sd_nmm,
            base[i],
        )
    };
    Some(
        scored_readings(system, only_sealed)
            .into_iter()
            .map(&mut of)
            .collect(),
    )
}
