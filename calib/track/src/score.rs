//! How good tracks are: distances to the surface and to the true contact, coverage of the stated regions, detection.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Squared radius of the 90 % region of three Gaussian numbers (chi-squared, three degrees of freedom).
pub const CHI2_90: f64 = 6.251_388_631_170_32;

/// One estimate beside the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// Distance of the estimate to the object's surface, mm.
    pub surface_mm: f64,
    /// Estimate less true contact, mm.
    pub off_mm: Vector3<f64>,
    /// Squared distance in units of the stated covariance; `None` where none is stated.
    pub mahalanobis2: Option<f64>,
    /// Root of the stated covariance's trace, mm.
    pub stated_mm: Option<f64>,
    /// Part of the error along the contact's way over the sample, mm (0 where it did not move).
    pub along_mm: f64,
}

impl Compared {
    /// Whether the truth lies in the stated 90 % region.
    #[must_use]
    pub fn holds90(&self) -> bool {
        self.mahalanobis2.is_some_and(|m| m <= CHI2_90)
    }

    /// Of an estimate with covariance (mm^2), where it has one.
    #[must_use]
    pub fn new(
        surface_mm: f64,
        off_mm: Vector3<f64>,
        way: &Vector3<f64>,
        covariance: Option<&Matrix3<f64>>,
    ) -> Self {
        let mahalanobis2 = covariance.and_then(|c| c.cholesky()).map(|c| off_mm.dot(&c.solve(&off_mm)));
        let along_mm = way.try_normalize(1e-9).map_or(0.0, |w| w.dot(&off_mm));
        let stated_mm = covariance.map(|c| c.trace().max(0.0).sqrt());
        Self { surface_mm, off_mm, mahalanobis2, stated_mm, along_mm }
    }
}

/// Scores over many estimates.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Scores {
    /// Number of estimates.
    pub samples: usize,
    /// RMSE to the object's surface, mm: the paper's number.
    pub rmse_mm: f64,
    /// Mean and 95 % quantile of the distance to the surface, mm.
    pub mean_mm: f64,
    /// See `mean_mm`.
    pub p95_mm: f64,
    /// RMSE to the true contact, mm.
    pub true_contact_rmse_mm: f64,
    /// Median distance to the true contact, mm.
    pub true_contact_median_mm: f64,
    /// RMSE along the contact's way, mm.
    pub along_track_mm: f64,
    /// Share of true contacts in the stated 90 % region.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage90: Option<f64>,
}

/// Scores of estimates; all 0 without any.
#[must_use]
pub fn scores(all: &[Compared]) -> Scores {
    if all.is_empty() {
        return Scores::default();
    }
    let n = all.len() as f64;
    let rms =
        |value: &dyn Fn(&Compared) -> f64| (all.iter().map(|c| value(c).powi(2)).sum::<f64>() / n).sqrt();
    let quantile = |value: &dyn Fn(&Compared) -> f64, q: f64| {
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
        true_contact_rmse_mm: rms(&|c| c.off_mm.norm()),
        true_contact_median_mm: quantile(&|c| c.off_mm.norm(), 0.5),
        along_track_mm: rms(&|c| c.along_mm),
        coverage90: (!stated.is_empty()).then(|| within as f64 / stated.len() as f64),
    }
}

/// Factor on stated standard deviations with which the 90 % region holds 90 % of these estimates (split conformal: V. Vovk et al.,
/// "Algorithmic Learning in a Random World"); 1 without estimates.
#[must_use]
pub fn calibrating_factor(all: &[Compared]) -> f64 {
    let mut stated: Vec<f64> = all.iter().filter_map(|c| c.mahalanobis2).collect();
    if stated.is_empty() {
        return 1.0;
    }
    stated.sort_by(f64::total_cmp);
    let rank = ((stated.len() + 1) as f64 * 0.9).ceil() as usize;
    (stated[rank.clamp(1, stated.len()) - 1] / CHI2_90).sqrt()
}

/// Precision, recall and their harmonic mean.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Detection {
    /// Share of what was called contact that is.
    pub precision: f64,
    /// Share of contacts that were called so.
    pub recall: f64,
    /// Harmonic mean.
    pub f1: f64,
}

/// Detection from pairs of called and true.
#[must_use]
pub fn detection(pairs: &[(bool, bool)]) -> Detection {
    let count = |a: bool, b: bool| pairs.iter().filter(|p| **p == (a, b)).count() as f64;
    let (hits, false_calls, missed) = (count(true, true), count(true, false), count(false, true));
    let share = |part: f64, rest: f64| if part + rest > 0.0 { part / (part + rest) } else { 0.0 };
    let (precision, recall) = (share(hits, false_calls), share(hits, missed));
    let f1 = if precision + recall > 0.0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 };
    Detection { precision, recall, f1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn drawn(sd_mm: f64, stated_mm: f64) -> Vec<Compared> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut normal = || sd_mm * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng);
        let stated = Matrix3::identity() * stated_mm.powi(2);
        (0..4000)
            .map(|_| {
                let off = Vector3::new(normal(), normal(), normal());
                Compared::new(off.x.abs(), off, &Vector3::y(), Some(&stated))
            })
            .collect()
    }

    /// Binomial: 4,000 draws scatter by 0.5 % around 90 %.
    #[test]
    fn true_spreads_cover_and_wrong_ones_do_not_until_they_are_calibrated() {
        let honest = scores(&drawn(0.3, 0.3));
        assert!((honest.coverage90.unwrap() - 0.9).abs() < 0.015, "{honest:?}");
        assert!((honest.rmse_mm - 0.3).abs() < 0.01 && (honest.true_contact_rmse_mm - 0.52).abs() < 0.01);
        assert!((honest.along_track_mm - 0.3).abs() < 0.01);
        let bold = drawn(0.3, 0.1);
        assert!(scores(&bold).coverage90.unwrap() < 0.3);
        assert!((calibrating_factor(&bold) - 3.0).abs() < 0.1);
    }

    #[test]
    fn detection_counts_misses_and_false_calls() {
        let pairs = [(true, true), (true, true), (true, false), (false, true), (false, false)];
        let d = detection(&pairs);
        assert!((d.precision - 2.0 / 3.0).abs() < 1e-12 && (d.recall - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(detection(&[(false, false)]), Detection::default());
    }
}
