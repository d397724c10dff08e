//! Physical range of effects that enter linearly: their part in what a channel spans. Where it is
//! exceeded, the effect is refitted at its bounds (convex, by clarabel), and the data may insist on
//! more or not.

use super::fit::Fit;
use super::min_p::f_test;
use super::signature::nuisance_basis_without;
use crate::levels::RANGE;
use crate::measurement_model::MeasurementModel;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Whether every law with a largest share keeps to it, or would explain as well if held there.
pub(crate) fn range_check(system: &dyn MeasurementModel, fit: &Fit) -> bool {
    fit.terms
        .iter()
        .zip(fit.slots(system.catalogue()))
        .all(|(t, slots)| {
            let largest_share = system.catalogue()[t.effect].law(t.law).largest_share;
            largest_share.is_none_or(|share| is_within_share(fit, slots.columns, share))
        })
}

fn is_within_share(fit: &Fit, columns: Range<usize>, share: f64) -> bool {
    let channels = fit.residual.ncols();
    let part =
        fit.design.columns_range(columns.clone()) * fit.coefficients.rows_range(columns.clone());
    let whole = &fit.design * &fit.coefficients;
    // The largest part that each channel allows.
    let largest: Vec<f64> = (0..channels)
        .map(|c| share * (whole.column(c).max() - whole.column(c).min()))
        .collect();
    let over = (0..channels)
        .filter(|&c| part.column(c).amax() > largest[c])
        .count();
    if over == 0 {
        return true;
    }
    // Everything else is free to take up what the bounded effect may not: its span is projected
    // off.
    let others = nuisance_basis_without(fit, &columns);
    // Directions in which the effect's own coefficients move the residual, once everything else is
    // refitted.
    let own: Vec<(usize, usize)> = (0..channels)
        .flat_map(|c| columns.clone().map(move |j| (j, c)))
        .collect();
    let directions: Vec<DVector<f64>> = own
        .iter()
        .map(|&(j, c)| {
            let column: Vec<f64> = fit.design.column(j).iter().copied().collect();
            others.project_off(&fit.in_channel(&column, c))
        })
        .collect();
    let free: Vec<f64> = own.iter().map(|&(j, c)| fit.coefficients[(j, c)]).collect();
    let Some(rise) = rise_under_bound(fit, &own, &directions, &free, &largest) else {
        return true;
    };
    // Each channel that is held at its bound gives a degree of freedom back.
    f_test(rise, fit.ssr + rise, fit.dof + over as f64, over).is_none_or(|p| p > RANGE)
}

/// Rise of the misfit where the effect's part is held within `largest` at every reading: a bounded
/// least squares fit, convex.
///
/// None where the solver gives up: nothing is held against the explanation then.
fn rise_under_bound(
    fit: &Fit,
    own: &[(usize, usize)],
    directions: &[DVector<f64>],
    free: &[f64],
    largest: &[f64],
) -> Option<f64> {
    // Free coefficients have very different sizes: each is counted in the length of its direction.
    let size: Vec<f64> = directions.iter().map(|d| d.norm().max(1e-300)).collect();
    let k = own.len();
    let gram = DMatrix::from_fn(k, k, |a, b| {
        directions[a].dot(&directions[b]) / (size[a] * size[b])
    });
    let start = DVector::from_iterator(k, (0..k).map(|a| free[a] * size[a]));
    let linear = -(&gram * &start);
    let scale = start.amax().max(1e-300);
    // One pair of linear constraints a reading: the effect's own part within its bound, up and
    // down.
    let (mut rows, mut bounds) = (Vec::new(), Vec::new());
    for (c, limit) in largest.iter().enumerate() {
        for i in 0..fit.design.nrows() {
            let entries = |sign: f64| -> Vec<(usize, f64)> {
                let of_channel = (0..k).filter(|&a| own[a].1 == c);
                of_channel
                    .map(|a| (a, sign * fit.design[(i, own[a].0)] / size[a] * scale))
                    .collect()
            };
            for sign in [1.0, -1.0] {
                rows.push(entries(sign));
                bounds.push(*limit);
            }
        }
    }
    let linear: Vec<f64> = linear.iter().map(|x| x / scale).collect();
    let held = DVector::from_vec(minimise(&gram, &linear, &rows, &bounds)?) * scale;
    let change = held - start;
    Some((&gram * &change).dot(&change))
}

/// The x of least `1/2 x' P x + q' x` where no row of `rows x` exceeds its bound (interior point);
/// none where the solver gives up.
pub(super) fn minimise(
    quadratic: &DMatrix<f64>,
    linear: &[f64],
    rows: &[Vec<(usize, f64)>],
    bounds: &[f64],
) -> Option<Vec<f64>> {
    let n = linear.len();
    // Clarabel takes the upper triangle of P.
    let upper: Vec<Vec<(usize, f64)>> = (0..n)
        .map(|i| {
            (i..n)
                .map(|j| (j, quadratic[(i, j)]))
                .filter(|e| e.1 != 0.0)
                .collect()
        })
        .collect();
    let (p, a) = (sparse(&upper, n, n), sparse(rows, rows.len(), n));
    let cones = [SupportedConeT::NonnegativeConeT(rows.len())];
    let settings = DefaultSettings {
        verbose: false,
        ..DefaultSettings::default()
    };
    let mut solver = DefaultSolver::new(&p, linear, &a, bounds, &cones, settings).ok()?;
    solver.solve();
    let solved = matches!(
        solver.solution.status,
        SolverStatus::Solved | SolverStatus::AlmostSolved
    );
    solved.then(|| solver.solution.x.clone())
}

fn sparse(rows: &[Vec<(usize, f64)>], height: usize, width: usize) -> CscMatrix<f64> {
    let (mut i, mut j, mut v) = (Vec::new(), Vec::new(), Vec::new());
    for (r, row) in rows.iter().enumerate() {
        for (c, x) in row {
            i.push(r);
            j.push(*c);
            v.push(*x);
        }
    }
    CscMatrix::new_from_triplets(height, width, i, j, v)
}
