//! An existing calibration at the readings of a session, against the moments of the poses.

use super::physical::PhysicalModel;
use super::system::WhiskerSystem;
use crate::EffectTerm;
use crate::levels::NORMAL_95;
use crate::verify::{HeldOut, Quantity};
use wcal_core::stream::{MomentStream, StreamMoments};
use wcal_gpr::{MapArtefact, MapPredictor};

/// Only moments are judged: a map has no other prediction.
pub const QUANTITIES: [Quantity; 1] = [Quantity {
    key: "moment_rmse_nmm",
    unit: "N mm",
}];

/// Moments that a calibration gives at the readings, or at those that were sealed, against `base`,
/// those of the poses, N mm.
fn judged(
    system: &WhiskerSystem,
    inferred: &[StreamMoments],
    base: &[[f64; 2]],
    only_sealed: bool,
) -> Vec<HeldOut> {
    let readings = &system.path.readings;
    let of = |i: usize| {
        let (sd, moment) = (inferred[i].sd_nmm, inferred[i].moment_nmm);
        let error = [0, 1].map(|c| moment[c] - base[i][c]);
        let inside = |c: usize| error[c].abs() <= NORMAL_95 * sd[c];
        HeldOut {
            group: readings[i].group,
            errors: vec![error.to_vec()],
            stated_sd: vec![sd.to_vec()],
            inside95: vec![inside(0), inside(1)],
        }
    };
    let judged = |i: &usize| match only_sealed {
        true => system.scored[*i],
        false => !readings[*i].rest,
    };
    (0..readings.len()).filter(judged).map(of).collect()
}

/// Through sensitivity and accepted effects; those that act on the pose act on the moments that it
/// is judged by. None where the rod has no equilibrium at the poses.
pub fn of_model(
    system: &WhiskerSystem,
    model: &PhysicalModel,
    only_sealed: bool,
) -> Option<Vec<HeldOut>> {
    let terms: Vec<EffectTerm> = model.terms().into_iter().map(|a| a.term).collect();
    let (memory, base) = system.memory(&terms)?;
    let inferred = model.infer(&system.path, Some(&memory));
    Some(judged(system, &inferred, &base, only_sealed))
}

/// Through a map of moments; none where it or the rod cannot be used.
pub fn of_map(
    system: &WhiskerSystem,
    map: &MapArtefact,
    only_sealed: bool,
) -> Option<Vec<HeldOut>> {
    let mut predictor = MapPredictor::new(map).ok()?;
    // A map corrects no pose: the poses are taken as declared.
    let (_, base) = system.moments(&[])?;
    let readings = system.path.readings.iter();
    let inferred: Vec<StreamMoments> = readings
        .map(|r| predictor.moments(r.t_s, r.shift_pm, r.rise_degc))
        .collect();
    Some(judged(system, &inferred, &base, only_sealed))
}
