//! Predictions of a fit at other rows, and how rows are left out in turn.

use super::floor::{place_keys, replicate_keys};
use super::frame::Frame;
use super::system::ScalarSystem;
use crate::effect::EffectTerm;
use crate::levels::REMARK;
use crate::measurement_model::MeasurementModel;
use crate::method::fit::Fit;
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::{covariance, t95};
use crate::verify::session_model::Folds;
use nalgebra::{DMatrix, DVector};

/// More folds than this cost refits and tell no more.
const MAX_FOLDS: usize = 40;
/// Steps of a refit without a fold.
const REFIT_STEPS: usize = 15;

/// What is omitted together where there are no cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grouping {
    /// A stimulus with all its readings.
    Stimuli,
    /// One repeat of every place: a table knows nothing of a place that it has not seen.
    Repeats,
    /// The same, series by series never: nothing is known of the zero of a series that is omitted.
    WithinSeries,
    /// Readings that follow each other: neighbours in time share what is interpolated between them.
    Blocks,
}

/// Blocks of a series that are left out.
const BLOCKS: usize = 10;

/// Neighbours in a session whose order is known share what the accepted model leaves (lag-one
/// correlation).
pub(crate) fn follows_neighbours(system: &ScalarSystem, accepted: &Hypothesis) -> bool {
    if !system.frame.ordered || system.frame.rows.len() < 2 * BLOCKS {
        return false;
    }
    let left: Vec<f64> = (0..system.frame.rows.len())
        .filter(|&i| accepted.weights.counts(i))
        .map(|i| accepted.fit.raw_residual[(i, 0)] * accepted.weights.relative()[i])
        .collect();
    let square = left.iter().map(|r| r * r).sum::<f64>() / left.len().max(1) as f64;
    let product = left.windows(2).map(|r| r[0] * r[1]).sum::<f64>();
    let z = product / square.max(1e-300) / (left.len().max(2) as f64 - 1.0).sqrt();
    statrs::distribution::ContinuousCDF::sf(&statrs::distribution::Normal::standard(), z) < REMARK
}

/// Cycles where there are three, else what `grouping` asks for.
pub fn folds(frame: &Frame, grouping: Grouping) -> Folds {
    let of = |split, words, fold: Vec<usize>| Folds {
        split,
        words,
        fold: fold.into_iter().map(Some).collect(),
        refit_steps: REFIT_STEPS,
    };
    let number = |keys: Vec<i64>| {
        let mut distinct = keys.clone();
        distinct.sort_unstable();
        distinct.dedup();
        let fold: Vec<usize> = keys
            .iter()
            .map(|k| distinct.partition_point(|d| d < k))
            .collect();
        (fold, distinct.len())
    };
    let (fold, count) = number(frame.groups.iter().map(|g| i64::from(*g)).collect());
    if count >= 3 && grouping != Grouping::WithinSeries {
        return of(
            "loto",
            format!("by leaving out each of {count} cycles in turn"),
            fold,
        );
    }
    if grouping == Grouping::Repeats {
        let keys = replicate_keys(frame);
        let visit = |i: usize| keys[..i].iter().filter(|k| **k == keys[i]).count();
        let visits: Vec<usize> = (0..keys.len()).map(visit).collect();
        let folds = (1 + visits.iter().max().copied().unwrap_or(0)).min(BLOCKS);
        let words = format!("by leaving out each of {folds} repeats of the places in turn");
        return of(
            "loo",
            words,
            visits.into_iter().map(|v| v % folds).collect(),
        );
    }
    if grouping == Grouping::Blocks {
        let n = frame.rows.len();
        let words =
            format!("by leaving out each of {BLOCKS} blocks of neighbouring readings in turn");
        return of("loo", words, (0..n).map(|i| i * BLOCKS / n).collect());
    }
    let (fold, count) = number(place_keys(frame).iter().map(|k| *k as i64).collect());
    let n = frame.rows.len();
    if count < n && count >= 3 {
        let folds = count.min(MAX_FOLDS);
        // Neighbouring stimuli go to different folds, so that no fold is an extrapolation.
        let fold = fold.iter().map(|f| f % folds).collect();
        let words = format!(
            "by leaving out each of {count} stimuli with all its readings, in {folds} folds"
        );
        return of("loo", words, fold);
    }
    let folds = n.min(MAX_FOLDS);
    let fold = (0..n).map(|i| i * folds / n).collect();
    let words = if folds == n {
        "by leaving out one reading at a time".to_owned()
    } else {
        format!("by leaving out each of {folds} blocks of neighbouring readings in turn")
    };
    of("loo", words, fold)
}

/// What predictions need of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Terms with fitted values.
    pub terms: Vec<EffectTerm>,
    /// Free coefficients.
    pub coefficients: Vec<f64>,
    /// Joint covariance of coefficients and nonlinear values.
    pub covariance: DMatrix<f64>,
    /// Variance of the noise.
    pub variance: f64,
    /// Residual degrees of freedom.
    pub dof: f64,
}

impl Fitted {
    /// Takes it from a fit.
    pub fn of(fit: &Fit) -> Self {
        Self {
            terms: fit.terms.clone(),
            coefficients: fit.coefficients.column(0).iter().copied().collect(),
            covariance: covariance(fit, fit.variance()),
            variance: fit.variance(),
            dof: fit.dof,
        }
    }
}

/// Predictions of a fit, and half widths of their 95 % intervals, on the rows of `system`.
/// `noise_sd`: of each reading. None where the design has no solution there or is not the one that
/// was fitted.
pub fn predict(
    system: &ScalarSystem,
    fitted: &Fitted,
    noise_sd: &[f64],
) -> Option<(DVector<f64>, Vec<f64>)> {
    let design = system.design(&fitted.terms)?;
    let coefficients = DVector::from_column_slice(&fitted.coefficients);
    if design.ncols() != coefficients.len() {
        return None;
    }
    let prediction = &design * &coefficients;
    let (n, q) = design.shape();
    let mut gradient = DMatrix::zeros(n, fitted.covariance.nrows());
    gradient.view_mut((0, 0), (n, q)).copy_from(&design);
    let mut slot = q;
    for (t, term) in fitted.terms.iter().enumerate() {
        for k in 0..term.values.len() {
            let mut moved: Vec<EffectTerm> = fitted.terms.clone();
            let h = 1e-3 * term.values[k].abs().max(1e-6);
            moved[t].values[k] += h;
            if let Some(d) = system.design(&moved) {
                gradient.set_column(slot, &((d - &design) * &coefficients / h));
            }
            slot += 1;
        }
    }
    let t = t95(fitted.dof);
    let half = (0..n)
        .map(|i| {
            let g = gradient.row(i);
            let parameters = (g * &fitted.covariance * g.transpose())[(0, 0)].max(0.0);
            t * (noise_sd[i].powi(2) + parameters).sqrt()
        })
        .collect();
    Some((prediction, half))
}
