//! The honest rival of every named effect: a Gaussian process of the declared model's residual on all covariates.
//!
//! Rasmussen & Williams, "Gaussian Processes for Machine Learning" (2006), alg. 2.1 and eq. 5.8: Matern 5/2 over the standardised
//! covariates, length and signal chosen by the evidence on the fitted readings. It names nothing; an explanation that it beats is missing something.

use super::heldout::HeldOut;
use super::predictions::{Predicted, of_reading};
use crate::candidate::System;
use crate::whisker::WhiskerSystem;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Vector2};

/// Lengths, in root of the number of covariates (standardised).
const LENGTHS: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
/// Signal over noise variance.
const SIGNALS: [f64; 5] = [0.1, 0.5, 2.0, 8.0, 32.0];

/// Standardised covariates, readings x covariates; constant ones are left out.
fn covariates(system: &WhiskerSystem) -> DMatrix<f64> {
    let n = system.path.readings.len();
    let columns: Vec<Vec<f64>> = system
        .covariates()
        .into_iter()
        .filter_map(|(_, v)| {
            let mean = v.iter().sum::<f64>() / n as f64;
            let sd = (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
            (sd > 1e-9 * mean.abs().max(1e-9)).then(|| v.iter().map(|x| (x - mean) / sd).collect())
        })
        .collect();
    DMatrix::from_fn(n, columns.len(), |i, j| columns[j][i])
}

fn matern(distance: f64) -> f64 {
    let d = 5f64.sqrt() * distance;
    (1.0 + d + d * d / 3.0) * (-d).exp()
}

struct Fitted {
    length: f64,
    signal: f64,
    alpha: DVector<f64>,
}

/// Best length and signal for `y` at the rows `x`, by the evidence with the noise profiled out.
fn fitted(x: &DMatrix<f64>, y: &DVector<f64>) -> Option<Fitted> {
    let n = y.len();
    let distance = DMatrix::from_fn(n, n, |i, j| (x.row(i) - x.row(j)).norm());
    let unit = (x.ncols().max(1) as f64).sqrt();
    let mut best: Option<(f64, Fitted)> = None;
    for length in LENGTHS.map(|l| l * unit) {
        let correlation = distance.map(|d| matern(d / length));
        for signal in SIGNALS {
            let k = &correlation * signal + DMatrix::identity(n, n);
            let Some(chol): Option<Cholesky<f64, Dyn>> = k.cholesky() else { continue };
            let alpha = chol.solve(y);
            let log_det: f64 = chol.l_dirty().diagonal().iter().map(|v| v.ln()).sum::<f64>() * 2.0;
            let evidence = -0.5 * (n as f64 * (y.dot(&alpha) / n as f64).ln() + log_det);
            if best.as_ref().is_none_or(|b| evidence > b.0) {
                best = Some((evidence, Fitted { length, signal, alpha }));
            }
        }
    }
    best.map(|b| b.1)
}

/// Held-out residuals of the rival. `before` holds every reading of `whole` under the declared model with sensitivity `k`, pm/(N mm).
#[must_use]
pub fn rival(
    whole: &WhiskerSystem,
    before: &[Predicted],
    k: &Matrix2<f64>,
    left_out: &[usize],
) -> Vec<HeldOut> {
    let readings = &whole.path.readings;
    let x = covariates(whole);
    let (train, test): (Vec<usize>, Vec<usize>) = (0..readings.len()).partition(|&i| !readings[i].holdout);
    let Some(inverse) = k.try_inverse().filter(|_| !test.is_empty()) else { return Vec::new() };
    let seen = x.select_rows(&train);
    let residual = |i: usize, c: usize| readings[i].shift_pm[c] - before[i].shift_pm[c];
    // Channel by channel: what the process adds at each held-out reading, in the order of `test`.
    let mut channels: Vec<Vec<f64>> = Vec::with_capacity(2);
    for c in 0..2 {
        let y = DVector::from_iterator(train.len(), train.iter().map(|&i| residual(i, c)));
        let Some(f) = fitted(&seen, &y) else { return Vec::new() };
        let at = |i: usize| -> f64 {
            (0..train.len())
                .map(|j| f.signal * matern((x.row(i) - seen.row(j)).norm() / f.length) * f.alpha[j])
                .sum()
        };
        channels.push(test.iter().map(|&i| at(i)).collect());
    }
    test.iter()
        .enumerate()
        .filter(|(_, i)| !left_out.contains(i))
        .map(|(k, &i)| {
            let added = [channels[0][k], channels[1][k]];
            let corrected = [0, 1].map(|c| before[i].shift_pm[c] + added[c]);
            let moment = inverse * Vector2::from(added);
            let mut p = before[i];
            p.shift_pm = corrected;
            p.moment_nmm = [p.moment_nmm[0] - moment[0], p.moment_nmm[1] - moment[1]];
            of_reading(readings[i].group, readings[i].shift_pm, &p)
        })
        .collect()
}
