//! Predictions of a fit at other rows, and how rows are left out in turn.

use super::floor::{place_keys, replicate_keys};
use super::frame::Frame;
use super::system::ScalarSystem;
use crate::levels::{REMARK, z};
use crate::method::{Fit, Hypothesis, covariance, t95};
use crate::verify::Folds;
use crate::{EffectTerm, MeasurementModel};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeSet;

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
    // Lag-one correlation times the root of n is standard normal where neighbours share nothing.
    let square = left.iter().map(|r| r * r).sum::<f64>() / left.len().max(1) as f64;
    let product = left.windows(2).map(|r| r[0] * r[1]).sum::<f64>();
    let score = product / square.max(1e-300) / (left.len().max(2) as f64 - 1.0).sqrt();
    score > z(REMARK)
}

/// Cycles where there are three, else what `grouping` asks for.
pub fn folds(frame: &Frame, grouping: Grouping) -> Folds {
    let n = frame.rows.len();
    let of = |split, words, fold: Vec<usize>| Folds {
        split,
        words,
        fold: fold.into_iter().map(Some).collect(),
        refit_steps: REFIT_STEPS,
    };
    let neighbours = |count: usize| {
        let words =
            format!("by leaving out each of {count} blocks of neighbouring readings in turn");
        (words, (0..n).map(|i| i * count / n).collect::<Vec<usize>>())
    };
    let cycles: BTreeSet<u32> = frame.groups.iter().copied().collect();
    if cycles.len() >= 3 && grouping != Grouping::WithinSeries {
        let words = format!("by leaving out each of {} cycles in turn", cycles.len());
        let fold = frame.groups.iter().map(|g| cycles.range(..*g).count());
        return of("loto", words, fold.collect());
    }
    if grouping == Grouping::Repeats {
        let keys = replicate_keys(frame);
        let visit = |i: usize| keys[..i].iter().filter(|k| **k == keys[i]).count();
        let visits: Vec<usize> = (0..n).map(visit).collect();
        let folds = (1 + visits.iter().max().copied().unwrap_or(0)).min(BLOCKS);
        let words = format!("by leaving out each of {folds} repeats of the places in turn");
        let fold = visits.into_iter().map(|v| v % folds);
        return of("loo", words, fold.collect());
    }
    if grouping == Grouping::Blocks {
        let (words, fold) = neighbours(BLOCKS);
        return of("loo", words, fold);
    }
    let places = place_keys(frame);
    let count = places.iter().max().map_or(0, |last| *last as usize + 1);
    if count < n && count >= 3 {
        let folds = count.min(MAX_FOLDS);
        // Neighbouring stimuli go to different folds, so that no fold is an extrapolation.
        let fold = places.iter().map(|f| *f as usize % folds).collect();
        let words = format!(
            "by leaving out each of {count} stimuli with all its readings, in {folds} folds"
        );
        return of("loo", words, fold);
    }
    let (words, fold) = neighbours(n.min(MAX_FOLDS));
    let one_by_one = "by leaving out one reading at a time".to_owned();
    of("loo", if n <= MAX_FOLDS { one_by_one } else { words }, fold)
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

/// Derivatives of the predictions on the rows of `system` by the coefficients and the nonlinear
/// values, a row each, and the predictions. None where the design has no solution there or is not
/// the one that was fitted.
pub(super) fn gradient(
    system: &ScalarSystem,
    fitted: &Fitted,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let design = system.design(&fitted.terms)?;
    let coefficients = DVector::from_column_slice(&fitted.coefficients);
    if design.ncols() != coefficients.len() {
        return None;
    }
    let prediction = &design * &coefficients;
    let (n, q) = design.shape();
    let mut gradient = DMatrix::zeros(n, fitted.covariance.nrows());
    // d prediction / d coefficient is the column itself; by a nonlinear value a forward difference.
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
    Some((prediction, gradient))
}

/// Predictions of a fit, and half widths of their 95 % intervals, on the rows of `system`.
/// `noise_sd`: of each reading. None as of [`gradient`].
pub fn predict(
    system: &ScalarSystem,
    fitted: &Fitted,
    noise_sd: &[f64],
) -> Option<(DVector<f64>, Vec<f64>)> {
    let (prediction, gradient) = gradient(system, fitted)?;
    let t = t95(fitted.dof);
    // g' C g of each reading.
    let parameters = (&gradient * &fitted.covariance).component_mul(&gradient);
    let parameters = parameters.column_sum();
    // A new reading has its own noise beside the error of the fit.
    let half = |i: usize| t * (noise_sd[i].powi(2) + parameters[i].max(0.0)).sqrt();
    let half = (0..prediction.len()).map(half).collect();
    Some((prediction, half))
}
