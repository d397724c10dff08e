//! OpenCV's fisheye lens (Kannala-Brandt), `fisheye`: the radius in the picture is a polynomial of
//! the angle from the axis.
//!
//! ```text
//! r = |n|,  theta = atan r,  theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
//! d = (theta_d / r) n
//! d d / d n = (theta_d / r) I + s n n^T,   s = (theta_d' / (1 + r^2) - theta_d / r) / r^2
//! ```
//!
//! Of a point `(x, y, z)` the angle is `atan2(rho, z)`, rho^2 = x^2 + y^2, which has no pole at 90
//! degrees:
//!
//! ```text
//! d = theta_d u,  u = (x, y) / rho,   d d / d p = theta_d' u (d theta / d p)^T + (theta_d / rho) (I - u u^T) [I2 0]
//! d theta / d p = (z u, -rho) / (rho^2 + z^2)
//! ```
//! Sources: OpenCV documentation, module calib3d, "Fisheye camera model"; Kannala and Brandt, "A
//! Generic Camera Model and Calibration Method for Conventional, Wide-Angle, and Fish-Eye Lenses",
//! IEEE PAMI 28(8), 2006, eq. 6.

use super::lens::{Coefficients, Lens, MAX_COEFFICIENTS};
use nalgebra::{Matrix2, Matrix2x3, RowVector3, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::AddAssign;

/// The model: k1, k2, k3, k4.
#[derive(Debug)]
pub(crate) struct KannalaBrandt;

/// Radius below which the quotients are taken by their series: the fourth power of it is lost in
/// rounding.
const SMALL_RADIUS: f64 = 1e-4;

/// `theta_d` and its derivative by `theta`.
fn distorted_angle(c: &Coefficients, theta: f64) -> (f64, f64) {
    let [k1, k2, k3, k4, _] = *c;
    let t2 = theta * theta;
    let value = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
    let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
    (value, slope)
}

impl Lens for KannalaBrandt {
    fn model(&self) -> &'static str {
        "fisheye"
    }

    fn kalibr_model(&self) -> &'static str {
        "equidistant"
    }

    fn ros_model(&self) -> &'static str {
        "equidistant"
    }

    fn coefficient_names(&self) -> &'static [&'static str] {
        &["k1", "k2", "k3", "k4"]
    }

    fn distort(&self, c: &Coefficients, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let r2 = n.norm_squared();
        let r = r2.sqrt();
        if r < SMALL_RADIUS {
            // theta_d / r = 1 + (k1 - 1/3) r^2 + O(r^4).
            let q = c[0] - 1.0 / 3.0;
            return (
                n * (1.0 + q * r2),
                Matrix2::identity() * (1.0 + q * r2) + n * n.transpose() * (2.0 * q),
            );
        }
        let (value, slope) = distorted_angle(c, r.atan());
        let ratio = value / r;
        let s = (slope / (1.0 + r2) - ratio) / r2;
        (
            n * ratio,
            Matrix2::identity() * ratio + n * n.transpose() * s,
        )
    }

    fn by_coefficients(
        &self,
        _: &Coefficients,
        p: &Vector3<f64>,
    ) -> [Vector2<f64>; MAX_COEFFICIENTS] {
        let rho = p.xy().norm();
        let theta = rho.atan2(p.z);
        let along = if rho > 0.0 {
            p.xy() * (theta / rho)
        } else {
            Vector2::zeros()
        };
        let power = |k: i32| along * (theta * theta).powi(k);
        [power(1), power(2), power(3), power(4), Vector2::zeros()]
    }

    fn radial_slope(&self, c: &Coefficients, r: f64) -> f64 {
        // d theta / d r = 1 / (1 + r^2).
        distorted_angle(c, r.atan()).1 / (1.0 + r * r)
    }

    fn undistort(&self, c: &Coefficients, d: &Vector2<f64>) -> Option<Vector2<f64>> {
        let target = d.norm();
        if target < SMALL_RADIUS {
            // The inverse of the series above.
            return Some(d * (1.0 - (c[0] - 1.0 / 3.0) * target * target));
        }
        let theta = angle(c, target)?;
        // At 90 degrees from the axis the pinhole's radius tan theta is infinite.
        (theta < FRAC_PI_2 - 1e-9).then(|| d * (theta.tan() / target))
    }

    fn image(&self, c: &Coefficients, p: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let rho = p.xy().norm();
        if rho < SMALL_RADIUS * p.z {
            return Some(self.image_before(c, p));
        }
        // Straight behind the camera no direction is the right one.
        if !(rho > SMALL_RADIUS * p.z.abs()) {
            return None;
        }
        let (u, far) = (p.xy() / rho, p.norm_squared());
        let (value, slope) = distorted_angle(c, rho.atan2(p.z));
        let by_angle = RowVector3::new(p.z * u.x, p.z * u.y, -rho) / far;
        let across = (Matrix2::identity() - u * u.transpose()) * (value / rho);
        let mut by_point = u * by_angle * slope;
        by_point.fixed_view_mut::<2, 2>(0, 0).add_assign(&across);
        Some((u * value, by_point))
    }

    fn ray(&self, c: &Coefficients, d: &Vector2<f64>) -> Option<Vector3<f64>> {
        let target = d.norm();
        if target < SMALL_RADIUS {
            return Some(self.undistort(c, d)?.push(1.0));
        }
        let (sin, cos) = angle(c, target)?.sin_cos();
        Some((d * (sin / target)).push(cos))
    }
}

/// Angle from the axis at a distorted radius, by Newton's method; none where the model folds over
/// before it.
fn angle(c: &Coefficients, target: f64) -> Option<f64> {
    let mut theta = target.min(FRAC_PI_2);
    for _ in 0..50 {
        let (value, slope) = distorted_angle(c, theta);
        if !(slope > 0.0) {
            return None;
        }
        let next = (theta + (target - value) / slope).clamp(0.0, PI);
        let moved = (next - theta).abs();
        theta = next;
        if moved < 1e-15 {
            break;
        }
    }
    let settled = (distorted_angle(c, theta).0 - target).abs() < 1e-9;
    (settled && theta < PI).then_some(theta)
}
