//! Single readings that do not belong: flagged against a robust scale, kept in the table, left out of the fit.

use super::fit::{Fit, Weights, fit};
use crate::candidate::{System, Term};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// A fit without the readings that were flagged.
#[derive(Debug, Clone)]
pub struct Cleaned {
    /// The refit.
    pub fit: Fit,
    /// Weights with flagged readings at zero.
    pub weights: Weights,
    /// Flagged readings.
    pub flagged: Vec<usize>,
}

/// More flagged readings than this share are no longer single readings.
const LARGEST_SHARE: f64 = 0.08;
/// Family-wise level over all readings.
const LEVEL: f64 = 0.002;

fn robust_scale(squared: &mut [f64], channels: usize) -> f64 {
    squared.sort_by(f64::total_cmp);
    let median = squared[squared.len() / 2];
    // Median of chi-squared with 1 or 2 degrees of freedom.
    median / if channels == 1 { 0.454_936 } else { 1.386_294 }
}

/// Flags readings whose squared residual over a robust variance is beyond the level, refits, and repeats.
pub fn clean(system: &dyn System, terms: &[Term], start: &Fit, weights: &Weights) -> Option<Cleaned> {
    let n = start.residual.nrows();
    let channels = start.residual.ncols();
    let chi = ChiSquared::new(channels as f64).ok()?;
    let limit = chi.inverse_cdf(1.0 - LEVEL / n as f64);
    let mut current = start.clone();
    let mut weights = weights.clone();
    let mut flagged: Vec<usize> = Vec::new();
    for _ in 0..4 {
        let size = |i: usize| (0..channels).map(|c| current.residual[(i, c)].powi(2)).sum::<f64>();
        let mut active: Vec<f64> = (0..n).filter(|&i| weights.0[i] > 0.0).map(size).collect();
        if active.len() < 12 {
            return None;
        }
        let variance = robust_scale(&mut active, channels);
        let new: Vec<usize> = (0..n).filter(|&i| weights.0[i] > 0.0 && size(i) > limit * variance).collect();
        if new.is_empty() {
            break;
        }
        for &i in &new {
            weights.0[i] = 0.0;
        }
        flagged.extend(new);
        if flagged.len() as f64 > LARGEST_SHARE * n as f64 + 1.0 {
            return None;
        }
        current = fit(system, terms, &weights, 15)?;
    }
    if flagged.is_empty() {
        return None;
    }
    flagged.sort_unstable();
    Some(Cleaned { fit: current, weights, flagged })
}
