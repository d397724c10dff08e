//! `stereo.json` (format `wcal-stereo/1`): written by `stereo-calibrate`, read by `stereo-shape`.

use crate::camera::{Camera, Lens, OPENCV5, PINHOLE_NAMES, lens_named};
use crate::error::VisionError;
use crate::rigid::pose_from_rows;
use crate::stereo::StereoCameras;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use wcal_core::covariance;
use wcal_core::document::from_json;
use wcal_core::ranges::{self, Range};

/// Format tag of `stereo.json`.
pub(crate) const STEREO_FORMAT: &str = "wcal-stereo/1";

/// Numbers that cameras may have, whichever program calibrated them; a picture has 16 px at least,
/// and a lens of 1 px focal length sees all. No parameter of a camera is less certain than by
/// 10,000 px, rad or mm.
const LARGEST_VARIANCE: f64 = 1e8;

const RANGES: &[Range] = &[
    Range::whole("image_size_px", 16.0, 65_536.0),
    Range::real("K", -1e6, 1e6),
    Range::real("coefficients", -1e5, 1e5),
    Range::real("right_from_left", -1e6, 1e6),
    Range::real("square_mm", 0.0, 1e5),
    Range::whole("board.columns", 0.0, 1000.0),
    Range::whole("board.rows", 0.0, 1000.0),
    Range::whole("held_out.corners", 0.0, 1e9),
    Range::whole("provenance.seed", 0.0, 1.9e19),
    Range::real("right_from_left_sd", 0.0, 1e9),
    Range::real("rms_px", 0.0, 1e9),
    Range::real("corner_noise_px", 0.0, 1e9),
    Range::real("per_view_rms_px", 0.0, 1e9),
    Range::real("warp_sd_mm", 0.0, 1e9),
    Range::real("projection_sd_px", 0.0, 1e9),
    Range::real("", -1e18, 1e18),
];

/// Lens distortion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DistortionDocument {
    /// Model of the lens: `opencv5` or `fisheye`.
    #[schemars(extend("enum" = ["opencv5", "fisheye"]))]
    pub model: String,
    /// `opencv5`: k1, k2, p1, p2, k3; `fisheye`: k1, k2, k3, k4.
    pub coefficients: Vec<f64>,
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CameraDocument {
    /// `left` or `right`.
    pub name: String,
    /// Camera matrix, px.
    #[serde(rename = "K")]
    pub k: [[f64; 3]; 3],
    /// Lens distortion.
    pub distortion: DistortionDocument,
    /// Standard deviation of fx, fy, cx, cy (px) and of the coefficients by their names.
    #[serde(default)]
    pub sd: BTreeMap<String, f64>,
}

/// A view that was left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RejectedView {
    /// Name of the left picture (or of the right where only that exists).
    pub view: String,
    /// In words.
    pub why: String,
}

/// Epipolar distances of corners in views that were left out of the solve, one pair at a time. The
/// distance of a corner is the mean of its distances to the two epipolar lines, in the undistorted
/// pictures.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct HeldOut {
    /// Mean, px.
    pub epipolar_mean_px: f64,
    /// 95 % quantile, px.
    pub epipolar_p95_px: f64,
    /// Corners counted.
    #[serde(default)]
    pub corners: usize,
}

/// The board.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct BoardDocument {
    /// `chessboard`, `charuco` or `aprilgrid`.
    #[schemars(extend("enum" = ["chessboard", "charuco", "aprilgrid"]))]
    pub pattern: String,
    /// Inner corners a row.
    pub columns: usize,
    /// Inner corners a column.
    pub rows: usize,
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Bulge along x and y, mm; 0 where the data did not ask for it.
    pub warp_mm: [f64; 2],
    /// Standard deviations of the bulge, mm.
    pub warp_sd_mm: [f64; 2],
}

/// Two calibrated cameras.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct StereoDocument {
    /// Format and version.
    #[schemars(extend("const" = STEREO_FORMAT))]
    pub format: String,
    /// Columns and rows, px.
    pub image_size_px: [usize; 2],
    /// Left, right.
    pub cameras: Vec<CameraDocument>,
    /// 4 x 4, mm: takes left coordinates to right ones.
    pub right_from_left: [[f64; 4]; 4],
    /// Standard deviations: rotation (rad, about the right camera's axes), translation (mm).
    #[serde(default)]
    pub right_from_left_sd: Vec<f64>,
    /// Per-corner RMS over both cameras, px.
    pub rms_px: f64,
    /// The corners' own noise: per-corner RMS about a smooth picture of a regular grid, whatever
    /// the board's sizes, px; absent where too few corners tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corner_noise_px: Option<f64>,
    /// Per-corner RMS of every view used, left and right, px.
    pub per_view_rms_px: Vec<[f64; 2]>,
    /// Names of the views used.
    #[serde(default)]
    pub views: Vec<String>,
    /// Views left out.
    pub rejected_views: Vec<RejectedView>,
    /// Epipolar distances of corners in pairs left out of the solve one at a time.
    pub held_out: HeldOut,
    /// The board.
    #[serde(default)]
    pub board: BoardDocument,
    /// Sd of where a ray appears over a 3x3 grid of the picture (rows from the top), left and
    /// right, px; null where the lens sees nothing.
    #[serde(default)]
    pub projection_sd_px: Vec<Vec<Option<f64>>>,
    /// Covariance of left intrinsics, right intrinsics, rotation, translation (24 x 24; 22 x 22 for
    /// `fisheye`), units as above.
    #[serde(default)]
    pub covariance: Vec<Vec<f64>>,
    /// Remarks that matter.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// What made it.
    #[serde(default)]
    pub provenance: wcal_core::Provenance,
}

