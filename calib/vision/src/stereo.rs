//! Two calibrated cameras, ready to compute with.

use crate::camera::{Camera, INTRINSICS};
use crate::rigid::updated;
use nalgebra::{DMatrix, Isometry3, Vector6};

/// Parameters of the covariance: both cameras and the relative pose.
pub const STEREO_PARAMETERS: usize = 2 * INTRINSICS + 6;

/// The cameras of a `stereo.json`.
#[derive(Debug, Clone)]
pub struct StereoCameras {
    /// Left and right.
    pub cameras: [Camera; 2],
    /// Takes left coordinates to right ones, mm.
    pub right_from_left: Isometry3<f64>,
    /// Covariance of the 24 parameters (left, right, rotation, translation); none where the file states none.
    pub covariance: Option<DMatrix<f64>>,
}

impl StereoCameras {
    /// The cameras with one parameter moved.
    #[must_use]
    pub(crate) fn moved(&self, k: usize, by: f64) -> Self {
        let mut s = self.clone();
        if k < 2 * INTRINSICS {
            let mut p = s.cameras[k / INTRINSICS].parameters();
            p[k % INTRINSICS] += by;
            s.cameras[k / INTRINSICS] = s.cameras[k / INTRINSICS].with_parameters(&p);
        } else {
            let mut step = Vector6::zeros();
            step[k - 2 * INTRINSICS] = by;
            s.right_from_left = updated(&s.right_from_left, &step);
        }
        s
    }
}
