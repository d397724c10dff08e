//! Tag poses from all pictures that show the tag, with covariance from the corners' noise.
//!
//! ```text
//! minimise  chi2 = sum e^T (C_k + s0^2 I)^-1 e,   e = corner_k - pi(T exp(x) p_k)      x = (rotation, translation) in the body
//! d pi / d x = (d pi / d X) R [-hat(p_k)  I],     information = sum J^T (C_k + s0^2 I)^-1 J
//! ```
//! Starting points: the pose of the square's homography (columns h1, h2, h1 x h2), and the one
//! whose normal is mirrored in the line of sight, which a single view of a small square hardly
//! distinguishes. Source: Schweighofer and Pinz, "Robust Pose Estimation from a Planar Target",
//! IEEE PAMI 28(12), 2006.

use crate::camera::Camera;
use crate::homography::plane_pose;
use crate::rigid::updated;
use crate::stereo::StereoCameras;
use crate::tags::apriltag_ffi::Tag;
use crate::tags::tag_corners;
use nalgebra::{
    DMatrix, Isometry3, Matrix2, Matrix2x3, Matrix2x6, Matrix6, Point3, U6, Vector3, Vector6,
};
use wcal_core::least_squares::{self, Damping, Ending, NormalEquations};

/// Floor of a corner's standard deviation, px: printing, flatness and the blur's shape, which the
/// pixels' scatter does not include.
const CORNER_FLOOR_PX: f64 = 0.01;

/// RMS of a tag's corners beyond which they have no pose that both cameras share, px: a corner is
/// good to hundredths, whole pixels are no noise.
pub(crate) const TAG_MISFIT_PX: f64 = 1.0;

/// The pose of a body that carries tags, in the left camera's frame.
#[derive(Debug, Clone)]
pub struct BodyPose {
    /// Pose.
    pub left_from_body: Isometry3<f64>,
    /// Information (inverse covariance) of a correction (rotation, translation) in the body's
    /// frame: `left_from_body * correction`.
    pub information: Matrix6<f64>,
    /// Weighted sum of squared corner residuals.
    pub chi2: f64,
}

/// One observation of a tag.
#[derive(Debug, Clone)]
pub struct TagObservation {
    /// 0 left, 1 right.
    pub camera: usize,
    /// The tag in the picture.
    pub tag: Tag,
    /// Side of the tag, mm.
    pub size_mm: f64,
    /// The tag's place on its body; the identity where the tag itself is the body.
    pub body_from_tag: Isometry3<f64>,
}

impl TagObservation {
    /// The corners in the body's frame, mm.
    fn object(&self) -> [Vector3<f64>; 4] {
        tag_corners(self.size_mm).map(|p| (self.body_from_tag * Point3::from(p)).coords)
    }
}

/// The pose that all observations agree on. Both planar solutions of every observation are starting
/// points; the joint cost decides.
pub(crate) fn body_pose(
    stereo: &StereoCameras,
    observations: &[TagObservation],
) -> Option<BodyPose> {
    let mut solved: Vec<BodyPose> = Vec::new();
    for s in observations {
        for pose in planar_solutions(&stereo.cameras[s.camera], s.size_mm, &s.tag) {
            let left_from_camera = stereo.in_camera(s.camera, &Isometry3::identity()).inverse();
            let start = left_from_camera * pose * s.body_from_tag.inverse();
            solved.extend(minimise(stereo, observations, start));
        }
    }
    solved.into_iter().min_by(|a, b| a.chi2.total_cmp(&b.chi2))
}

/// Refines a pose from a starting point; none where it does not lie in front of the cameras.
pub fn minimise(
    stereo: &StereoCameras,
    observations: &[TagObservation],
    start: Isometry3<f64>,
) -> Option<BodyPose> {
    let linearised = |pose: &Isometry3<f64>| linearise(stereo, observations, pose);
    let found = least_squares::minimise(
        (start, linearised(&start)?),
        &Damping::default(),
        linearised,
        |pose, _, step| pose * updated(&Isometry3::identity(), step),
        |_, [before, after]| before - after < 1e-9 * before.max(1e-9),
    );
    if found.ending == Ending::Singular {
        return None;
    }
    Some(BodyPose {
        left_from_body: found.place,
        information: found.at.matrix,
        chi2: found.at.cost,
    })
}

