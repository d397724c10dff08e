//! Do sealed readings refute an explanation? Only where they could show it.
//!
//! ```text
//! D = sum (e_before^2 - e_after^2) / s^2,   d = (e_before - e_after) / s          e: measured less predicted, s: noise of a reading
//! the explanation being right, D has the mean |d|^2 and the standard deviation 2 |d|
//! ```
//!
//! Where both models predict the sealed readings alike, |d| is small and nothing that they show speaks against either. Errors that readings of
//! a group share are no noise of a reading: the rise has to be beyond what it scatters between groups, too.
//!
//! ```text
//! T = sum over groups g of T_g,   T_g = sum (e_after^2 - e_before^2) / s^2;   asked: T > 2 sqrt(G var(T_g))
//! ```

use super::session_model::HeldOut;
use crate::levels::z;
use std::collections::BTreeMap;

/// Standard deviations of the sum over groups beyond which a rise is none of a few groups.
const BEYOND_GROUPS: f64 = 2.0;

/// Whether readings with standard deviations `sd` are so much worse under `after` that it cannot be right, as chance shows at `level`.
pub fn error_rise_test(before: &[HeldOut], after: &[HeldOut], sd: &[f64], level: f64) -> bool {
    let (mut gain, mut change) = (0.0, 0.0);
    let mut rises: BTreeMap<u32, f64> = BTreeMap::new();
    for ((b, a), sd) in before.iter().zip(after).zip(sd) {
        let rise = rises.entry(b.group).or_default();
        for (b, a) in b.errors[0].iter().zip(&a.errors[0]) {
            gain += (b * b - a * a) / (sd * sd);
            change += (b - a).powi(2) / (sd * sd);
            *rise += (a * a - b * b) / (sd * sd);
        }
    }
    change > 0.0
        && gain - change < -z(level) * 2.0 * f64::sqrt(change)
        && beyond_scatter(&rises.into_values().collect::<Vec<f64>>())
}

/// Whether a sum over groups is beyond what it scatters between them; a single group has no scatter to compare with.
fn beyond_scatter(of_groups: &[f64]) -> bool {
    let n = of_groups.len() as f64;
    let mean = of_groups.iter().sum::<f64>() / n;
    let variance = of_groups.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    n * mean > BEYOND_GROUPS * (n * variance).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(errors: &[f64]) -> Vec<HeldOut> {
        let row = |(k, e): (usize, &f64)| HeldOut {
            group: k as u32 / 2,
            errors: vec![vec![*e]],
            inside95: Vec::new(),
        };
        errors.iter().enumerate().map(row).collect()
    }

    #[test]
    fn readings_that_cannot_show_it_refute_nothing() {
        let sd = [1.0; 6];
        let noise = [0.4, -1.1, 0.7, 1.3, -0.2, -0.9];
        // Both models predict alike to a tenth of the noise: the error rises, but not beyond chance.
        let slightly: Vec<f64> = noise.iter().map(|e| e + 0.1 * f64::signum(*e)).collect();
        assert!(!error_rise_test(&rows(&noise), &rows(&slightly), &sd, 0.01));
        // Control: readings that the explanation moves by three standard deviations the wrong way.
        let moved: Vec<f64> = noise.iter().map(|e| e + 3.0).collect();
        assert!(error_rise_test(&rows(&noise), &rows(&moved), &sd, 0.01));
        assert!(
            !error_rise_test(&rows(&moved), &rows(&noise), &sd, 0.01),
            "the right explanation"
        );
        assert!(
            !error_rise_test(&rows(&noise), &rows(&noise), &sd, 0.01),
            "the same predictions"
        );
        // One group of three is off: its shared error, not the explanation's.
        let mut one = noise;
        one[0] += 8.0;
        one[1] += 8.0;
        assert!(!error_rise_test(&rows(&noise), &rows(&one), &sd, 0.01));
    }
}