impl StereoDocument {
    /// Checks the text of a file of this name.
    ///
    /// # Errors
    /// Where it is no such document, or not physical.
    pub fn parse(name: &str, text: &str) -> Result<Self, VisionError> {
        let document: Self = from_json(text, STEREO_FORMAT, &[RANGES])
            .map_err(|e| VisionError::content(name, "a stereo.json document", e.to_string()))?;
        document
            .stereo_cameras()
            .map_err(|why| VisionError::content(name, "physical cameras", why))?;
        Ok(document)
    }

    /// The cameras, or why they make no sense.
    ///
    /// # Errors
    /// A sentence.
    pub fn stereo_cameras(&self) -> Result<StereoCameras, String> {
        // Cameras of other programs come without a stereo.json.
        ranges::check_value(self, &[RANGES]).map_err(|e| e.to_string())?;
        let [left, right] = &self.cameras[..] else {
            return Err(format!("2 cameras expected, {} found", self.cameras.len()));
        };
        let camera = |c: &CameraDocument| -> Result<Camera, String> {
            let lens = lens_named(&c.distortion.model, Lens::model)
                .map_err(|why| format!("camera {}: distortion.model: {why}", c.name))?;
            let (given, count) = (&c.distortion.coefficients, lens.coefficient_names().len());
            // OpenCV's four coefficients are its five without k3.
            let without_k3 = lens == OPENCV5 && given.len() == 4;
            if given.len() != count && !without_k3 {
                return Err(format!(
                    "camera {}: distortion \"{}\" with {count} coefficients expected, {} found",
                    c.name,
                    lens.model(),
                    given.len()
                ));
            }
            let pinhole = [c.k[0][0], c.k[1][1], c.k[0][2], c.k[1][2]];
            let p = [&pinhole[..], given].concat();
            if p.iter().any(|v| !v.is_finite()) || !(p[0] >= 1.0 && p[1] >= 1.0) {
                return Err(format!(
                    "camera {}: K: focal lengths of 1 px or more expected, {} and {} found",
                    c.name, p[0], p[1]
                ));
            }
            Ok(Camera::new(self.image_size_px, lens, &p))
        };
        let mut stereo = StereoCameras {
            cameras: [camera(left)?, camera(right)?],
            right_from_left: pose_from_rows(&self.right_from_left)
                .ok_or("right_from_left: a rigid 4x4 transform expected")?,
            covariance: None,
        };
        let [left, right] = [0, 1].map(|k| stereo.cameras[k].lens);
        if left != right {
            return Err(format!(
                "lenses of one model expected, {} and {} found",
                left.model(),
                right.model()
            ));
        }
        // Cameras of other programs come without a covariance.
        if !self.covariance.is_empty() {
            let n = stereo.parameters();
            covariance::check(&self.covariance, n).map_err(|why| format!("covariance: {why}"))?;
            if let Some(k) = (0..n).find(|&k| self.covariance[k][k] > LARGEST_VARIANCE) {
                return Err(format!(
                    "covariance: variances of at most {LARGEST_VARIANCE:e} (px, rad or mm, squared) expected, {:e} found in row {}",
                    self.covariance[k][k],
                    k + 1
                ));
            }
            stereo.covariance = Some(DMatrix::from_fn(n, n, |i, j| self.covariance[i][j]));
        }
        let mut sds = self.cameras.iter().flat_map(|c| &c.sd);
        if let Some((name, sd)) = sds.find(|(_, sd)| !(**sd >= 0.0)) {
            return Err(format!("sd of {name}: 0 or more expected, {sd} found"));
        }
        Ok(stereo)
    }
}

/// A camera as a document.
pub(crate) fn camera_document(name: &str, camera: &Camera, sd: &[f64]) -> CameraDocument {
    CameraDocument {
        name: name.into(),
        k: camera.matrix().transpose().into(),
        distortion: DistortionDocument {
            model: camera.lens.model().into(),
            coefficients: camera.parameters().split_off(PINHOLE_NAMES.len()),
        },
        sd: camera
            .parameter_names()
            .zip(sd)
            .map(|(n, s)| (n.to_owned(), *s))
            .collect(),
    }
}
