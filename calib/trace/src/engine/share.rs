//! Physical range of effects that enter linearly: their part in what a channel spans.

use super::fit::Fit;
use super::linear::{Basis, in_channel, stack};
use super::null::f_test;
use crate::candidate::System;
use nalgebra::DMatrix;

/// Chance below which the data insist on a part that physics does not allow.
const LEVEL: f64 = 0.01;

/// Whether every law with a largest share keeps to it, or would explain as well if held there.
#[must_use]
pub fn within_shares(system: &dyn System, fit: &Fit) -> bool {
    let laws: Vec<_> = fit.terms.iter().map(|t| system.catalogue()[t.effect].law(t.law).clone()).collect();
    let own: usize = laws.iter().map(|l| l.linear.len()).sum();
    // Columns of linear terms follow the declared model's in term order.
    let mut first = fit.design.ncols() - own.min(fit.design.ncols());
    laws.iter().all(|law| {
        let columns = first..first + law.linear.len();
        first = columns.end;
        law.largest_share.is_none_or(|share| holds(fit, columns, share))
    })
}

fn holds(fit: &Fit, columns: std::ops::Range<usize>, share: f64) -> bool {
    let (n, channels) = (fit.residual.nrows(), fit.residual.ncols());
    let part = fit.design.columns_range(columns.clone()) * fit.coefficients.rows_range(columns.clone());
    let whole = &fit.design * &fit.coefficients;
    // What of its part in each channel an effect has to give up.
    let excess: Vec<f64> = (0..channels)
        .map(|c| {
            let span = whole.column(c).max() - whole.column(c).min();
            1.0 - (share * span / part.column(c).amax().max(1e-300)).min(1.0)
        })
        .collect();
    let over = excess.iter().filter(|e| **e > 0.0).count();
    if over == 0 {
        return true;
    }
    let mut others = Basis::default();
    for (_, column) in fit.design.column_iter().enumerate().filter(|(j, _)| !columns.contains(j)) {
        let column: Vec<f64> = column.iter().copied().collect();
        for c in 0..channels {
            others.push(&in_channel(&column, c, channels));
        }
    }
    for tangent in &fit.tangents {
        others.push(&stack(tangent));
    }
    let held = DMatrix::from_fn(n, channels, |i, c| fit.residual[(i, c)] + excess[c] * part[(i, c)]);
    let ssr = others.project_off(&stack(&held)).norm_squared();
    f_test(ssr - fit.ssr, ssr, fit.dof + over as f64, over) > LEVEL
}
