//! Explicit basis functions of the mean.
//!
//! h(x) = (1, x1, x2, x1^2, x1 x2, x2^2), cut after 0, 1, 3 or 6 terms; mean h(x) . b with b
//! estimated (universal kriging: N. Cressie, "Statistics for Spatial Data", 1993, sec. 3.4).

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Largest number of basis functions.
pub(crate) const MAX_TERMS: usize = 6;

/// Mean of the process, with coefficients estimated together with it (universal kriging).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Trend {
    /// Zero mean.
    Zero,
    /// 1
    Constant,
    /// 1, x1, x2
    Affine,
    /// 1, x1, x2, x1^2, x1 x2, x2^2
    Quadratic,
}

impl Trend {
    /// Number of coefficients.
    pub fn terms(self) -> usize {
        match self {
            Self::Zero => 0,
            Self::Constant => 1,
            Self::Affine => 3,
            Self::Quadratic => 6,
        }
    }

    /// Name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Zero => "zero",
            Self::Constant => "constant",
            Self::Affine => "affine",
            Self::Quadratic => "quadratic",
        }
    }

    /// Basis functions at a scaled input; the first `terms()` entries count.
    #[inline]
    pub fn basis(self, z: [f64; 2]) -> [f64; MAX_TERMS] {
        [1.0, z[0], z[1], z[0] * z[0], z[0] * z[1], z[1] * z[1]]
    }

    /// Basis matrix, n x terms.
    pub fn matrix(self, inputs: &[[f64; 2]]) -> DMatrix<f64> {
        DMatrix::from_fn(inputs.len(), self.terms(), |i, j| self.basis(inputs[i])[j])
    }
}
