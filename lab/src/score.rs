//! How good tracks are: distances to the surface and to the true contact, coverage of the stated
//! regions, detection.
//!
//! With estimate p of the contact c, stated covariance C, and the contact's path d over the sample:
//!
//! ```text
//! RMSE        sqrt(mean e^2),  e = distance to the surface, |p - c|, or (p - c) . d / |d|
//! region      (p - c)^T C^-1 (p - c) <= chi2_3(0.9) = 6.251          90 % region of three Gaussian numbers
//! calibration f = sqrt(q / chi2_3(0.9)),  q the ceil(0.9 (n + 1))-th smallest of the left side      (split conformal)
//! detection   F1 = 2 P R / (P + R),  P precision, R recall
//! ```
//!
//! Source of the calibration: V. Vovk, A. Gammerman, G. Shafer, "Algorithmic Learning in a Random
//! World", 2005.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::Serialize;
use wcal_network::sd_factors::SdFactors;

/// Squared radius of the 90 % region of three Gaussian numbers (chi-squared, three degrees of
/// freedom).
pub const CHI2_90: f64 = 6.251_388_631_170_32;
/// Largest number of groups, and smallest size of one.
const MAX_GROUPS: usize = 8;
const MIN_GROUP_SIZE: usize = 400;

/// One estimate compared with the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimateError {
    /// Distance of the estimate to the object's surface, mm.
    pub surface_mm: f64,
    /// Estimate less true contact, mm.
    pub error_mm: Vector3<f64>,
    /// Squared distance in units of the stated covariance; `None` where none is stated.
    pub mahalanobis2: Option<f64>,
    /// Root of the stated covariance's trace, mm.
    pub stated_spread_mm: Option<f64>,
    /// Part of the error along the contact's path over the sample, mm (0 where it did not move).
    pub along_mm: f64,
}

impl EstimateError {
    /// Whether the truth lies in the stated 90 % region.
    pub fn in_region90(&self) -> bool {
        self.mahalanobis2.is_some_and(|m| m <= CHI2_90)
    }

    /// Of an estimate with covariance (mm^2), where it has one.
    pub fn new(
        surface_mm: f64,
        error_mm: Vector3<f64>,
        path: &Vector3<f64>,
        covariance: Option<&Matrix3<f64>>,
    ) -> Self {
        // (p - c)^T C^-1 (p - c); a covariance that is not positive definite states nothing.
        let mahalanobis2 = covariance
            .and_then(|c| c.cholesky())
            .map(|c| error_mm.dot(&c.solve(&error_mm)));
        let along_mm = path.try_normalize(1e-9).map_or(0.0, |w| w.dot(&error_mm));
        let stated_spread_mm = covariance.map(|c| c.trace().max(0.0).sqrt());
        Self {
            surface_mm,
            error_mm,
            mahalanobis2,
            stated_spread_mm,
            along_mm,
        }
    }
}

/// Count and sum of squares, mm^2.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SquareSum {
    /// Number of estimates.
    pub count: f64,
    /// Sum of their squared errors, mm^2.
    pub squares_mm2: f64,
}

impl SquareSum {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        values.fold(Self::default(), |s, x| Self {
            count: s.count + 1.0,
            squares_mm2: s.squares_mm2 + x * x,
        })
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            squares_mm2: self.squares_mm2 + other.squares_mm2,
        }
    }

    pub(crate) fn rmse_mm(self) -> f64 {
        (self.squares_mm2 / f64::max(self.count, 1.0)).sqrt()
    }
}

/// Errors over one sweep.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SweepSums {
    /// To the surface, to the true contact, and along its path.
    pub surface: SquareSum,
    /// See `surface`.
    pub contact: SquareSum,
    /// See `surface`.
    pub along: SquareSum,
    /// The same over samples whose contact has been tracked for a while: to the surface, and to the
    /// true contact.
    pub followed_surface: SquareSum,
    /// See `followed_surface`.
    pub followed_contact: SquareSum,
}

impl SweepSums {
    /// Of the estimates of a sweep; `true`: tracked for a while.
    pub fn of(pairs: &[(EstimateError, bool)]) -> Self {
        let all =
            |value: fn(&EstimateError) -> f64| SquareSum::of(pairs.iter().map(|p| value(&p.0)));
        let followed = |value: fn(&EstimateError) -> f64| {
            SquareSum::of(pairs.iter().filter(|p| p.1).map(|p| value(&p.0)))
        };
        Self {
            surface: all(|c| c.surface_mm),
            contact: all(|c| c.error_mm.norm()),
            along: all(|c| c.along_mm),
            followed_surface: followed(|c| c.surface_mm),
            followed_contact: followed(|c| c.error_mm.norm()),
        }
    }
}

