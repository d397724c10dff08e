//! What is known of the friction between wire and object before a record.
//!
//! ```text
//! p(mu)  uniform over 0 .. 0.3 where nothing is stated;  ~ exp(-(mu - m)^2 / 2 s^2), mu >= 0, where m +- s is
//! P_i ~ p(mu_i) (mu_(i+1) - mu_(i-1)) / 2        weight of a hypothesis: the density times its cell
//! ```

use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Coefficients of the hypotheses where nothing is stated.
const COEFFICIENTS: [f64; 4] = [0.0, 0.1, 0.2, 0.3];
/// The outer ones of a stated coefficient lie so many standard deviations from it.
const OUTER_SDS: f64 = 2.0;
/// Largest coefficient that can be stated.
const LARGEST: f64 = 2.0;

/// A coefficient of friction before a record.
#[derive(Debug, Clone, Copy, Default)]
pub struct FrictionPrior {
    /// Mean and standard deviation, where they are stated.
    stated: Option<[f64; 2]>,
}

impl FrictionPrior {
    /// Coefficients of the hypotheses, from the least on.
    pub(super) fn coefficients(&self) -> Vec<f64> {
        let Some([mean, sd]) = self.stated else {
            return COEFFICIENTS.to_vec();
        };
        // Below zero there is no coefficient: what would lie there is at zero, once.
        let mut all = [-OUTER_SDS, 0.0, OUTER_SDS]
            .map(|u| (mean + u * sd).max(0.0))
            .to_vec();
        all.dedup();
        all
    }

    /// Weights of hypotheses with these coefficients, which rise.
    pub(super) fn weights(&self, of: &[f64]) -> Vec<f64> {
        // Trapezoids of the prior: the density at a coefficient times its cell.
        let density = |mu: f64| {
            self.stated.map_or(1.0, |[m, s]| {
                (-0.5 * ((mu - m) / s.max(1e-9)).powi(2)).exp()
            })
        };
        let gap = |k: usize| of.get(k + 1).map(|next| next - of[k]);
        let cell = |k: usize| {
            let (before, after) = (k.checked_sub(1).and_then(gap), gap(k));
            // An outer cell reaches as far out as in.
            before
                .or(after)
                .zip(after.or(before))
                .map_or(1.0, |(a, b)| 0.5 * (a + b))
        };
        (0..of.len()).map(|k| density(of[k]) * cell(k)).collect()
    }
}

impl Display for FrictionPrior {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self.stated {
            Some([mean, sd]) => write!(f, "{mean}+-{sd}"),
            None => write!(
                f,
                "{}..{}",
                COEFFICIENTS[0],
                COEFFICIENTS[COEFFICIENTS.len() - 1]
            ),
        }
    }
}

impl FromStr for FrictionPrior {
    type Err = String;

    /// `0.1 +- 0.05`: mean and standard deviation.
    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || {
            format!(
                "expected a coefficient from 0 to {LARGEST} with its standard deviation, as 0.1 +- 0.05, found {text:?}"
            )
        };
        let (mean, sd) = text.split_once("+-").ok_or_else(expected)?;
        let number = |t: &str| {
            t.trim()
                .parse::<f64>()
                .ok()
                .filter(|v| (0.0..=LARGEST).contains(v))
        };
        let [mean, sd] = [
            number(mean).ok_or_else(expected)?,
            number(sd).ok_or_else(expected)?,
        ];
        Ok(Self {
            stated: Some([mean, sd]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stated_friction_has_its_mean_and_spread() {
        let prior: FrictionPrior = "0.15 +- 0.05".parse().unwrap();
        let (of, weights) = (prior.coefficients(), prior.weights(&prior.coefficients()));
        let total: f64 = weights.iter().sum();
        let mean: f64 = of.iter().zip(&weights).map(|(mu, w)| mu * w / total).sum();
        let variance: f64 = of
            .iter()
            .zip(&weights)
            .map(|(mu, w)| (mu - mean).powi(2) * w / total)
            .sum();
        assert!(
            (mean - 0.15).abs() < 1e-9 && (variance.sqrt() / 0.05 - 1.0).abs() < 0.1,
            "{mean} {variance}"
        );
        // Control: where nothing is stated all are as probable.
        let plain = FrictionPrior::default();
        assert!(
            plain
                .weights(&plain.coefficients())
                .windows(2)
                .all(|w| (w[0] - w[1]).abs() < 1e-12)
        );
        assert_eq!(
            [prior, plain].map(|p| p.to_string()),
            ["0.15+-0.05", "0..0.3"]
        );
        // None is negative, and one that is known is one.
        assert_eq!(
            "0.05 +- 0.1"
                .parse::<FrictionPrior>()
                .unwrap()
                .coefficients()[0],
            0.0
        );
        assert_eq!(
            "0.1 +- 0".parse::<FrictionPrior>().unwrap().coefficients(),
            [0.1]
        );
        assert_eq!(
            "0.1 +- 0".parse::<FrictionPrior>().unwrap().weights(&[0.1]),
            [1.0]
        );
        assert!(
            ["0.1", "-0.1 +- 0.1", "0.1 +- x", "3 +- 1"]
                .iter()
                .all(|t| t.parse::<FrictionPrior>().is_err())
        );
    }
}
