//! The last word: do the unsealed readings agree with the accepted model within noise and parameter uncertainty?

use super::session_model::SessionModel;
use crate::method::fit::{Weights, fit};
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use crate::method::linear::stack;
use crate::method::noise::Noise;
use crate::method::noise::tails::Tails;
use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, FisherSnedecor, Normal, StudentsT};

/// Level of the check: far below the omnibus test's, since a memory effect's curvature is only linearised here.
pub const HOLDOUT_LEVEL: f64 = 1e-4;
/// Family-wise level of single held-out readings.
const SINGLE_LEVEL: f64 = 1e-3;
/// More of them than this share are no single readings; of fewer than ten none is.
const MAX_SHARE: f64 = 0.1;

/// Measured less predicted at every reading of `whole`, in the engine's channels.
fn residual<M: SessionModel>(whole: &M, h: &Hypothesis) -> Option<DMatrix<f64>> {
    Some(whole.measured() - whole.design(&h.fit.terms)? * &h.fit.coefficients)
}

/// Unsealed readings that no tails of the noise explain, as in the fit: single slips are no misfit.
pub fn flagged<M: SessionModel>(whole: &M, h: &Hypothesis, noise: &Noise) -> Vec<usize> {
    let rows: Vec<usize> = (0..whole.scored().len()).filter(|&i| whole.scored()[i]).collect();
    let Some(left) = residual(whole, h).filter(|_| noise.repeat.value > 0.0) else { return Vec::new() };
    let sd = noise.reading_sd(&whole.noise_inputs());
    let size = |i: usize| left.row(i).amax() / sd[i];
    let tail = |x: f64| match noise.tails {
        Some(t) if t.heaviest.is_finite() => {
            let scaled = x * noise_scale(&t);
            StudentsT::new(0.0, 1.0, t.heaviest).map_or(1.0, |d| 2.0 * d.sf(scaled))
        }
        _ => 2.0 * Normal::standard().sf(x),
    };
    let level = SINGLE_LEVEL / (left.ncols() * rows.len().max(1)) as f64;
    let out: Vec<usize> = rows.iter().copied().filter(|&i| tail(size(i)) < level).collect();
    if out.len() as f64 > MAX_SHARE * rows.len() as f64 { Vec::new() } else { out }
}

/// From standard deviations to the scale of the heaviest tails.
fn noise_scale(tails: &Tails) -> f64 {
    1.0 / tails.heaviest_scale.max(1e-3)
}

/// p-value of the held-out residuals under the accepted model and the upper ends of its noise's parts, parameter covariance included
/// (prediction F test; Seber & Lee, "Linear Regression Analysis", 2nd ed., ch. 5). `left_out` are single readings that do not belong.
pub fn holdout_p<M: SessionModel>(
    whole: &M,
    accepted: &Hypothesis,
    noise: &Noise,
    left_out: &[usize],
) -> Option<f64> {
    let n = whole.scored().len();
    let rows: Vec<usize> = (0..n).filter(|i| whole.scored()[*i] && !left_out.contains(i)).collect();
    if rows.is_empty() || !(noise.repeat.value > 0.0) {
        return None;
    }
    // Tangents at the fitted values on every reading; the coefficients of this call are not used.
    let local = fit(whole, &accepted.fit.terms, &Weights::equal(n), 0)?;
    let left = residual(whole, accepted)?;
    // Rows stand channel by channel within a reading.
    let channels = left.ncols();
    let at: Vec<usize> = rows.iter().flat_map(|i| (0..channels).map(move |c| c * n + i)).collect();
    let (count, jacobian, off) = (at.len(), local.jacobian().select_rows(&at), stack(&left).select_rows(&at));
    let spread = covariance(&accepted.fit, 1.0);
    if spread.nrows() != jacobian.ncols() {
        return None;
    }
    // All channels share one law of the noise.
    let own = noise.weights_of(&whole.noise_inputs(), true).covariance(&rows);
    let own = DMatrix::from_fn(count, count, |a, b| {
        if a % channels == b % channels { own[(a / channels, b / channels)] } else { 0.0 }
    });
    let shape = own + &jacobian * spread * jacobian.transpose();
    let mut whitened = shape.cholesky()?.l().solve_lower_triangular(&off)? / noise.repeat.value;
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
