//! The crate's error type.

use thiserror::Error;

/// Why a map could not be fitted, read or evaluated.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MapError {
    /// Columns of the training set differ in length.
    #[error("checking the training set: expected {expected} entries in `{field}`, found {found}")]
    Length {
        /// Field of [`crate::MapTraining`].
        field: &'static str,
        /// Number of readings.
        expected: usize,
        /// Entries found.
        found: usize,
    },
    /// A value is NaN or infinite.
    #[error(
        "checking the training set: `{field}` of point {point}: expected a finite number, found {found}"
    )]
    NotFinite {
        /// Field of [`crate::MapTraining`].
        field: &'static str,
        /// Point number.
        point: i64,
        /// Value found.
        found: f64,
    },
    /// Too few readings for even an affine map with an error estimate.
    #[error("fitting a map: expected at least {expected} readings, found {found}")]
    TooFew {
        /// Smallest usable number.
        expected: usize,
        /// Readings found.
        found: usize,
    },
    /// The readings do not determine the trend (all on one line, or all equal).
    #[error(
        "fitting a map with {trend} trend: expected readings that determine it, found a rank-deficient cloud of {readings} readings"
    )]
    RankDeficient {
        /// Trend.
        trend: &'static str,
        /// Number of readings.
        readings: usize,
    },
    /// Thin-plate radius too small for the region where it would be used.
    #[error(
        "checking the thin-plate kernel: expected a radius of at least {required:.6} (1.6 x the diameter of readings and declared domain), found {found:.6}"
    )]
    RadiusTooSmall {
        /// Smallest safe radius, scaled input units.
        required: f64,
        /// Radius found.
        found: f64,
    },
    /// A covariance matrix is not positive definite.
    #[error(
        "factorising the covariance of {readings} readings: expected a positive definite matrix, found none (kernel outside its valid radius, or noise of zero with repeated readings)"
    )]
    NotPositiveDefinite {
        /// Number of readings.
        readings: usize,
    },
    /// The artefact contradicts itself, or is of a version that this program does not know.
    #[error("reading a map: expected {expected}, found {found}")]
    Artefact {
        /// What a sound artefact has.
        expected: String,
        /// What this one has.
        found: String,
    },
    /// No candidate could be fitted.
    #[error(
        "choosing a map: expected at least one candidate that can be fitted, found none: {reasons}"
    )]
    NoCandidate {
        /// Why each one failed.
        reasons: String,
    },
}
