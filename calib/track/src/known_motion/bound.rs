//! The smallest covariance that an estimate of the contact can have.

use super::contact_path::{ContactPath, State};
use super::likelihood::{Likelihood, moved};
use super::{Episode, MomentField, Settings};
use crate::TrackError;
use nalgebra::{Matrix3, Vector3};

/// Posterior Cramer-Rao bound of the place at an episode's true state, mm^2: `T J^-1 T'` with `J` of the module's head and `T = dP/dtheta`.
/// None where the rod has no derivative there.
///
/// # Errors
/// Where the covariance of the moments is not positive definite.
pub fn bound_mm2(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    truth: &State,
) -> Result<Option<Matrix3<f64>>, TrackError> {
    let Some(path) = ContactPath::new(field, episode) else { return Ok(None) };
    let plain = Likelihood::new(&path, settings, None)?;
    let likelihood = Likelihood::new(&path, settings, Some((truth, &plain)))?;
    let Some(slopes) = likelihood.slopes(&path, settings, truth) else { return Ok(None) };
    let mut information = slopes.transpose() * &slopes;
    // The even priors of arc length and onset, by their variances.
    information[(0, 0)] += 12.0 / (field.length_mm() - settings.first_mm).powi(2);
    information[(1, 1)] += 12.0 / (path.onset_mm[1] - path.onset_mm[0]).powi(2);
    let (Some(covariance), Some(turn)) = (information.try_inverse(), place_rates(&path, truth)) else {
        return Ok(None);
    };
    let covariance = Matrix3::from_fn(|i, j| covariance[(i, j)]);
    Ok(Some(turn * covariance * turn.transpose()))
}

/// Root of the bound's trace, mm: what an RMS error in space is compared with.
///
/// # Errors
/// As [`bound_mm2`].
pub fn bound_mm(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    truth: &State,
) -> Result<Option<f64>, TrackError> {
    Ok(bound_mm2(field, episode, settings, truth)?.map(|b| b.trace().max(0.0).sqrt()))
}

/// dP/d(s, onset, gap).
fn place_rates(path: &ContactPath<'_>, state: &State) -> Option<Matrix3<f64>> {
    const STEP_MM: f64 = 0.02;
    let columns: Vec<Vector3<f64>> = (0..3)
        .map(|k| {
            let [a, b] = [-STEP_MM, STEP_MM].map(|h| path.place(&moved(state, k, h), 0));
            Some((b? - a?) / (2.0 * STEP_MM))
        })
        .collect::<Option<_>>()?;
    Some(Matrix3::from_columns(&columns))
}
