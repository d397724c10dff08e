//! A score beside its goal, with its bounds.

use crate::score::Outcome;
use serde::Serialize;
use statrs::distribution::{Beta, Binomial, ContinuousCDF, DiscreteCDF};

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Goal {
    /// What is measured.
    pub score: String,
    /// The goal in words.
    pub goal: String,
    /// Measured value.
    pub value: f64,
    /// 95 % bounds: of shares by Clopper and Pearson, of quantiles by order statistics (infinite
    /// where too few values bound them).
    pub bounds: Option<(f64, f64)>,
    /// Hits and trials, for shares; else the number of values.
    pub counts: (usize, usize),
    /// Whether the goal is met by the bounds; none where there is no goal or no data, or where the
    /// bounds leave it open.
    pub met: Option<bool>,
}

impl Goal {
    /// Whether there is a goal, and data that do not decide it.
    pub fn open(&self) -> bool {
        self.met.is_none() && self.goal != "-" && self.counts.1 > 0
    }
}

/// Exact 95 % bounds of a share: `hits` of `trials` (Clopper and Pearson 1934).
pub fn clopper_pearson(hits: usize, trials: usize) -> (f64, f64) {
    let (k, n) = (hits as f64, trials as f64);
    let quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).map_or(f64::NAN, |d| d.inverse_cdf(p));
    let low = if hits == 0 {
        0.0
    } else {
        quantile(k, n - k + 1.0, 0.025)
    };
    let high = if hits == trials {
        1.0
    } else {
        quantile(k + 1.0, n - k, 0.975)
    };
    (low, high)
}

/// Which side of a number a goal lies on.
pub(super) enum Side {
    AtLeast(f64),
    AtMost(f64),
    /// The bounds contain it.
    Contains(f64),
    /// A statement on the sessions that were drawn, not on a rate: all of them.
    All,
    /// As `All`: none of them.
    NoneOfThem,
    None,
}

pub(super) fn share(
    score: &str,
    goal: &str,
    of: &[&Outcome],
    hit: impl Fn(&Outcome) -> bool,
    side: Side,
) -> Goal {
    let hits = of.iter().filter(|o| hit(o)).count();
    rate(score, goal, hits, of.len(), side)
}

pub(super) fn rate(score: &str, goal: &str, hits: usize, trials: usize, side: Side) -> Goal {
    let value = hits as f64 / trials as f64;
    let bounds = (trials > 0).then(|| clopper_pearson(hits, trials));
    let met = bounds.and_then(|(low, high)| match side {
        Side::AtLeast(g) => decided(low >= g, high < g),
        Side::AtMost(g) => decided(high <= g, low > g),
        Side::Contains(g) => Some(low <= g && g <= high),
        Side::All => Some(hits == trials),
        Side::NoneOfThem => Some(hits == 0),
        Side::None => None,
    });
    Goal {
        score: score.into(),
        goal: goal.into(),
        value,
        bounds,
        counts: (hits, trials),
        met,
    }
}

/// Met, missed, or neither.
fn decided(met: bool, missed: bool) -> Option<bool> {
    if met {
        Some(true)
    } else {
        missed.then_some(false)
    }
}

/// Bounds of a quantile that hold for any distribution: the order statistics whose ranks a binomial
/// count of values below it has at 2.5 and 97.5 % (Conover, Practical Nonparametric Statistics,
/// sec. 3.2). The largest value is what it is.
fn quantile_bounds(sorted: &[f64], quantile: f64) -> (f64, f64) {
    let n = sorted.len();
    if quantile >= 1.0 {
        let last = sorted.last().copied().unwrap_or(f64::NAN);
        return (last, last);
    }
    let below = Binomial::new(quantile, n as u64);
    let rank = |p: f64| below.as_ref().map_or(0, |b| b.inverse_cdf(p)) as usize;
    let low = rank(0.025)
        .checked_sub(1)
        .map_or(f64::NEG_INFINITY, |k| sorted[k]);
    (
        low,
        sorted.get(rank(0.975)).copied().unwrap_or(f64::INFINITY),
    )
}

/// Quantile of the finite values, linear between them; NaN where there is none.
pub(super) fn quantile_of(mut values: Vec<f64>, quantile: f64) -> f64 {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    if values.is_empty() {
        return f64::NAN;
    }
    let at = quantile * (values.len() - 1) as f64;
    let (i, f) = (at.floor() as usize, at.fract());
    values[i] + f * (values[(i + 1).min(values.len() - 1)] - values[i])
}

pub(super) fn number(
    score: &str,
    goal: &str,
    mut values: Vec<f64>,
    quantile: f64,
    most: f64,
) -> Goal {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    let value = quantile_of(values.clone(), quantile);
    let bounds = (!values.is_empty()).then(|| quantile_bounds(&values, quantile));
    let met = bounds
        .filter(|_| most.is_finite())
        .and_then(|(low, high)| decided(high <= most, low > most));
    Goal {
        score: score.into(),
        goal: goal.into(),
        value,
        bounds,
        counts: (values.len(), values.len()),
        met,
    }
}
