//! Held-out errors: on sealed rows where there are some, else leaving out cycles, stimuli or readings in turn.

use super::frame::Frame;
use super::parameters::covariance;
use super::system::ScalarSystem;
use crate::candidate::{System, Term};
use crate::engine::fit::{Fit, Weights, fit};
use crate::engine::inference::t95;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use std::collections::BTreeMap;
use wcal_core::verify_document::HeldOutError;

/// How rows are left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Folds {
    /// `loto` (cycles) or `loo` (stimuli or readings).
    pub split: &'static str,
    /// In words.
    pub words: String,
    /// Fold of each row.
    pub fold: Vec<usize>,
}

/// More folds than this cost refits and tell no more.
const MOST_FOLDS: usize = 40;

/// Cycles where there are three, else stimuli (replicates stay together), else blocks of readings.
#[must_use]
pub fn folds(frame: &Frame) -> Folds {
    let number = |keys: Vec<i64>| {
        let mut distinct = keys.clone();
        distinct.sort_unstable();
        distinct.dedup();
        let fold: Vec<usize> = keys.iter().map(|k| distinct.partition_point(|d| d < k)).collect();
        (fold, distinct.len())
    };
    let (fold, count) = number(frame.groups.iter().map(|g| i64::from(*g)).collect());
    if count >= 3 {
        return Folds { split: "loto", words: format!("leaving out each of {count} cycles in turn"), fold };
    }
    let (fold, count) = number(frame.u.iter().map(|u| (u * 1e9).round() as i64).collect());
    let n = frame.rows.len();
    if count < n && count >= 3 {
        let folds = count.min(MOST_FOLDS);
        // Neighbouring stimuli go to different folds, so that no fold is an extrapolation.
        let fold = fold.iter().map(|f| f % folds).collect();
        let words = format!("leaving out each of {count} stimuli with all its readings, in {folds} folds");
        return Folds { split: "loo", words, fold };
    }
    let folds = n.min(MOST_FOLDS);
    let fold = (0..n).map(|i| i * folds / n).collect();
    let words = if folds == n {
        "leaving out one reading at a time".to_owned()
    } else {
        format!("leaving out each of {folds} blocks of neighbouring readings in turn")
    };
    Folds { split: "loo", words, fold }
}

/// Error of one held-out reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOut {
    /// Unit of resampling.
    pub fold: usize,
    /// Measured less predicted.
    pub error: f64,
    /// Half width of the stated 95 % interval.
    pub half95: f64,
}

/// What predictions need of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Terms with fitted values.
    pub terms: Vec<Term>,
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
    #[must_use]
    pub fn of(fit: &Fit) -> Self {
        Self {
            terms: fit.terms.clone(),
            coefficients: fit.coefficients.column(0).iter().copied().collect(),
            covariance: covariance(fit),
            variance: fit.variance(),
            dof: fit.dof,
        }
    }
}

/// Predictions of a fit, and half widths of their 95 % intervals, on the rows of `system`. `relative_sd` is the noise's. None where the
/// design has no solution there or is not the one that was fitted.
#[must_use]
pub fn predict(
    system: &ScalarSystem,
    fitted: &Fitted,
    relative_sd: &[f64],
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
            let mut moved: Vec<Term> = fitted.terms.clone();
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
            t * (fitted.variance * relative_sd[i].powi(2) + parameters).sqrt()
        })
        .collect();
    Some((prediction, half))
}

/// Errors of `start`'s terms, refitted without each fold. Rows with weight 0 (outliers) do not count.
#[must_use]
pub fn cross_validate(
    system: &ScalarSystem,
    terms: &[Term],
    weights: &Weights,
    folds: &Folds,
) -> Vec<HeldOut> {
    let n = folds.fold.len();
    let relative_sd: Vec<f64> = (0..n).map(|i| weights.total_sd(i)).collect();
    let count = folds.fold.iter().max().map_or(0, |m| m + 1);
    let mut out = Vec::new();
    for f in 0..count {
        let kept = weights.masked(|i| folds.fold[i] != f);
        let Some((prediction, half)) = fit(system, terms, &kept, 15)
            .and_then(|fitted| predict(system, &Fitted::of(&fitted), &relative_sd))
        else {
            continue;
        };
        for i in (0..n).filter(|&i| folds.fold[i] == f && weights.counts(i)) {
            out.push(HeldOut { fold: f, error: system.measured()[(i, 0)] - prediction[i], half95: half[i] });
        }
    }
    out
}

/// Errors of a fit on the sealed rows of `all` (a system over fitted and sealed rows).
#[must_use]
pub fn on_sealed(all: &ScalarSystem, fitted: &Fit, sealed: &[bool], relative_sd: &[f64]) -> Vec<HeldOut> {
    let Some((prediction, half)) = predict(all, &Fitted::of(fitted), relative_sd) else { return Vec::new() };
    (0..sealed.len())
        .filter(|&i| sealed[i])
        .map(|i| HeldOut { fold: i, error: all.measured()[(i, 0)] - prediction[i], half95: half[i] })
        .collect()
}

fn rms<'a>(rows: impl Iterator<Item = &'a HeldOut>) -> f64 {
    let (sum, count) = rows.fold((0.0, 0.0), |(s, c), r| (s + r.error * r.error, c + 1.0));
    if count > 0.0 { f64::sqrt(sum / count) } else { f64::NAN }
}

/// Bootstrap draws over whole folds.
const DRAWS: usize = 1000;

/// Root mean square under `name` with a 95 % percentile interval over resampled folds; none without rows.
#[must_use]
pub fn summarise(rows: &[HeldOut], split: &str, name: &str, seed: u64) -> Option<HeldOutError> {
    let mut folds: BTreeMap<usize, Vec<HeldOut>> = BTreeMap::new();
    for r in rows {
        folds.entry(r.fold).or_default().push(*r);
    }
    let folds: Vec<Vec<HeldOut>> = folds.into_values().collect();
    if folds.is_empty() {
        return None;
    }
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut draws: Vec<f64> = (0..DRAWS)
        .map(|_| {
            let picked: Vec<usize> = folds.iter().map(|_| rng.random_range(0..folds.len())).collect();
            rms(picked.iter().flat_map(|&k| &folds[k]))
        })
        .collect();
    draws.sort_by(f64::total_cmp);
    let interval = [draws[DRAWS / 40], draws[DRAWS - 1 - DRAWS / 40]];
    Some(HeldOutError {
        split: split.to_owned(),
        rmse: BTreeMap::from([(name.to_owned(), rms(rows.iter()))]),
        moment_rmse_nmm_each: None,
        interval95: BTreeMap::from([(name.to_owned(), interval)]),
        points: rows.len(),
        loo: None,
    })
}

/// Share of held-out readings inside their stated 95 % intervals.
#[must_use]
pub fn coverage95(rows: &[HeldOut]) -> Option<f64> {
    let inside = rows.iter().filter(|r| r.error.abs() <= r.half95).count();
    (!rows.is_empty()).then(|| inside as f64 / rows.len() as f64)
}
