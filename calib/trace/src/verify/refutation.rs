//! Do sealed readings refute an explanation? Only where they could show it.
//!
//! ```text
//! D = sum (e_before^2 - e_after^2) / s^2,   d = (e_before - e_after) / s          e: measured less predicted, s: noise of a reading
//! the explanation being right, D has the mean |d|^2 and the standard deviation 2 |d|
//! ```
//!
//! Where both models predict the sealed readings alike, |d| is small and nothing that they show speaks against either.

use super::session_model::HeldOut;

/// Standard deviations below what a right explanation gives: one in a hundred.
const REFUTES: f64 = 2.33;

/// Whether readings with standard deviations `sd` are so much worse under `after` that it cannot be right.
#[must_use]
pub fn refuted(before: &[HeldOut], after: &[HeldOut], sd: &[f64]) -> bool {
    let (mut gain, mut change) = (0.0, 0.0);
    for ((b, a), sd) in before.iter().zip(after).zip(sd) {
        for (b, a) in b.errors[0].iter().zip(&a.errors[0]) {
            gain += (b * b - a * a) / (sd * sd);
            change += (b - a).powi(2) / (sd * sd);
        }
    }
    change > 0.0 && gain - change < -REFUTES * 2.0 * f64::sqrt(change)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(errors: &[f64]) -> Vec<HeldOut> {
        errors.iter().map(|e| HeldOut { group: 0, errors: vec![vec![*e]], inside95: Vec::new() }).collect()
    }

    #[test]
    fn readings_that_cannot_show_it_refute_nothing() {
        let sd = [1.0; 6];
        let noise = [0.4, -1.1, 0.7, 1.3, -0.2, -0.9];
        // Both models predict alike to a tenth of the noise: the error rises, but not beyond chance.
        let slightly: Vec<f64> = noise.iter().map(|e| e + 0.1 * f64::signum(*e)).collect();
        assert!(!refuted(&rows(&noise), &rows(&slightly), &sd));
        // Control: readings that the explanation moves by three standard deviations the wrong way.
        let moved: Vec<f64> = noise.iter().map(|e| e + 3.0).collect();
        assert!(refuted(&rows(&noise), &rows(&moved), &sd));
        assert!(!refuted(&rows(&moved), &rows(&noise), &sd), "the right explanation");
        assert!(!refuted(&rows(&noise), &rows(&noise), &sd), "the same predictions");
    }
}