/// Scores over many estimates.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
pub struct Scores {
    /// Number of estimates.
    pub samples: usize,
    /// RMSE to the object's surface, mm: the paper's number.
    pub rmse_mm: f64,
    /// Mean and 95 % quantile of the distance to the surface, mm.
    pub mean_mm: f64,
    /// mm.
    pub p95_mm: f64,
    /// RMSE to the true contact, mm.
    pub true_contact_rmse_mm: f64,
    /// Median distance to the true contact, mm.
    pub true_contact_median_mm: f64,
    /// RMSE along the contact's path, mm.
    pub along_track_mm: f64,
    /// Share of true contacts in the stated 90 % region.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage90: Option<f64>,
}

/// Scores of estimates; all 0 without any.
pub fn scores(all: &[EstimateError]) -> Scores {
    if all.is_empty() {
        return Scores::default();
    }
    let n = all.len() as f64;
    let rms = |value: &dyn Fn(&EstimateError) -> f64| {
        (all.iter().map(|c| value(c).powi(2)).sum::<f64>() / n).sqrt()
    };
    let quantile = |value: &dyn Fn(&EstimateError) -> f64, q: f64| {
        let mut sorted: Vec<f64> = all.iter().map(value).collect();
        sorted.sort_by(f64::total_cmp);
        sorted[((n - 1.0) * q).round() as usize]
    };
    let stated: Vec<f64> = all.iter().filter_map(|c| c.mahalanobis2).collect();
    let within = stated.iter().filter(|m| **m <= CHI2_90).count();
    Scores {
        samples: all.len(),
        rmse_mm: rms(&|c| c.surface_mm),
        mean_mm: all.iter().map(|c| c.surface_mm).sum::<f64>() / n,
        p95_mm: quantile(&|c| c.surface_mm, 0.95),
        true_contact_rmse_mm: rms(&|c| c.error_mm.norm()),
        true_contact_median_mm: quantile(&|c| c.error_mm.norm(), 0.5),
        along_track_mm: rms(&|c| c.along_mm),
        coverage90: (!stated.is_empty()).then(|| within as f64 / stated.len() as f64),
    }
}

/// Factor on stated standard deviations with which the 90 % region holds 90 % of these estimates
/// (split conformal: V. Vovk et al., "Algorithmic Learning in a Random World"); 1 without
/// estimates.
pub fn calibrating_factor(all: &[EstimateError]) -> f64 {
    let mut stated: Vec<f64> = all.iter().filter_map(|c| c.mahalanobis2).collect();
    if stated.is_empty() {
        return 1.0;
    }
    stated.sort_by(f64::total_cmp);
    // The (n + 1) in the rank makes the coverage hold for finite n: the next estimate is
    // exchangeable with these.
    let rank = ((stated.len() + 1) as f64 * 0.9).ceil() as usize;
    (stated[rank.clamp(1, stated.len()) - 1] / CHI2_90).sqrt()
}

/// Precision, recall and their harmonic mean.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
pub struct Detection {
    /// Share of what was called contact that is.
    pub precision: f64,
    /// Share of contacts that were called so.
    pub recall: f64,
    /// Harmonic mean.
    pub f1: f64,
}

/// Factors on stated standard deviations from estimates with their own covariances, in groups of
/// equal number by the spread (`wcal_network::sd_factors`).
pub fn calibrated(all: &[EstimateError]) -> SdFactors {
    let mut stated: Vec<(f64, EstimateError)> = all
        .iter()
        .filter_map(|c| Some((c.stated_spread_mm?, *c)))
        .collect();
    stated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let groups = (stated.len() / MIN_GROUP_SIZE).clamp(1, MAX_GROUPS);
    let of_group = stated.len().div_ceil(groups).max(1);
    let (mut at_mm, mut factors) = (Vec::new(), Vec::new());
    for group in stated.chunks(of_group) {
        let middle_mm = group[group.len() / 2].0;
        if at_mm.last().is_none_or(|last| *last < middle_mm) {
            at_mm.push(middle_mm);
            factors.push(calibrating_factor(
                &group.iter().map(|g| g.1).collect::<Vec<_>>(),
            ));
        }
    }
    if at_mm.is_empty() {
        SdFactors::constant(1.0)
    } else {
        SdFactors { at_mm, factors }
    }
}

