//! A driver of what is left pays for its search: chosen anew on the readings that each fold keeps, it has to predict those that the fold leaves out.
//!
//! ```text
//! in each fold: the shape with the smallest p on what is kept; D = sum e^2 - e'^2 on what is left out,  asked: D > sd(D) over the folds, and a share of sum e^2
//! ```

use super::system::ScalarSystem;
use crate::levels::{NEGLIGIBLE, SERIAL};
use crate::method::covariates::signatures_of_covariates;
use crate::method::hypothesis::Hypothesis;
use crate::method::linear::Basis;
use crate::method::min_p::f_test;
use crate::method::signature::nuisance_basis;
use crate::verify::{Explained, SessionModel};
use nalgebra::{DMatrix, DVector};

/// Share of the squares left out from which a driver matters: a tenth of the error, root mean square.
const MATTERS: f64 = 0.01;

/// Calls what is left by a generic driver within the model's error where the driver does not predict.
pub(super) fn judge_driver(system: &ScalarSystem, explained: &mut Explained) {
    let found = &mut explained.found;
    let test = &found.last_test;
    // Neighbours that share something are a finding of their own, and so is a law of the catalogue that chance does not give.
    let by_driver_alone = test.rejected() && test.p_serial >= SERIAL && test.p_catalogue >= NEGLIGIBLE;
    if !found.covariate_beats_catalogue && by_driver_alone && !predicts(system, &found.best) {
        found.last_test.within_model_error = true;
    }
}

/// Whether the drivers of what `h` leaves predict readings that are left out; true where that cannot be told.
fn predicts(system: &ScalarSystem, h: &Hypothesis) -> bool {
    let folds = system.folds(h);
    let columns: Vec<Vec<Vec<f64>>> =
        signatures_of_covariates(system, &h.fit, &h.weights, &nuisance_basis(&h.fit))
            .into_iter()
            .map(|s| s.columns)
            .collect();
    let count = folds.fold.iter().flatten().max().map_or(0, |m| m + 1);
    let gains: Option<Vec<[f64; 2]>> =
        (0..count).map(|f| of_fold(h, &columns, &|i| folds.fold[i] == Some(f))).collect();
    let Some(gains) = gains.filter(|g| g.len() > 1) else { return true };
    let sum = |k: usize| gains.iter().map(|g| g[k]).sum::<f64>();
    let mean = sum(1) / gains.len() as f64;
    let spread = gains.iter().map(|g| (g[1] - mean).powi(2)).sum::<f64>() / (gains.len() - 1) as f64;
    sum(1) > MATTERS * sum(0) && sum(1) > (gains.len() as f64 * spread).sqrt()
}

/// Squares that the readings `out` leave without a driver, and how much they fall by the one that the other readings choose; none where they choose none.
fn of_fold(h: &Hypothesis, shapes: &[Vec<Vec<f64>>], out: &dyn Fn(usize) -> bool) -> Option<[f64; 2]> {
    let n = h.fit.raw_residual.nrows();
    let weight = |i: usize| h.weights.relative()[i];
    let kept = |v: &[f64]| DVector::from_fn(n, |i, _| if out(i) { 0.0 } else { weight(i) * v[i] });
    let columns = h.fit.raw_design.column_iter().chain(h.fit.raw_tangents.iter().map(|t| t.column(0)));
    let model: Vec<Vec<f64>> = columns.map(|c| c.iter().copied().collect()).collect();
    let mut basis = Basis::default();
    model.iter().for_each(|c| {
        basis.push(&kept(c));
    });
    let left: Vec<f64> = h.fit.raw_residual.column(0).iter().copied().collect();
    let residual = basis.project_off(&kept(&left));
    let dof = (0..n).filter(|&i| !out(i) && weight(i) > 0.0).count() as f64 - basis.rank() as f64;
    let p = |shape: &[Vec<f64>]| {
        let mut own = Basis::default();
        shape.iter().for_each(|c| {
            own.push(&basis.project_off(&kept(c)));
        });
        let gain = own.coordinates(&residual).norm_squared();
        f_test(gain, residual.norm_squared(), dof, own.rank().max(1))
    };
    let best = shapes.iter().min_by(|a, b| p(a).total_cmp(&p(b)))?;
    let errors = |columns: &[Vec<f64>]| -> Option<f64> {
        let design = DMatrix::from_columns(&columns.iter().map(|c| kept(c)).collect::<Vec<_>>());
        let b = design.svd(true, true).solve(&kept(&left), 1e-10).ok()?;
        let predicted = |i: usize| (0..columns.len()).map(|j| columns[j][i] * b[j]).sum::<f64>();
        Some((0..n).filter(|&i| out(i)).map(|i| (weight(i) * (left[i] - predicted(i))).powi(2)).sum())
    };
    let without = errors(&model)?;
    let with = errors(&model.iter().chain(best).cloned().collect::<Vec<_>>())?;
    Some([without, without - with])
}