/// RMS distance of the corners from those of a pose, px.
pub fn residual_rms_px(
    stereo: &StereoCameras,
    observations: &[TagObservation],
    pose: &Isometry3<f64>,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for s in observations {
        let camera_from_body = stereo.in_camera(s.camera, pose);
        for (corner, p) in s.tag.corners_px.iter().zip(s.object()) {
            let px = stereo.cameras[s.camera].project(&(camera_from_body * Point3::from(p)).coords);
            sum += px.map_or(f64::INFINITY, |px| (px - corner).norm_squared());
            count += 1.0;
        }
    }
    f64::sqrt(sum / f64::max(count, 1.0))
}

/// Weighted squares, information and right-hand side of a correction in the body's frame.
pub fn linearise(
    stereo: &StereoCameras,
    observations: &[TagObservation],
    pose: &Isometry3<f64>,
) -> Option<NormalEquations<U6>> {
    let mut found = NormalEquations {
        cost: 0.0,
        matrix: Matrix6::zeros(),
        descent: Vector6::zeros(),
    };
    for s in observations {
        let camera_from_body = stereo.in_camera(s.camera, pose);
        let turn = camera_from_body.rotation.to_rotation_matrix();
        for (k, p) in s.object().iter().enumerate() {
            let x = camera_from_body * Point3::from(*p);
            let (predicted, by_point, _) =
                stereo.cameras[s.camera].project_with_jacobian(&x.coords)?;
            // Derivative of the pixel by a correction in the body's frame: [-[p]x I] beyond R.
            let by_body: Matrix2x3<f64> = by_point * turn.matrix();
            let mut j = Matrix2x6::zeros();
            j.fixed_columns_mut::<3>(0)
                .copy_from(&(-by_body * p.cross_matrix()));
            j.fixed_columns_mut::<3>(3).copy_from(&by_body);
            // The stated covariance holds the pixels' noise only.
            let floor = Matrix2::identity() * CORNER_FLOOR_PX.powi(2);
            let w = (s.tag.covariances_px2[k] + floor).try_inverse()?;
            let e = s.tag.corners_px[k] - predicted;
            found.cost += (e.transpose() * w * e)[0];
            found.matrix += j.transpose() * w * j;
            found.descent += j.transpose() * w * e;
        }
    }
    Some(found)
}

/// Derivative of the right-hand side of [`linearise`] by the cameras' parameters, 6 x parameters.
pub(crate) fn gradient_by_calibration(
    stereo: &StereoCameras,
    observations: &[TagObservation],
    pose: &Isometry3<f64>,
) -> DMatrix<f64> {
    let gradient = |s: &StereoCameras| {
        linearise(s, observations, pose).map_or_else(Vector6::zeros, |found| found.descent)
    };
    let now = gradient(stereo);
    let mut out = DMatrix::zeros(6, stereo.parameters());
    for k in 0..stereo.parameters() {
        // The tags' share of G: how the normal equations' right-hand side follows the cameras.
        let h = stereo.difference_step(k);
        out.set_column(k, &((gradient(&stereo.moved(k, h)) - now) / h));
    }
    out
}

/// The two poses that a single view of a square allows: from its homography, and that tilted the
/// other way about the line of sight.
fn planar_solutions(camera: &Camera, size_mm: f64, tag: &Tag) -> Vec<Isometry3<f64>> {
    let seen: Option<Vec<_>> = tag.corners_px.iter().map(|p| camera.undistort(p)).collect();
    let corners = tag_corners(size_mm).map(|p| p.xy());
    let Some(first) = seen.and_then(|seen| plane_pose(&corners, &seen)) else {
        return Vec::new();
    };
    // The second solution mirrors the tag's normal in the line of sight.
    let sight = first.translation.vector.normalize();
    let normal = first.rotation * Vector3::z();
    let mirrored = 2.0 * sight.dot(&normal) * sight - normal;
    let second = nalgebra::UnitQuaternion::rotation_between(&normal, &mirrored)
        .map(|turn| Isometry3::from_parts(first.translation, turn * first.rotation));
    std::iter::once(first)
        .chain(second)
        .filter(|p| p.translation.z > 0.0)
        .collect()
}
