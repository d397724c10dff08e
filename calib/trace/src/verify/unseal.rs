//! Stage 11: the error on readings that no fit saw, before and after, beside a black-box rival.

use super::heldout::{HeldOut, coverage95, summarise};
use super::map_left_out::leave_one_out;
use super::physical::PhysicalModel;
use super::predictions::{Predicted, held_out, of_reading, predict};
use super::rival::rival;
use super::twin_check::labelled_moments;
use super::verdict::Conclusion;
use crate::engine::fit::{Weights, fit};
use crate::engine::linear::{Basis, in_channel, stack};
use crate::engine::search::{Found, Hypothesis};
use crate::whisker::WhiskerSystem;
use nalgebra::{DMatrix, Matrix2};
use rayon::prelude::*;
use wcal_core::observation::WhiskerData;
use wcal_core::verify_document::HeldOutError;

/// Held-out errors of the declared and the accepted model.
pub(super) struct Errors {
    pub before: Option<HeldOutError>,
    pub after: Option<HeldOutError>,
    pub coverage95: Option<f64>,
    /// Further models by name.
    pub further: Vec<(String, HeldOutError)>,
    /// What the verdict's reason must add.
    pub remark: String,
}

/// From the holdout where there is one, else leave-one-trajectory-out.
#[allow(clippy::too_many_arguments)]
pub(super) fn held_out_errors(
    data: &WhiskerData,
    system: &WhiskerSystem,
    whole: &WhiskerSystem,
    found: &Found,
    conclusion: &Conclusion,
    before: &[Predicted],
    after: &[Predicted],
    sensitivity: &Matrix2<f64>,
    noise_sd_pm: f64,
    left_out: &[usize],
    on_request: bool,
    seed: u64,
) -> Errors {
    let rows = held_out(whole, after, left_out);
    if !rows.is_empty() {
        return Errors {
            before: summarise(&held_out(whole, before, left_out), "holdout", seed),
            after: summarise(&rows, "holdout", seed),
            coverage95: coverage95(&rows),
            further: black_box(whole, before, sensitivity, left_out, seed),
            remark: String::new(),
        };
    }
    let rivals: Vec<&Hypothesis> = if conclusion.effects.is_empty() || on_request {
        Vec::new()
    } else {
        std::iter::once(&found.base).chain(&found.refitted).collect()
    };
    let folds = leave_out(system, &conclusion.accepted, &rivals, found, None, noise_sd_pm);
    let labelled = labelled_moments(data, &system.path);
    let declared = leave_out(system, &found.base, &[], found, labelled.as_deref(), noise_sd_pm);
    let mut further = Vec::new();
    if labelled.is_some() {
        let repaired = leave_out(system, &found.base, &[], found, None, noise_sd_pm);
        if let Some(e) = summarise(&repaired, "loto", seed) {
            further.push(("declared model, labels repaired by the rod".to_owned(), e));
        }
    }
    let of_pose = |p: &[Predicted]| p.iter().map(|p| p.pose_moment_nmm).collect::<Vec<_>>();
    let with_map = |error: Option<HeldOutError>, moments: &[[f64; 2]]| {
        error.map(|e| HeldOutError { loo: leave_one_out(&system.path, moments), ..e })
    };
    Errors {
        before: with_map(
            summarise(&declared, "loto", seed),
            &labelled.unwrap_or_else(|| of_pose(before)),
        ),
        after: with_map(summarise(&folds, "loto", seed), &of_pose(after)),
        coverage95: coverage95(&folds),
        further,
        remark: " Errors are leave-one-trajectory-out: the choice among the refitted explanations and every fitted value were made without the trajectory.".to_owned(),
    }
}

/// Error of the flexible rival on the same held-out readings.
fn black_box(
    whole: &WhiskerSystem,
    before: &[Predicted],
    sensitivity: &Matrix2<f64>,
    left_out: &[usize],
    seed: u64,
) -> Vec<(String, HeldOutError)> {
    let rows = rival(whole, before, sensitivity, left_out);
    let name = "black-box rival: Gaussian process of the residual on every covariate".to_owned();
    summarise(&rows, "holdout", seed).map(|e| (name, e)).into_iter().collect()
}

