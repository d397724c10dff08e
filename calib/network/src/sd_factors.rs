//! Calibration of the stated covariance: factors on the network's own standard deviation with which
//! its 90 % regions cover held-out data.
//!
//! Estimates are sorted by the stated spread `t = sqrt(trace C)` into groups of equal number; each
//! has its split-conformal factor f_g at its median t_g (`wcal-lab train` finds them). Between
//! medians the factor is linear in log t, beyond them constant:
//!
//! ```text
//! f(t) = (1 - u) f_g + u f_{g+1},   u = log(t / t_g) / log(t_{g+1} / t_g);   stated covariance = f(t)^2 C
//! ```
//!
//! Source: conformal prediction by groups (Mondrian), V. Vovk, A. Gammerman, G. Shafer,
//! "Algorithmic Learning in a Random World", 2005, 4.5.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Factors on stated standard deviations by how wide the network itself states them. Where it is
/// sure it may be too modest, where it is lost too bold. How often it is lost differs from bench to
/// bench (conformal by groups: V. Vovk et al., "Algorithmic Learning in a Random World").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SdFactors {
    /// Spreads (root of the covariance's trace) at which the factors hold, mm, rising; between them
    /// factors go with the spread's logarithm, beyond them they stay.
    pub at_mm: Vec<f64>,
    /// Factors.
    pub factors: Vec<f64>,
}

impl SdFactors {
    /// One factor for all.
    pub fn constant(factor: f64) -> Self {
        Self {
            at_mm: vec![1.0],
            factors: vec![factor],
        }
    }

    /// The factor at a spread, mm.
    pub fn at(&self, stated_mm: f64) -> f64 {
        let above = self.at_mm.partition_point(|at| *at <= stated_mm);
        match (above.checked_sub(1), self.at_mm.get(above)) {
            (Some(below), Some(next)) => {
                // Linear in the logarithm of the spread.
                let share = (stated_mm / self.at_mm[below]).ln() / (next / self.at_mm[below]).ln();
                self.factors[below] * (1.0 - share) + self.factors[above] * share
            }
            (Some(last), None) => self.factors[last],
            (None, _) => self.factors.first().copied().unwrap_or(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::SdFactors;

    #[test]
    fn factors_go_evenly_with_the_logarithm_and_stay_beyond() {
        let f = SdFactors {
            at_mm: vec![0.1, 10.0],
            factors: vec![1.0, 3.0],
        };
        assert_eq!(
            [0.01, 0.1, 10.0, 99.0].map(|mm| f.at(mm)),
            [1.0, 1.0, 3.0, 3.0]
        );
        assert!((f.at(1.0) - 2.0).abs() < 1e-12);
    }
}
