//! The camera model: a pinhole with a lens before it, axes x right, y down, z forward, pixel
//! centres at integers.
//!
//! ```text
//! n = (X/Z, Y/Z),   d = lens(n; c),   u = fx d_x + cx,  v = fy d_y + cy
//! ```
//! Source: OpenCV documentation, module calib3d, "Detailed Description"; the lens models cite
//! theirs.

mod brown_conrady;
mod kannala_brandt;
mod lens;

use brown_conrady::BrownConrady;
use kannala_brandt::KannalaBrandt;
pub use lens::{Coefficients, Lens, MAX_COEFFICIENTS};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

/// Parameters of a camera without its lens: fx, fy, cx, cy.
pub(crate) const PINHOLE_NAMES: [&str; 4] = ["fx", "fy", "cx", "cy"];

/// Most intrinsic parameters that a camera has.
pub(crate) const MAX_INTRINSICS: usize = PINHOLE_NAMES.len() + MAX_COEFFICIENTS;

/// A calibrated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Columns and rows, px.
    pub image_size_px: [usize; 2],
    /// Focal lengths, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub centre_px: [f64; 2],
    /// Model of the lens.
    pub lens: &'static dyn Lens,
    /// Its coefficients.
    pub distortion: Coefficients,
}

impl Camera {
    /// A camera by its parameters, in the order of [`Camera::parameters`]; coefficients of the lens
    /// that are not given are 0.
    pub fn new(image_size_px: [usize; 2], lens: &'static dyn Lens, p: &[f64]) -> Self {
        let mut distortion = [0.0; MAX_COEFFICIENTS];
        distortion[..p.len() - 4].copy_from_slice(&p[4..]);
        Self {
            image_size_px,
            focal_px: [p[0], p[1]],
            centre_px: [p[2], p[3]],
            lens,
            distortion,
        }
    }

    /// Number of intrinsic parameters: those of the pinhole and of the lens.
    pub fn intrinsics(&self) -> usize {
        PINHOLE_NAMES.len() + self.lens.coefficient_names().len()
    }

    /// Names of the intrinsic parameters, in the order of [`Camera::parameters`].
    pub(crate) fn parameter_names(&self) -> impl Iterator<Item = &'static str> {
        PINHOLE_NAMES
            .into_iter()
            .chain(self.lens.coefficient_names().iter().copied())
    }

    /// The parameters: fx, fy, cx, cy, coefficients of the lens.
    pub fn parameters(&self) -> Vec<f64> {
        let ([fx, fy], [cx, cy]) = (self.focal_px, self.centre_px);
        let coefficients = &self.distortion[..self.lens.coefficient_names().len()];
        [&[fx, fy, cx, cy][..], coefficients].concat()
    }

    /// The same camera with other parameters.
    pub fn with_parameters(&self, p: &[f64]) -> Self {
        Self::new(self.image_size_px, self.lens, p)
    }

    /// The 3x3 camera matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        let ([fx, fy], [cx, cy]) = (self.focal_px, self.centre_px);
        Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    }

    /// Distorted normalised coordinates of a direction with their derivative by it.
    pub(crate) fn distort(&self, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        self.lens.distort(&self.distortion, n)
    }

    /// Pixel of (distorted) normalised coordinates.
    pub fn pixel(&self, d: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(
            self.focal_px[0] * d.x + self.centre_px[0],
            self.focal_px[1] * d.y + self.centre_px[1],
        )
    }

    /// (Distorted) normalised coordinates of a pixel.
    fn normalised(&self, px: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(
            (px.x - self.centre_px[0]) / self.focal_px[0],
            (px.y - self.centre_px[1]) / self.focal_px[1],
        )
    }

    /// Pixel of a point in camera coordinates; none where the lens does not see it.
    pub fn project(&self, p: &Vector3<f64>) -> Option<Vector2<f64>> {
        Some(self.pixel(&self.lens.image(&self.distortion, p)?.0))
    }

    /// Pixel with its derivatives by the point and by the intrinsic parameters (columns beyond
    /// [`Camera::intrinsics`] are 0); none where the lens does not see it.
    pub fn project_with_jacobian(
        &self,
        p: &Vector3<f64>,
    ) -> Option<(
        Vector2<f64>,
        Matrix2x3<f64>,
        SMatrix<f64, 2, MAX_INTRINSICS>,
    )> {
        let [fx, fy] = self.focal_px;
        let (d, mut by_point) = self.lens.image(&self.distortion, p)?;
        by_point.row_mut(0).scale_mut(fx);
        by_point.row_mut(1).scale_mut(fy);
        let mut by_camera = SMatrix::<f64, 2, MAX_INTRINSICS>::zeros();
        by_camera[(0, 0)] = d.x;
        by_camera[(1, 1)] = d.y;
        by_camera[(0, 2)] = 1.0;
        by_camera[(1, 3)] = 1.0;
        for (k, by) in self
            .lens
            .by_coefficients(&self.distortion, p)
            .iter()
            .enumerate()
        {
            by_camera[(0, 4 + k)] = fx * by.x;
            by_camera[(1, 4 + k)] = fy * by.y;
        }
        Some((self.pixel(&d), by_point, by_camera))
    }

    /// A point on the ray of a pixel; none where the distortion folds over or the lens sees
    /// nothing.
    pub fn ray(&self, px: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.lens.ray(&self.distortion, &self.normalised(px))
    }

    /// Undistorted normalised coordinates of a pixel; none where the distortion folds over.
    pub fn undistort(&self, px: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.lens.undistort(&self.distortion, &self.normalised(px))
    }

    /// The pixel at which the same camera without distortion shows what this pixel shows: straight
    /// edges are straight there; none where the distortion folds over.
    pub(crate) fn undistorted_px(&self, p: &Vector2<f64>) -> Option<Vector2<f64>> {
        Some(self.pixel(&self.undistort(p)?))
    }

    /// The inverse of [`Camera::undistorted_px`].
    pub(crate) fn distorted_px(&self, p: &Vector2<f64>) -> Vector2<f64> {
        self.pixel(&self.distort(&self.normalised(p)).0)
    }
}

/// [`Camera::undistorted_px`]; the pixel itself where no camera is known or its distortion folds
/// over.
pub(crate) fn undistorted_px(camera: Option<&Camera>, p: &Vector2<f64>) -> Vector2<f64> {
    camera.and_then(|c| c.undistorted_px(p)).unwrap_or(*p)
}

/// [`Camera::distorted_px`]; the pixel itself where no camera is known.
pub(crate) fn distorted_px(camera: Option<&Camera>, p: &Vector2<f64>) -> Vector2<f64> {
    camera.map_or(*p, |c| c.distorted_px(p))
}

/// OpenCV's five coefficients (Brown-Conrady).
pub static OPENCV5: &dyn Lens = &BrownConrady;

/// OpenCV's fisheye (Kannala-Brandt).
pub static FISHEYE: &dyn Lens = &KannalaBrandt;

/// All models.
pub fn lenses() -> [&'static dyn Lens; 2] {
    [OPENCV5, FISHEYE]
}

/// The model for which `name` is true of its name; an error that lists the names where there is
/// none.
///
/// # Errors
/// A sentence with the names that are known.
pub fn lens_named(
    found: &str,
    name: impl Fn(&'static dyn Lens) -> &'static str,
) -> Result<&'static dyn Lens, String> {
    let known = lenses();
    known
        .into_iter()
        .find(|lens| name(*lens) == found)
        .ok_or_else(|| {
            format!(
                "one of the lens models {} expected, \"{found}\" found",
                known.map(name).join(", ")
            )
        })
}
