//! Leave-one-out errors of the map from wavelengths to moments: what a map gains from repaired labels and accepted effects.

use crate::whisker::path::{Reading, WhiskerPath};
use wcal_core::verify_document::MapLeftOut;
use wcal_map::{CandidateFit, FitOptions, MapTraining, fit_map};

/// Readings beyond which leaving one out says nothing that leaving a trajectory out does not.
const MAX_READINGS: usize = 120;

/// Errors of the affine map and of the one that the data choose, trained on `moments` (N mm, one a reading); none where the session has
/// many readings or too few for a map.
pub(super) fn leave_one_out(path: &WhiskerPath, moments: &[[f64; 2]]) -> Option<MapLeftOut> {
    let readings = &path.readings;
    if readings.len() > MAX_READINGS || moments.len() != readings.len() {
        return None;
    }
    let mut poses = Vec::new();
    let mut group = |r: &Reading| -> u32 {
        // Readings at one place to 1 um are one pose, and so are all at rest.
        let pose = (!r.rest).then_some((r.group, (r.x_mm * 1e3).round() as i64));
        let known = poses.iter().position(|p| *p == pose);
        known.unwrap_or_else(|| {
            poses.push(pose);
            poses.len() - 1
        }) as u32
    };
    let training = MapTraining {
        shifts_pm: readings.iter().map(|r| r.shift_pm).collect(),
        moments_nmm: moments.to_vec(),
        trajectory: readings.iter().map(|r| (!r.rest).then_some(r.group)).collect(),
        pose: readings.iter().map(&mut group).collect(),
        point: (0..readings.len() as i64).collect(),
        noise_sd_pm: None,
    };
    let fit = fit_map(&training, &FitOptions::default()).ok()?;
    let error = |c: &CandidateFit| {
        let each = [0, 1].map(|m| c.loo[m].rmse_nmm);
        MapLeftOut {
            map: c.name.to_owned(),
            moment_rmse_nmm: (0.5 * (each[0] * each[0] + each[1] * each[1])).sqrt(),
            moment_rmse_nmm_each: each,
            points: readings.len(),
            chosen: None,
        }
    };
    let chosen = &fit.candidates[fit.choice.chosen];
    let affine = fit.candidates.iter().find(|c| c.name == "affine")?;
    let other = (chosen.name != affine.name).then(|| Box::new(error(chosen)));
    Some(MapLeftOut { chosen: other, ..error(affine) })
}
