//! Stage 11, the last word: do the unsealed readings agree with the accepted model within noise and parameter uncertainty?

use super::predictions::Predicted;
use crate::candidate::System;
use crate::engine::fit::{Weights, fit};
use crate::engine::inference::covariance;
use crate::engine::search::Hypothesis;
use crate::whisker::WhiskerSystem;
use nalgebra::{DMatrix, DVector, RowVector2};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Level of the check: far below the gate's, since a memory effect's curvature is only linearised here.
pub const HOLDOUT_LEVEL: f64 = 1e-4;

/// p-value of the held-out residuals under the accepted model, parameter covariance included (prediction F test; Seber & Lee,
/// "Linear Regression Analysis", 2nd ed., ch. 5). None without holdout, or where readings were flagged: single slips are no misfit.
#[must_use]
pub fn holdout_p(whole: &WhiskerSystem, accepted: &Hypothesis, after: &[Predicted]) -> Option<f64> {
    let readings = &whole.path.readings;
    let rows: Vec<usize> = (0..readings.len()).filter(|&i| readings[i].holdout).collect();
    if rows.is_empty() || !accepted.flagged.is_empty() {
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
    let shape = DMatrix::identity(count, count) + &jacobian * spread * jacobian.transpose();
    let whitened = shape.cholesky()?.solve(&residual);
    let f = residual.dot(&whitened) / count as f64 / accepted.fit.variance();
    FisherSnedecor::new(count as f64, accepted.fit.dof.max(1.0)).ok().map(|d| d.sf(f))
}
