//! The camera model: pinhole with OpenCV's five distortion coefficients (Brown-Conrady), axes x right, y down, z forward, pixel centres
//! at integers.
//!
//! ```text
//! (x, y) = (X/Z, Y/Z),  r^2 = x^2 + y^2
//! x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
//! y_d = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
//! u = fx x_d + cx,  v = fy y_d + cy
//! ```
//! Source: OpenCV documentation, module calib3d, "Detailed Description".

use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

/// Number of intrinsic parameters: fx, fy, cx, cy, k1, k2, p1, p2, k3.
pub const INTRINSICS: usize = 9;

/// Names of the intrinsic parameters, in the order of [`Camera::parameters`].
pub const INTRINSIC_NAMES: [&str; INTRINSICS] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];

/// A calibrated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Columns and rows, px.
    pub image_size_px: [usize; 2],
    /// Focal lengths, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub centre_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

impl Camera {
    /// The parameters in the order of [`INTRINSIC_NAMES`].
    #[must_use]
    pub fn parameters(&self) -> [f64; INTRINSICS] {
        let ([fx, fy], [cx, cy], [k1, k2, p1, p2, k3]) = (self.focal_px, self.centre_px, self.distortion);
        [fx, fy, cx, cy, k1, k2, p1, p2, k3]
    }

    /// The same camera with other parameters.
    #[must_use]
    pub fn with_parameters(&self, p: &[f64]) -> Self {
        Self {
            image_size_px: self.image_size_px,
            focal_px: [p[0], p[1]],
            centre_px: [p[2], p[3]],
            distortion: [p[4], p[5], p[6], p[7], p[8]],
        }
    }

    /// The 3x3 camera matrix.
    #[must_use]
    pub fn matrix(&self) -> Matrix3<f64> {
        let ([fx, fy], [cx, cy]) = (self.focal_px, self.centre_px);
        Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    }

    /// Distorted normalised coordinates with their derivative by the undistorted ones.
    #[must_use]
    pub fn distort(&self, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        let d = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let j = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (d, j)
    }

    /// Pixel of a point in camera coordinates; none behind the camera.
    #[must_use]
    pub fn project(&self, p: &Vector3<f64>) -> Option<Vector2<f64>> {
        if p.z <= 0.0 {
            return None;
        }
        let (d, _) = self.distort(&Vector2::new(p.x / p.z, p.y / p.z));
        Some(Vector2::new(
            self.focal_px[0] * d.x + self.centre_px[0],
            self.focal_px[1] * d.y + self.centre_px[1],
        ))
    }

    /// Pixel with its derivatives by the point and by the intrinsic parameters; none behind the camera.
    #[must_use]
    pub fn project_with_jacobian(
        &self,
        p: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>, SMatrix<f64, 2, INTRINSICS>)> {
        if p.z <= 0.0 {
            return None;
        }
        let [fx, fy] = self.focal_px;
        let (iz, x, y) = (1.0 / p.z, p.x / p.z, p.y / p.z);
        let (d, jd) = self.distort(&Vector2::new(x, y));
        let px = Vector2::new(fx * d.x + self.centre_px[0], fy * d.y + self.centre_px[1]);
        let dn = Matrix2x3::new(iz, 0.0, -x * iz, 0.0, iz, -y * iz);
        let mut by_point = jd * dn;
        by_point.row_mut(0).scale_mut(fx);
        by_point.row_mut(1).scale_mut(fy);
        let r2 = x * x + y * y;
        let mut by_camera = SMatrix::<f64, 2, INTRINSICS>::zeros();
        by_camera[(0, 0)] = d.x;
        by_camera[(1, 1)] = d.y;
        by_camera[(0, 2)] = 1.0;
        by_camera[(1, 3)] = 1.0;
        for (col, value) in [(4, r2), (5, r2 * r2), (8, r2 * r2 * r2)] {
            by_camera[(0, col)] = fx * x * value;
            by_camera[(1, col)] = fy * y * value;
        }
        by_camera[(0, 6)] = fx * 2.0 * x * y;
        by_camera[(1, 6)] = fy * (r2 + 2.0 * y * y);
        by_camera[(0, 7)] = fx * (r2 + 2.0 * x * x);
        by_camera[(1, 7)] = fy * 2.0 * x * y;
        Some((px, by_point, by_camera))
    }

    /// Undistorted normalised coordinates of a pixel, by Newton's method; none where the distortion folds over.
    #[must_use]
    pub fn undistort(&self, px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let target = Vector2::new(
            (px.x - self.centre_px[0]) / self.focal_px[0],
            (px.y - self.centre_px[1]) / self.focal_px[1],
        );
        let mut n = target;
        for _ in 0..30 {
            let (d, j) = self.distort(&n);
            let step = j.lu().solve(&(target - d))?;
            n += step;
            if step.norm() < 1e-13 {
                return Some(n);
            }
        }
        ((self.distort(&n).0 - target).norm() < 1e-9).then_some(n)
    }
}

/// The pixel at which the same camera without distortion shows what this pixel shows: straight edges are straight there. The pixel
/// itself where no camera is known or its distortion folds over.
pub(crate) fn undistorted_px(camera: Option<&Camera>, p: &Vector2<f64>) -> Vector2<f64> {
    camera
        .and_then(|c| {
            let n = c.undistort(p)?;
            Some(Vector2::new(c.focal_px[0] * n.x + c.centre_px[0], c.focal_px[1] * n.y + c.centre_px[1]))
        })
        .unwrap_or(*p)
}

/// The inverse of [`undistorted_px`].
pub(crate) fn distorted_px(camera: Option<&Camera>, p: &Vector2<f64>) -> Vector2<f64> {
    camera.map_or(*p, |c| {
        let n = Vector2::new((p.x - c.centre_px[0]) / c.focal_px[0], (p.y - c.centre_px[1]) / c.focal_px[1]);
        let d = c.distort(&n).0;
        Vector2::new(c.focal_px[0] * d.x + c.centre_px[0], c.focal_px[1] * d.y + c.centre_px[1])
    })
}
