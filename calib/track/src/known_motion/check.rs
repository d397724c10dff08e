//! Consistency of motion and moments: the innovations at the best state.
//!
//! ```text
//! chi2 = |S^-1/2 (y - m(theta))|^2 ~ chi-squared(2 n - 3)            n readings of two moments, three fitted numbers
//! inconsistent where P(chi-squared > chi2) < 1e-4 and chi2 > 1.5 (2 n - 3)
//! ```
//!
//! Source of the test: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to
//! Tracking and Navigation", 2001, 5.4.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Innovations are too large below this p-value and above this ratio to the degrees of freedom.
const LEVEL: f64 = 1e-4;
const RATIO: f64 = 1.5;
/// One reading in this many may be an outlier.
const MAX_GROSS: usize = 10;

/// What is said of a contact whose innovations are inconsistent.
const DISAGREEMENT: &str = "moments and motion disagree: the motion reversed or in another unit, another calibration or wire, another clock, or a \
     contact that is no fixed point";

/// Innovations of an episode at its best state.
#[derive(Debug, Clone, Copy, Default)]
pub struct Innovations {
    /// Chi-squared with every reading taken as regular.
    pub plain: f64,
    /// Chi-squared with the larger noise for the outliers.
    pub robust: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Outliers.
    pub outlier: usize,
    /// Readings.
    pub rows: usize,
}

impl Innovations {
    /// Of an episode that no state explains.
    pub fn unexplained(rows: usize) -> Self {
        Self {
            plain: f64::INFINITY,
            robust: f64::INFINITY,
            dof: 2.0 * rows as f64,
            outlier: 0,
            rows,
        }
    }

    /// Whether the innovations are consistent, a few outliers allowed.
    pub fn consistent(&self) -> bool {
        !too_large(self.robust, self.dof) && self.outlier <= (self.rows / MAX_GROSS).max(1)
    }

    /// What speaks against motion and moments, for people; none where they are consistent.
    pub fn sentence(&self) -> Option<String> {
        let of = || {
            format!(
                "{DISAGREEMENT} (chi2 {:.0} for {:.0} degrees of freedom)",
                self.plain, self.dof
            )
        };
        (!self.consistent()).then(of)
    }
}

/// Whether a chi-squared is too large for its degrees of freedom.
fn too_large(chi2: f64, dof: f64) -> bool {
    // Innovations of a right model are white with covariance S, so that their sum of squares is
    // chi-squared.
    let chance = ChiSquared::new(dof.max(1.0)).map_or(1.0, |c| c.sf(chi2));
    !chi2.is_finite() || chance < LEVEL && chi2 > RATIO * dof
}
