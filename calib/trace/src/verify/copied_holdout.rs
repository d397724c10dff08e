//! Rows of a holdout that also stand in the points table: copied, or equal because the gauge is coarse.
//!
//! ```text
//! P(K >= k),   K ~ Binomial(m, p)      k of m sealed rows equal a fitted one; p: chance that an honest repeat does
//! ```
//!
//! Under a clock two rows of one reading are a copy, unless rows of the points table themselves agree in every column (a coarse clock). Without a
//! clock p is what repeats inside the points table show; where nothing is repeated, the steps of the readings tell a coarse gauge.

use statrs::distribution::{Binomial, DiscreteCDF};
use std::collections::BTreeMap;

/// A row as it is compared; numbers by their bits.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparedRow {
    /// What was set: stimulus or pose, direction.
    pub setting: Vec<u64>,
    /// What was read.
    pub reading: Vec<f64>,
    /// Every other column that was measured.
    pub rest: Vec<u64>,
    /// Time, s.
    pub t_s: Option<f64>,
}

impl ComparedRow {
    fn key(&self) -> Vec<u64> {
        let read = self.reading.iter().map(|v| v.to_bits());
        let rest = self.rest.iter().copied().chain(self.t_s.map(f64::to_bits));
        self.setting.iter().copied().chain(read).chain(rest).collect()
    }
}

/// Bits of values that may be absent.
pub fn bits(values: &[Option<f64>]) -> Vec<u64> {
    values.iter().map(|v| v.map_or(u64::MAX, f64::to_bits)).collect()
}

/// Chance below which as many equal rows are no accident.
const LEVEL: f64 = 0.01;
/// Repeats from which the chance of equal readings is known.
const MIN_REPEATS: usize = 5;
/// A gauge with no more steps over what was read is coarse: its repeats agree. 12 bits.
const COARSE_STEPS: f64 = 4096.0;

/// Why the holdout proves nothing, where more of its rows stand among the fitted ones than honest repeats would.
pub fn copied_holdout(fitted: &[ComparedRow], sealed: &[ComparedRow]) -> Option<String> {
    let mut known: BTreeMap<Vec<u64>, usize> = BTreeMap::new();
    fitted.iter().for_each(|r| *known.entry(r.key()).or_default() += 1);
    let copied = sealed.iter().filter(|r| known.contains_key(&r.key())).count();
    if copied == 0 {
        return None;
    }
    let equal = |of: &mut dyn Iterator<Item = &ComparedRow>| of.filter(|r| known[&r.key()] > 1).count();
    let timed = sealed.iter().all(|r| r.t_s.is_some());
    let suspicious = if timed {
        let agreeing = equal(&mut fitted.iter());
        agreeing == 0 || improbable(copied, sealed.len(), upper_share(agreeing, fitted.len()))
    } else {
        let mut settings: BTreeMap<&[u64], usize> = BTreeMap::new();
        fitted.iter().for_each(|r| *settings.entry(&r.setting).or_default() += 1);
        let repeats: Vec<&ComparedRow> =
            fitted.iter().filter(|r| settings[r.setting.as_slice()] > 1).collect();
        let chance = if repeats.len() >= MIN_REPEATS {
            improbable(copied, sealed.len(), upper_share(equal(&mut repeats.iter().copied()), repeats.len()))
        } else {
            !coarse(fitted)
        };
        copied > 2 && 2 * copied > sealed.len() && chance
    };
    suspicious.then(|| {
        format!(
            "{copied} rows of the holdout are also in the points table; a holdout that was in the fit proves nothing"
        )
    })
}

/// Upper bound of a share, two standard errors of its count above it and a row more.
fn upper_share(hits: usize, of: usize) -> f64 {
    ((hits as f64 + 2.0 * (hits as f64).sqrt() + 1.0) / of as f64).min(1.0)
}

/// As many of `of` would hardly agree by chance `p`.
fn improbable(hits: usize, of: usize, p: f64) -> bool {
    let Some(fewer) = hits.checked_sub(1) else { return false };
    Binomial::new(p, of as u64).is_ok_and(|b| b.sf(fewer as u64) < LEVEL)
}

/// In every channel the readings are whole multiples of a step that is no small share of what was read.
fn coarse(rows: &[ComparedRow]) -> bool {
    let channels = rows.first().map_or(0, |r| r.reading.len());
    (0..channels).all(|c| {
        let values: Vec<f64> = rows.iter().filter_map(|r| r.reading.get(c).copied()).collect();
        let [low, high] =
            values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(*v), b.max(*v)]);
        let step = (high - low) / COARSE_STEPS;
        // A display shows whole multiples of a power of ten.
        let unit = 10f64.powf(step.log10().ceil());
        high > low && values.iter().all(|v| (v / unit - (v / unit).round()).abs() < 1e-6)
    })
}