/// Detection from pairs of called and true.
pub fn detection(pairs: &[(bool, bool)]) -> Detection {
    let count = |a: bool, b: bool| pairs.iter().filter(|p| **p == (a, b)).count() as f64;
    let (hits, false_calls, missed) = (count(true, true), count(true, false), count(false, true));
    let share = |part: f64, rest: f64| {
        if part + rest > 0.0 {
            part / (part + rest)
        } else {
            0.0
        }
    };
    let (precision, recall) = (share(hits, false_calls), share(hits, missed));
    let f1 = if precision + recall > 0.0 {
        2.0 * precision * recall / (precision + recall)
    } else {
        0.0
    };
    Detection {
        precision,
        recall,
        f1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn drawn(sd_mm: f64, stated_spread_mm: f64) -> Vec<EstimateError> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut normal =
            || sd_mm * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng);
        let stated = Matrix3::identity() * stated_spread_mm.powi(2);
        (0..4000)
            .map(|_| {
                let off = Vector3::new(normal(), normal(), normal());
                EstimateError::new(off.x.abs(), off, &Vector3::y(), Some(&stated))
            })
            .collect()
    }

    /// Binomial: 4,000 draws scatter by 0.5 % around 90 %.
    #[test]
    fn true_spreads_cover_and_wrong_ones_do_not_until_they_are_calibrated() {
        let honest = scores(&drawn(0.3, 0.3));
        assert!(
            (honest.coverage90.unwrap() - 0.9).abs() < 0.015,
            "{honest:?}"
        );
        assert!(
            (honest.rmse_mm - 0.3).abs() < 0.01
                && (honest.true_contact_rmse_mm - 0.52).abs() < 0.01
        );
        assert!((honest.along_track_mm - 0.3).abs() < 0.01);
        let bold = drawn(0.3, 0.1);
        assert!(scores(&bold).coverage90.unwrap() < 0.3);
        assert!((calibrating_factor(&bold) - 3.0).abs() < 0.1);
    }

    #[test]
    fn detection_counts_misses_and_false_calls() {
        let pairs = [
            (true, true),
            (true, true),
            (true, false),
            (false, true),
            (false, false),
        ];
        let d = detection(&pairs);
        assert!((d.precision - 2.0 / 3.0).abs() < 1e-12 && (d.recall - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(detection(&[(false, false)]), Detection::default());
    }

    /// Estimates: some sure with half the stated error, the others lost with twice the stated
    /// error; widened by the `factor` of their spread.
    fn sure_and_lost(
        sure: usize,
        lost: usize,
        seed: u64,
        factor: &SdFactors,
    ) -> Vec<EstimateError> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal =
            |sd: f64| sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng);
        let mut one = |stated_mm: f64, sd_mm: f64| {
            let off = Vector3::new(normal(sd_mm), normal(sd_mm), normal(sd_mm));
            let widened = stated_mm * factor.at(stated_mm * 3.0_f64.sqrt());
            EstimateError::new(
                0.0,
                off,
                &Vector3::y(),
                Some(&(Matrix3::identity() * widened.powi(2))),
            )
        };
        let mut all: Vec<EstimateError> = (0..sure).map(|_| one(0.1, 0.05)).collect();
        all.extend((0..lost).map(|_| one(3.0, 6.0)));
        all
    }

    /// Binomial: 4,000 draws scatter by 0.5 % around 90 %.
    #[test]
    fn regions_hold_where_another_share_is_lost() {
        let own = SdFactors::constant(1.0);
        let by_spread = calibrated(&sure_and_lost(2000, 2000, 1, &own));
        let one = SdFactors::constant(calibrating_factor(&sure_and_lost(2000, 2000, 1, &own)));
        let coverage = |f: &SdFactors| scores(&sure_and_lost(3800, 200, 2, f)).coverage90.unwrap();
        assert!(
            (coverage(&by_spread) - 0.9).abs() < 0.02,
            "{by_spread:?}: {}",
            coverage(&by_spread)
        );
        // Control: one factor for all holds for the mixture that it comes from only.
        assert!(coverage(&one) > 0.97, "{}", coverage(&one));
    }

    #[test]
    fn nothing_calibrates_nothing() {
        assert_eq!(calibrated(&[]), SdFactors::constant(1.0));
    }
}
