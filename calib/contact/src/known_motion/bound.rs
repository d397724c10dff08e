//! The smallest covariance that an estimate of the contact can have: the Bayesian Cramer-Rao bound.
//!
//! ```text
//! E[(P^ - P)(P^ - P)^T] >= T J^-1 T^T,   T = dP/dtheta,   theta = (s, x, g)
//! J = G^T S^-1 G + diag(12 / L_s^2, 12 / L_x^2, 1 / s_g^2),   G = dm/dtheta
//! ```
//!
//! A uniform prior has no Fisher information of its own; those of s and x (widths L_s, L_x) count as Gaussians of their variance L^2 / 12.
//! Source: H. L. Van Trees, "Detection, Estimation, and Modulation Theory" I, 1968, 2.4.3.

use super::contact_path::{ContactPath, State};
use super::likelihood::{Likelihood, moved};
use super::{Episode, MomentField, Settings};
use crate::ContactError;
use nalgebra::{Matrix3, Vector3};

/// Bayesian Cramer-Rao bound of the contact point at an episode's true state, mm^2: `T J^-1 T'` of the module's head.
/// None where the rod has no derivative there.
///
/// # Errors
/// Where the covariance of the moments is not positive definite.
pub fn bound_mm2(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    truth: &State,
) -> Result<Option<Matrix3<f64>>, ContactError> {
    let Some(path) = ContactPath::new(field, episode) else { return Ok(None) };
    let plain = Likelihood::new(&path, settings, None)?;
    let likelihood = Likelihood::new(&path, settings, Some((truth, &plain)))?;
    let Some(slopes) = likelihood.slopes(&path, settings, truth) else { return Ok(None) };
    let mut information = slopes.transpose() * &slopes;
    // The uniform priors of arc length and onset as Gaussians of variance L^2 / 12; the gap's is the last residual.
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
) -> Result<Option<f64>, ContactError> {
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
