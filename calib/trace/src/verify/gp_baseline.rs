//! The honest rival of every named effect: a Gaussian process of the declared model's residual on all covariates.
//!
//! Rasmussen & Williams, "Gaussian Processes for Machine Learning" (2006), alg. 2.1 and eq. 5.8: Matern 5/2 over the standardised
//! covariates, length and signal chosen by the evidence on the fitted readings. It names nothing; an explanation that it beats is missing something.

use super::session_model::{HeldOut, SessionModel};
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};
use wcal_map::{ConditionedProcess, Kernel};

/// Lengths, in root of the number of covariates (standardised).
const LENGTHS: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
/// Signal over noise variance.
const SIGNALS: [f64; 5] = [0.1, 0.5, 2.0, 8.0, 32.0];

/// Standardised covariates, readings x covariates; constant ones are left out.
fn covariates(system: &dyn MeasurementModel) -> DMatrix<f64> {
    let n = system.measured().nrows();
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

struct Fitted {
    kernel: Kernel,
    signal: f64,
    process: ConditionedProcess,
}

/// Best length and signal for `y` at the rows `x`, by the evidence with the noise profiled out.
fn fitted(x: &DMatrix<f64>, y: &DVector<f64>) -> Option<Fitted> {
    let n = y.len();
    let distance = DMatrix::from_fn(n, n, |i, j| (x.row(i) - x.row(j)).norm());
    let unit = (x.ncols().max(1) as f64).sqrt();
    let mut best: Option<(f64, Fitted)> = None;
    for length in LENGTHS.map(|l| l * unit) {
        let kernel = Kernel::Matern52 { length };
        let correlation = distance.map(|d| kernel.at(d));
        for signal in SIGNALS {
            let covariance = &correlation * signal + DMatrix::identity(n, n);
            let Ok(process) = ConditionedProcess::new(covariance, y.clone()) else { continue };
            let evidence = -0.5 * (n as f64 * (process.misfit() / n as f64).ln() + process.log_determinant());
            if best.as_ref().is_none_or(|b| evidence > b.0) {
                best = Some((evidence, Fitted { kernel, signal, process }));
            }
        }
    }
    best.map(|b| b.1)
}

/// More readings than this are thinned for the rival: its cost grows with their cube.
const MAX_FITTED: usize = 400;

/// Errors of the rival on the unsealed readings; `before` holds every reading of `whole` under the declared model. Sealed readings have no part
/// in it.
pub fn gp_baseline<M: SessionModel>(whole: &M, before: &M::Predictions, left_out: &[usize]) -> Vec<HeldOut> {
    let sealed = whole.sealed();
    let (all, n) = (covariates(whole), sealed.len());
    let residual: Vec<Vec<f64>> = (0..n).map(|i| whole.errors(before, i).errors[0].clone()).collect();
    let open: Vec<usize> = (0..n).filter(|&i| !sealed[i]).collect();
    let train: Vec<usize> = open.iter().copied().step_by(open.len().div_ceil(MAX_FITTED).max(1)).collect();
    let test: Vec<usize> = (0..n).filter(|&i| whole.scored()[i] && !left_out.contains(&i)).collect();
    if test.is_empty() || train.len() < 3 {
        return Vec::new();
    }
    let seen = all.select_rows(&train);
    let added = |c: usize| -> Option<Vec<f64>> {
        let f = fitted(&seen, &DVector::from_iterator(train.len(), train.iter().map(|&i| residual[i][c])))?;
        let k = |i: usize, j: usize| f.signal * f.kernel.at((all.row(i) - seen.row(j)).norm());
        Some(test.iter().map(|&i| f.process.mean((0..train.len()).map(|j| k(i, j)))).collect())
    };
    let Some(channels) = (0..residual[0].len()).map(added).collect::<Option<Vec<_>>>() else {
        return Vec::new();
    };
    let of = |(k, &i): (usize, &usize)| {
        whole.corrected(before, i, &channels.iter().map(|c| c[k]).collect::<Vec<_>>())
    };
    test.iter().enumerate().map(of).collect()
}
