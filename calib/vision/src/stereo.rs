//! Two calibrated cameras, ready to compute with.

use crate::camera::{Camera, PINHOLE_NAMES};
use crate::rigid::updated;
use nalgebra::{DMatrix, Isometry3, Vector6};

/// The cameras of a `stereo.json`.
#[derive(Debug, Clone)]
pub struct StereoCameras {
    /// Left and right, their lenses of one model.
    pub cameras: [Camera; 2],
    /// Takes left coordinates to right ones, mm.
    pub right_from_left: Isometry3<f64>,
    /// Covariance of the parameters (left, right, rotation about the right camera's axes,
    /// translation); none where the file states none.
    pub covariance: Option<DMatrix<f64>>,
}

impl StereoCameras {
    /// Number of calibrated parameters: both cameras' and the relative pose.
    pub fn parameters(&self) -> usize {
        2 * self.cameras[0].intrinsics() + 6
    }

    /// A pose in a camera's frame (0 left, 1 right) by that in the left one's.
    pub fn in_camera(&self, camera: usize, in_left: &Isometry3<f64>) -> Isometry3<f64> {
        match camera {
            0 => *in_left,
            _ => self.right_from_left * in_left,
        }
    }

    /// The cameras with one parameter moved.
    pub(crate) fn moved(&self, k: usize, by: f64) -> Self {
        let mut s = self.clone();
        // In the order of the covariance: left, right, relative pose.
        let n = s.cameras[0].intrinsics();
        if k < 2 * n {
            let mut p = s.cameras[k / n].parameters();
            p[k % n] += by;
            s.cameras[k / n] = s.cameras[k / n].with_parameters(&p);
        } else {
            let mut step = Vector6::zeros();
            step[k - 2 * n] = by;
            s.right_from_left = updated(&s.right_from_left, &step);
        }
        s
    }

    /// Step of each parameter for finite differences: small against its effect's curvature.
    pub(crate) fn difference_step(&self, k: usize) -> f64 {
        let n = self.cameras[0].intrinsics();
        match k {
            k if k < 2 * n && k % n < PINHOLE_NAMES.len() => 0.01,
            k if k < 2 * n => 1e-4,
            k if k < 2 * n + 3 => 1e-6,
            _ => 1e-3,
        }
    }
}
