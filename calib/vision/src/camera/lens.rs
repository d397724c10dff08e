//! What a lens does to the pinhole's picture: the trait of its models.
//!
//! A lens takes the direction `n = (X/Z, Y/Z)` of a point before the camera to distorted normalised
//! coordinates `d(n; c)`; the pixel is `(fx d_x + cx, fy d_y + cy)`. Directions at 90 degrees from
//! the axis and beyond have no such `n`: a model that sees them takes points and gives rays.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use std::fmt::Debug;

/// Most coefficients that a model has.
pub const MAX_COEFFICIENTS: usize = 5;

/// Coefficients in the order of [`Lens::coefficient_names`]; what a model does not have is 0.
pub type Coefficients = [f64; MAX_COEFFICIENTS];

/// A model of a lens. The models are constants, so that a camera refers to one and carries its
/// coefficients.
pub trait Lens: Debug + Sync {
    /// Name in `stereo.json` (`distortion.model`) and of `--lens`.
    fn model(&self) -> &'static str;
    /// Name in Kalibr's camchain (`distortion_model`).
    fn kalibr_model(&self) -> &'static str;
    /// Name in ROS's camera_info (`distortion_model`).
    fn ros_model(&self) -> &'static str;
    /// Names of the coefficients, as OpenCV names and orders them.
    fn coefficient_names(&self) -> &'static [&'static str];
    /// Distorted coordinates of a direction with their derivative by it.
    fn distort(&self, c: &Coefficients, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>);
    /// Derivative of a point's distorted coordinates by each coefficient.
    fn by_coefficients(
        &self,
        c: &Coefficients,
        p: &Vector3<f64>,
    ) -> [Vector2<f64>; MAX_COEFFICIENTS];
    /// Derivative of the distorted radius by the undistorted one at radius `r` (decentring left
    /// out): at 0 the picture folds over.
    fn radial_slope(&self, c: &Coefficients, r: f64) -> f64;
    /// Direction of distorted coordinates; none where the model folds over or the direction is not
    /// before the camera.
    fn undistort(&self, c: &Coefficients, d: &Vector2<f64>) -> Option<Vector2<f64>>;

    /// Distorted coordinates of a point with their derivative by it; none where the model does not
    /// see it.
    fn image(&self, c: &Coefficients, p: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        (p.z > 0.0).then(|| self.image_before(c, p))
    }

    /// The same of a point before the camera.
    fn image_before(&self, c: &Coefficients, p: &Vector3<f64>) -> (Vector2<f64>, Matrix2x3<f64>) {
        let (n, iz) = (p.xy() / p.z, 1.0 / p.z);
        let (d, by_n) = self.distort(c, &n);
        let by_point = Matrix2x3::new(iz, 0.0, -n.x * iz, 0.0, iz, -n.y * iz);
        (d, by_n * by_point)
    }

    /// A point on the ray of distorted coordinates; none where the model folds over or sees
    /// nothing.
    fn ray(&self, c: &Coefficients, d: &Vector2<f64>) -> Option<Vector3<f64>> {
        Some(self.undistort(c, d)?.push(1.0))
    }
}

impl PartialEq for dyn Lens {
    fn eq(&self, other: &Self) -> bool {
        self.model() == other.model()
    }
}
