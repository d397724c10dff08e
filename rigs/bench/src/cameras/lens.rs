//! A pinhole camera with lens distortion.
//!
//! With `x = X/Z`, `y = Y/Z`, `r^2 = x^2 + y^2` in the camera's frame (z ahead, y down):
//! `x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)`, `y'` alike with
//! `p1 (r^2 + 2 y^2) + 2 p2 x y`, and `u = fx x' + cx`, `v = fy y' + cy` (Brown, "Decentering
//! distortion of lenses", 1966; OpenCV's order k1 k2 p1 p2 k3).

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};

/// A camera and the ray of every pixel corner.
#[derive(Debug, Clone, PartialEq)]
pub struct Lens {
    /// Width and height, px.
    pub size_px: [usize; 2],
    /// Focal lengths, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub centre_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// Takes base coordinates (mm) to camera coordinates.
    pub camera_from_base: Isometry3<f64>,
    /// Undistorted x, y of the pixels' corners, row by row, one more than pixels each way.
    corners: Vec<Vector2<f64>>,
}

impl Lens {
    /// A camera; inverts its distortion for every pixel corner.
    pub fn new(
        size_px: [usize; 2],
        focal_px: [f64; 2],
        centre_px: [f64; 2],
        distortion: [f64; 5],
        camera_from_base: Isometry3<f64>,
    ) -> Self {
        let mut lens = Self {
            size_px,
            focal_px,
            centre_px,
            distortion,
            camera_from_base,
            corners: Vec::new(),
        };
        // Pixel centres are at integers: corners lie half a pixel before them.
        let corner =
            |row: usize, column: usize| lens.undistorted(column as f64 - 0.5, row as f64 - 0.5);
        lens.corners = (0..=size_px[1])
            .flat_map(|y| (0..=size_px[0]).map(move |x| (y, x)))
            .map(|(y, x)| corner(y, x))
            .collect();
        lens
    }

    /// The same camera moved by `by` in its own frame.
    pub fn moved(&self, by: &Isometry3<f64>) -> Self {
        Self {
            camera_from_base: by * self.camera_from_base,
            ..self.clone()
        }
    }

    fn distorted(&self, p: &Vector2<f64>) -> Vector2<f64> {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = p.norm_squared();
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        Vector2::new(
            p.x * radial + 2.0 * p1 * p.x * p.y + p2 * (r2 + 2.0 * p.x * p.x),
            p.y * radial + p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * p2 * p.x * p.y,
        )
    }

    /// Direction (x, y, with z = 1) in which pixel position (u, v) looks.
    pub fn undistorted(&self, u: f64, v: f64) -> Vector2<f64> {
        let want = Vector2::new(
            (u - self.centre_px[0]) / self.focal_px[0],
            (v - self.centre_px[1]) / self.focal_px[1],
        );
        // Contracts by the distortion's slope, below 0.05 in these lenses.
        let mut p = want;
        for _ in 0..30 {
            let off = want - self.distorted(&p);
            p += off;
            if off.norm_squared() < 1e-24 {
                break;
            }
        }
        p
    }

    /// Image (px) and depth (mm) of a base point; `None` behind the camera.
    pub fn project(&self, p: &Vector3<f64>) -> Option<(Vector2<f64>, f64)> {
        let c = self.camera_from_base * Point3::from(*p);
        if c.z <= 0.0 {
            return None;
        }
        let d = self.distorted(&Vector2::new(c.x / c.z, c.y / c.z));
        let at = |k: usize| self.focal_px[k] * d[k] + self.centre_px[k];
        Some((Vector2::new(at(0), at(1)), c.z))
    }

    /// Ray of a pixel's corner.
    pub(super) fn corner(&self, row: usize, column: usize) -> Vector2<f64> {
        self.corners[row * (self.size_px[0] + 1) + column]
    }

    /// Ray of a place inside a pixel, `right` and `down` in 0..1 from its upper left corner: linear
    /// between the corners, where the distortion's curvature over a pixel is below 1e-6 px.
    pub(super) fn inside(&self, row: usize, column: usize, right: f64, down: f64) -> Vector2<f64> {
        let at = |r: usize| {
            self.corner(row + r, column) * (1.0 - right) + self.corner(row + r, column + 1) * right
        };
        at(0) * (1.0 - down) + at(1) * down
    }
}

/// Pose of a camera at `place` (mm, base frame) that looks at `target`, its x axis as near to
/// `right` as can be.
pub(crate) fn look_at(
    place: &Vector3<f64>,
    target: &Vector3<f64>,
    right: &Vector3<f64>,
) -> Isometry3<f64> {
    // OpenCV's axes: z ahead, x right, y down.
    let z = (target - place).normalize();
    let x = (right - z * right.dot(&z)).normalize();
    let y = z.cross(&x);
    let base_from_camera = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    let turn = UnitQuaternion::from_rotation_matrix(&base_from_camera);
    Isometry3::from_parts((*place).into(), turn).inverse()
}
