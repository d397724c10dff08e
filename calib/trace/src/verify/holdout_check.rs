//! Stage 11, the last word: do the unsealed readings agree with the accepted model within noise and parameter uncertainty?

use super::predictions::Predicted;
use crate::candidate::System;
use crate::engine::fit::{Weights, fit};
use crate::engine::inference::covariance;
use crate::engine::noise_parts::Noise;
use crate::engine::search::Hypothesis;
use crate::engine::tails::Tails;
use crate::whisker::WhiskerSystem;
use nalgebra::{DMatrix, DVector, RowVector2};
use statrs::distribution::{ContinuousCDF, FisherSnedecor, Normal, StudentsT};

/// Level of the check: far below the gate's, since a memory effect's curvature is only linearised here.
pub const HOLDOUT_LEVEL: f64 = 1e-4;
/// Family-wise level of single held-out readings.
const SINGLE_LEVEL: f64 = 1e-3;
/// More of them than this share are no single readings.
const MAX_SHARE: f64 = 0.08;

/// Held-out readings that no tails of the noise explain, as in the fit: single slips are no misfit.
#[must_use]
pub fn flagged(whole: &WhiskerSystem, noise: &Noise, after: &[Predicted]) -> Vec<usize> {
    let readings = &whole.path.readings;
    let rows: Vec<usize> = (0..readings.len()).filter(|&i| readings[i].holdout).collect();
    let (sd, factor) = (noise.reading_sd(&whole.noise_inputs()), whole.noise_factor());
    let size = |i: usize| {
        let off = |c: usize| (readings[i].shift_pm[c] - after[i].shift_pm[c]).abs() / (sd[i] * factor);
        off(0).max(off(1))
    };
    let tail = |x: f64| match noise.tails {
        Some(t) if t.heaviest.is_finite() => {
            let scaled = x * noise_scale(&t);
            StudentsT::new(0.0, 1.0, t.heaviest).map_or(1.0, |d| 2.0 * d.sf(scaled))
        }
        _ => 2.0 * Normal::standard().sf(x),
    };
    let level = SINGLE_LEVEL / (2 * rows.len().max(1)) as f64;
    let out: Vec<usize> = rows.iter().copied().filter(|&i| tail(size(i)) < level).collect();
    if out.len() as f64 > MAX_SHARE * rows.len() as f64 + 1.0 { Vec::new() } else { out }
}

/// From standard deviations to the scale of the heaviest tails.
fn noise_scale(tails: &Tails) -> f64 {
    1.0 / tails.heaviest_scale.max(1e-3)
}

/// p-value of the held-out residuals under the accepted model and the upper ends of its noise's parts, parameter covariance included
/// (prediction F test; Seber & Lee, "Linear Regression Analysis", 2nd ed., ch. 5). `left_out` are single readings that do not belong.
#[must_use]
pub fn holdout_p(
    whole: &WhiskerSystem,
    accepted: &Hypothesis,
    noise: &Noise,
    after: &[Predicted],
    left_out: &[usize],
) -> Option<f64> {
    let readings = &whole.path.readings;
    let rows: Vec<usize> =
        (0..readings.len()).filter(|i| readings[*i].holdout && !left_out.contains(i)).collect();
    if rows.is_empty() {
        return None;
    }
    // Tangents at the fitted values on every reading; the coefficients of this call are not used.
    let local = fit(whole, &accepted.fit.terms, &Weights::equal(readings.len()), 0)?;
    let (q, m) = (local.design.ncols(), local.tangents.len());
    let spread = covariance(&accepted.fit, 1.0);
    if spread.nrows() != 2 * q + m {
        return None;
    }
    let apart = whole.channels_pm().try_inverse()?;
    let count = 2 * rows.len();
    let mut jacobian = DMatrix::zeros(count, 2 * q + m);
    let mut residual = DVector::zeros(count);
    for (k, &i) in rows.iter().enumerate() {
        let left = RowVector2::from_fn(|_, c| readings[i].shift_pm[c] - after[i].shift_pm[c]) * &apart;
        for c in 0..2 {
            let row = 2 * k + c;
            for j in 0..q {
                jacobian[(row, c * q + j)] = local.design[(i, j)];
            }
            for (j, t) in local.tangents.iter().enumerate() {
                jacobian[(row, 2 * q + j)] = t[(i, c)];
            }
            residual[row] = left[c];
        }
    }
    // Both channels share one law of the noise; rows stand channel by channel within a reading.
    let own = noise.weights_of(&whole.noise_inputs(), true).covariance(&rows);
    let own = DMatrix::from_fn(count, count, |a, b| if a % 2 == b % 2 { own[(a / 2, b / 2)] } else { 0.0 });
    let shape = own + &jacobian * spread * jacobian.transpose();
    let mut whitened = shape.cholesky()?.l().solve_lower_triangular(&residual)? / noise.repeat.value;
    if let Some(tails) = noise.tails.filter(|t| t.heavy && t.heaviest.is_finite()) {
        // Each value as far out as a Gaussian would have it with the same chance.
        let (t, normal) = (StudentsT::new(0.0, 1.0, tails.heaviest).ok()?, Normal::standard());
        let scale = noise_scale(&tails);
        whitened.apply(|w| {
            *w = w.signum() * normal.inverse_cdf(1.0 - t.sf(w.abs() * scale).clamp(1e-300, 0.5)).min(30.0)
        });
    }
    let f = whitened.norm_squared() / count as f64;
    FisherSnedecor::new(count as f64, accepted.fit.dof.max(1.0)).ok().map(|d| d.sf(f))
}