/// The explanation that the readings of `weights` alone would choose among `rivals` (tangent models, Akaike's price).
fn choice<'a>(rivals: &[&'a Hypothesis], found: &Found, weights: &Weights) -> Option<&'a Hypothesis> {
    let variance = found.best.fit.variance();
    let cost = |h: &Hypothesis| {
        let (n, channels) = (h.fit.residual.nrows(), h.fit.residual.ncols());
        let kept = |v: &DMatrix<f64>| DMatrix::from_fn(n, channels, |i, c| v[(i, c)] * weights.of(i));
        let mut basis = Basis::default();
        for column in h.fit.design.column_iter() {
            let column: Vec<f64> = column.iter().zip(weights.relative()).map(|(v, w)| v * w).collect();
            for c in 0..channels {
                basis.push(&in_channel(&column, c, channels));
            }
        }
        for t in &h.fit.tangents {
            basis.push(&stack(&kept(t)));
        }
        let left = basis.project_off(&stack(&kept(&h.fit.residual))).norm_squared();
        left / variance + (h.criterion(&found.base.fit, variance) - h.fit.ssr / variance)
    };
    rivals.iter().map(|h| (cost(h), *h)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, h)| h)
}

/// Leave-one-trajectory-out residuals of `accepted`, or of what each fold chooses among `rivals` where there are some; with `labels` the
/// moments come from the outside twin instead of the rod.
fn leave_out(
    system: &WhiskerSystem,
    accepted: &Hypothesis,
    rivals: &[&Hypothesis],
    found: &Found,
    labels: Option<&[[f64; 2]]>,
    noise_sd_pm: f64,
) -> Vec<HeldOut> {
    let readings = &system.path.readings;
    let mut groups: Vec<u32> = readings.iter().filter(|r| !r.rest).map(|r| r.group).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
        .par_iter()
        .flat_map_iter(|&group| {
            let inside = |i: usize| readings[i].group == group && !readings[i].rest;
            let outside: Vec<f64> = (0..readings.len()).map(|i| f64::from(u8::from(!inside(i)))).collect();
            let h = choice(rivals, found, &Weights::independent(outside.clone())).unwrap_or(accepted);
            let weights = h.weights.masked(|i| !inside(i));
            let predicted = match labels {
                // From the optimum of all readings two Gauss-Newton steps reach that of all but one trajectory.
                None => fit(system, &h.fit.terms, &weights, 2).and_then(|refit| {
                    let part = Hypothesis { fit: refit, weights: weights.clone(), ..h.clone() };
                    let model = PhysicalModel::new(system, &part, noise_sd_pm);
                    predict(system, &part, &model, &vec![noise_sd_pm; readings.len()])
                }),
                Some(moments) => by_labels(system, moments, &weights),
            };
            (0..readings.len())
                .filter(|&i| inside(i) && accepted.weights.counts(i))
                .filter_map(|i| Some(of_reading(group, readings[i].shift_pm, &predicted.as_ref()?[i])))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Linear map on outside labels, fitted on the weighted readings.
fn by_labels(system: &WhiskerSystem, moments: &[[f64; 2]], weights: &Weights) -> Option<Vec<Predicted>> {
    let n = moments.len();
    let design = DMatrix::from_fn(n, 3, |i, j| if j == 0 { 1.0 } else { moments[i][j - 1] });
    let w = DMatrix::from_fn(n, 3, |i, j| design[(i, j)] * weights.of(i));
    let y = DMatrix::from_fn(n, 2, |i, c| system.path.readings[i].shift_pm[c] * weights.of(i));
    let b = w.clone().svd(true, true).solve(&y, 1e-12).ok()?;
    let residual = &y - &w * &b;
    let variance = residual.norm_squared() / (2.0 * (weights.active() as f64 - 3.0)).max(1.0);
    let k = Matrix2::from_fn(|c, j| b[(j + 1, c)]);
    let inverse = k.try_inverse()?;
    let spread = inverse * inverse.transpose() * variance;
    let shifts = &design * &b;
    Some(
        (0..n)
            .map(|i| {
                let shift = system.path.readings[i].shift_pm;
                let m = inverse * nalgebra::Vector2::new(shift[0] - b[(0, 0)], shift[1] - b[(0, 1)]);
                Predicted {
                    moment_nmm: [m[0], m[1]],
                    moment_sd_nmm: [spread[(0, 0)].sqrt(), spread[(1, 1)].sqrt()],
                    shift_pm: [shifts[(i, 0)], shifts[(i, 1)]],
                    pose_moment_nmm: moments[i],
                }
            })
            .collect(),
    )
}
