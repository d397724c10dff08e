//! OpenCV's lens of five coefficients (Brown-Conrady), `opencv5`.
//!
//! ```text
//! r^2 = x^2 + y^2,  g = 1 + k1 r^2 + k2 r^4 + k3 r^6
//! x_d = x g + 2 p1 x y + p2 (r^2 + 2 x^2)
//! y_d = y g + p1 (r^2 + 2 y^2) + 2 p2 x y
//! ```
//! Sources: OpenCV documentation, module calib3d, "Detailed Description"; Brown, "Decentering
//! Distortion of Lenses", 1966.

use super::lens::{Coefficients, Lens, MAX_COEFFICIENTS};
use nalgebra::{Matrix2, Vector2, Vector3};

/// The model: k1, k2, p1, p2, k3.
#[derive(Debug)]
pub(crate) struct BrownConrady;

impl Lens for BrownConrady {
    fn model(&self) -> &'static str {
        "opencv5"
    }

    fn kalibr_model(&self) -> &'static str {
        "radtan"
    }

    fn ros_model(&self) -> &'static str {
        "plumb_bob"
    }

    fn coefficient_names(&self) -> &'static [&'static str] {
        &["k1", "k2", "p1", "p2", "k3"]
    }

    fn distort(&self, c: &Coefficients, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = *c;
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        // d g / d r^2.
        let slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        let d = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        // d x_d / d y and d y_d / d x are the same expression.
        let cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let j = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (d, j)
    }

    fn by_coefficients(
        &self,
        _: &Coefficients,
        p: &Vector3<f64>,
    ) -> [Vector2<f64>; MAX_COEFFICIENTS] {
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        [
            Vector2::new(x * r2, y * r2),
            Vector2::new(x * (r2 * r2), y * (r2 * r2)),
            Vector2::new(2.0 * x * y, r2 + 2.0 * y * y),
            Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y),
            Vector2::new(x * (r2 * r2 * r2), y * (r2 * r2 * r2)),
        ]
    }

    fn radial_slope(&self, c: &Coefficients, r: f64) -> f64 {
        let [k1, k2, _, _, k3] = *c;
        let r2 = r * r;
        // d (r g) / d r.
        1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3))
    }

    fn undistort(&self, c: &Coefficients, d: &Vector2<f64>) -> Option<Vector2<f64>> {
        // Newton's method from the distorted place: distortions are small against the field.
        let mut n = *d;
        for _ in 0..30 {
            let (there, j) = self.distort(c, &n);
            let step = j.lu().solve(&(d - there))?;
            n += step;
            if step.norm() < 1e-13 {
                return Some(n);
            }
        }
        ((self.distort(c, &n).0 - d).norm() < 1e-9).then_some(n)
    }
}
