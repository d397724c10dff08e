//! Correlation functions of the scaled wavelength plane.
//!
//! Thin plate: k(r) = 1 - 3 u^2 + 2 u^3, u = r / R (O. Williams & A. Fitzgibbon, "Gaussian process
//! implicit surfaces", 2007). Matern 5/2: k(r) = (1 + s + s^2 / 3) exp(-s), s = sqrt(5) r / l (C.
//! Rasmussen & C. Williams, "Gaussian Processes for Machine Learning", 2006, eq. 4.17).

use crate::error::MapError;
use crate::geometry::distance;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Safe radius as a multiple of the diameter of readings and declared domain.
///
/// The thin-plate kernel is positive definite only where the data's ball has diameter <= 0.866 R
/// in the plane. A set of diameter d lies in a ball of diameter 2 d / sqrt(3) = 1.155 d (Jung), so
/// R >= 1.34 d suffices; 1.6 leaves a margin.
pub(crate) const RADIUS_PER_DIAMETER: f64 = 1.6;

/// Correlation between two scaled inputs; every one is 1 at distance 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "form")]
pub enum Kernel {
    /// No correlated part: a plain regression on the trend.
    None,
    /// (2 r^3 - 3 R r^2 + R^3) / R^3, the kernel of Williams & Fitzgibbon (2007, Gaussian process
    /// implicit surfaces) scaled to 1 at r = 0.
    ThinPlate {
        /// R of the thin plate, scaled.
        radius: f64,
    },
    /// Matern with smoothness 5/2 (Rasmussen & Williams 2006, eq. 4.17), isotropic.
    Matern52 {
        /// Length scale of Matern 5/2, scaled.
        length: f64,
    },
}

impl Kernel {
    /// Correlation at distance `r` (scaled input units).
    #[inline]
    pub fn at(&self, r: f64) -> f64 {
        match *self {
            Self::None => 0.0,
            Self::ThinPlate { radius } => {
                let u = r / radius;
                1.0 + u * u * (2.0 * u - 3.0)
            }
            Self::Matern52 { length } => {
                let s = 5.0_f64.sqrt() * r / length;
                (1.0 + s + s * s / 3.0) * (-s).exp()
            }
        }
    }

    /// Prior variance of the correlated part in units of the signal variance.
    pub fn at_zero(&self) -> f64 {
        if *self == Self::None { 0.0 } else { 1.0 }
    }

    /// The one shape parameter: R or the length.
    pub fn shape(&self) -> Option<f64> {
        match *self {
            Self::None => None,
            Self::ThinPlate { radius } => Some(radius),
            Self::Matern52 { length } => Some(length),
        }
    }

    /// The same form with another shape parameter.
    pub(crate) fn with_shape(&self, shape: f64) -> Self {
        match self {
            Self::None => Self::None,
            Self::ThinPlate { .. } => Self::ThinPlate { radius: shape },
            Self::Matern52 { .. } => Self::Matern52 { length: shape },
        }
    }

    /// Refuses a thin-plate radius that is too small for a region of this diameter (scaled input
    /// units).
    ///
    /// # Errors
    /// [`MapError::RadiusTooSmall`].
    pub(crate) fn check_radius(&self, diameter: f64) -> Result<(), MapError> {
        let required = RADIUS_PER_DIAMETER * diameter;
        match *self {
            // The tolerance covers only the rounding of the scaling.
            Self::ThinPlate { radius } if radius < required * (1.0 - 1e-9) => {
                Err(MapError::RadiusTooSmall {
                    required,
                    found: radius,
                })
            }
            _ => Ok(()),
        }
    }

    /// Correlation matrix of scaled inputs, n x n.
    pub fn matrix(&self, inputs: &[[f64; 2]]) -> DMatrix<f64> {
        let n = inputs.len();
        let mut k = DMatrix::zeros(n, n);
        for i in 0..n {
            // Symmetric: each pair once.
            k[(i, i)] = self.at_zero();
            for j in 0..i {
                let value = self.at(distance(inputs[i], inputs[j]));
                k[(i, j)] = value;
                k[(j, i)] = value;
            }
        }
        k
    }
}
