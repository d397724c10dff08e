//! Calibration of the stated covariance: factors on the network's own standard deviation with which its 90 % regions cover held-out data.
//!
//! Estimates are sorted by the stated spread `t = sqrt(trace C)` into groups of equal number; each has its split-conformal factor f_g at its
//! median t_g (`score::calibrating_factor`). Between medians the factor is linear in log t, beyond them constant:
//!
//! ```text
//! f(t) = (1 - u) f_g + u f_{g+1},   u = log(t / t_g) / log(t_{g+1} / t_g);   stated covariance = f(t)^2 C
//! ```
//!
//! Source: conformal prediction by groups (Mondrian), V. Vovk, A. Gammerman, G. Shafer, "Algorithmic Learning in a Random World", 2005, 4.5.

use crate::score::{EstimateError, calibrating_factor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Factors on stated standard deviations by how wide the network itself states them: where it is sure it may be too modest, where it is lost too
/// bold, and how often it is lost differs from bench to bench (conformal by groups: V. Vovk et al., "Algorithmic Learning in a Random World").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SdFactors {
    /// Spreads (root of the covariance's trace) at which the factors hold, mm, rising; between them factors go with the spread's logarithm,
    /// beyond them they stay.
    pub at_mm: Vec<f64>,
    /// Factors.
    pub factors: Vec<f64>,
}

/// Largest number of groups, and smallest size of one.
const MAX_GROUPS: usize = 8;
const MIN_GROUP_SIZE: usize = 400;

impl SdFactors {
    /// One factor for all.
    #[must_use]
    pub fn constant(factor: f64) -> Self {
        Self { at_mm: vec![1.0], factors: vec![factor] }
    }

    /// From estimates with their own covariances, in groups of equal number by the spread.
    #[must_use]
    pub fn calibrated(all: &[EstimateError]) -> Self {
        let mut stated: Vec<(f64, EstimateError)> =
            all.iter().filter_map(|c| Some((c.stated_spread_mm?, *c))).collect();
        stated.sort_by(|a, b| a.0.total_cmp(&b.0));
        let groups = (stated.len() / MIN_GROUP_SIZE).clamp(1, MAX_GROUPS);
        let of_group = stated.len().div_ceil(groups).max(1);
        let (mut at_mm, mut factors) = (Vec::new(), Vec::new());
        for group in stated.chunks(of_group) {
            let middle_mm = group[group.len() / 2].0;
            if at_mm.last().is_none_or(|last| *last < middle_mm) {
                at_mm.push(middle_mm);
                factors.push(calibrating_factor(&group.iter().map(|g| g.1).collect::<Vec<_>>()));
            }
        }
        if at_mm.is_empty() { Self::constant(1.0) } else { Self { at_mm, factors } }
    }

    /// The factor at a spread, mm.
    #[must_use]
    pub fn at(&self, stated_mm: f64) -> f64 {
        let above = self.at_mm.partition_point(|at| *at <= stated_mm);
        match (above.checked_sub(1), self.at_mm.get(above)) {
            (Some(below), Some(next)) => {
                let share = (stated_mm / self.at_mm[below]).ln() / (next / self.at_mm[below]).ln();
                self.factors[below] * (1.0 - share) + self.factors[above] * share
            }
            (Some(last), None) => self.factors[last],
            (None, _) => self.factors.first().copied().unwrap_or(1.0),
        }
    }

    /// All factors multiplied by a number.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        self.factors.iter_mut().for_each(|f| *f *= factor);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::scores;
    use nalgebra::{Matrix3, Vector3};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Estimates: some sure with half the stated error, the others lost with twice the stated error; widened by the `factor` of their spread.
    fn drawn(sure: usize, lost: usize, seed: u64, factor: &SdFactors) -> Vec<EstimateError> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal =
            |sd: f64| sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng);
        let mut one = |stated_mm: f64, sd_mm: f64| {
            let off = Vector3::new(normal(sd_mm), normal(sd_mm), normal(sd_mm));
            let widened = stated_mm * factor.at(stated_mm * 3.0_f64.sqrt());
            EstimateError::new(0.0, off, &Vector3::y(), Some(&(Matrix3::identity() * widened.powi(2))))
        };
        let mut all: Vec<EstimateError> = (0..sure).map(|_| one(0.1, 0.05)).collect();
        all.extend((0..lost).map(|_| one(3.0, 6.0)));
        all
    }

    /// Binomial: 4,000 draws scatter by 0.5 % around 90 %.
    #[test]
    fn regions_hold_where_another_share_is_lost() {
        let own = SdFactors::constant(1.0);
        let by_spread = SdFactors::calibrated(&drawn(2000, 2000, 1, &own));
        let one = SdFactors::constant(calibrating_factor(&drawn(2000, 2000, 1, &own)));
        let coverage = |f: &SdFactors| scores(&drawn(3800, 200, 2, f)).coverage90.unwrap();
        assert!((coverage(&by_spread) - 0.9).abs() < 0.02, "{by_spread:?}: {}", coverage(&by_spread));
        // Control: one factor for all holds for the mixture that it comes from only.
        assert!(coverage(&one) > 0.97, "{}", coverage(&one));
    }

    #[test]
    fn factors_go_evenly_with_the_logarithm_and_stay_beyond() {
        let f = SdFactors { at_mm: vec![0.1, 10.0], factors: vec![1.0, 3.0] };
        assert_eq!([0.01, 0.1, 10.0, 99.0].map(|mm| f.at(mm)), [1.0, 1.0, 3.0, 3.0]);
        assert!((f.at(1.0) - 2.0).abs() < 1e-12 && (f.clone().scaled(0.5).at(1.0) - 1.0).abs() < 1e-12);
        assert_eq!(SdFactors::calibrated(&[]), SdFactors::constant(1.0));
    }
}
