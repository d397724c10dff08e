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
use crate::homography::homography;
use crate::rigid::{hat, pose_from_parts, updated};
use crate::stereo::StereoCameras;
use crate::tags::detection::Tag;
use crate::tags::tag_corners;
use nalgebra::{DMatrix, Isometry3, Matrix2x3, Matrix3, Matrix6, Point3, Vector3, Vector6};
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
    /// chi2 of the other planar solution minus that of this one; small values: the pose is
    /// ambiguous.
    pub margin: f64,
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
            let in_left = if s.camera == 0 {
                pose
            } else {
                stereo.right_from_left.inverse() * pose
            };
            solved.extend(minimise(
                stereo,
                observations,
                in_left * s.body_from_tag.inverse(),
            ));
        }
    }
    solved.sort_by(|a, b| a.chi2.total_cmp(&b.chi2));
    let best = solved.first()?.clone();
    let other = solved
        .iter()
        .find(|s| {
            s.left_from_body
                .rotation
                .angle_to(&best.left_from_body.rotation)
                > 0.01
        })
        .map_or(f64::INFINITY, |s| s.chi2 - best.chi2);
    Some(BodyPose {
        margin: other,
        ..best
    })
}

/// Refines a pose from a starting point; none where it does not lie in front of the cameras.
pub fn minimise(
    stereo: &StereoCameras,
    observations: &[TagObservation],
    start: Isometry3<f64>,
) -> Option<BodyPose> {
    let damping = Damping {
        start: 1e-4,
        shrink: 0.1,
        min: 1e-12,
        grow: 10.0,
        max: 1e8,
        max_steps: 60,
    };
    let linearised = |pose: &Isometry3<f64>| {
        let (cost, matrix, descent) = linearise(stereo, observations, pose)?;
        Some(NormalEquations {
            cost,
            matrix,
            descent,
        })
    };
    let found = least_squares::minimise(
        (start, linearised(&start)?),
        &damping,
        linearised,
        |pose, _, step| pose * updated(&Isometry3::identity(), step),
        |_, [before, after]| before - after < 1e-9 * before.max(1e-9),
    );
    if found.ending == Ending::Singular {
        return None;
    }
    let (
        pose,
        NormalEquations {
            cost: chi2,
            matrix: information,
            ..
        },
    ) = (found.place, found.at);
    Some(BodyPose {
        left_from_body: pose,
        information,
        chi2,
        margin: f64::INFINITY,
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
        let camera_from_body = if s.camera == 0 {
            *pose
        } else {
            stereo.right_from_left * pose
        };
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
) -> Option<(f64, Matrix6<f64>, Vector6<f64>)> {
    let (mut chi2, mut information, mut gradient) = (0.0, Matrix6::zeros(), Vector6::zeros());
    for s in observations {
        let camera_from_body = if s.camera == 0 {
            *pose
        } else {
            stereo.right_from_left * pose
        };
        let turn = camera_from_body.rotation.to_rotation_matrix();
        for (k, p) in s.object().iter().enumerate() {
            let x = camera_from_body * Point3::from(*p);
            let (predicted, by_point, _) =
                stereo.cameras[s.camera].project_with_jacobian(&x.coords)?;
            let by_body: Matrix2x3<f64> = by_point * turn.matrix();
            let mut j = nalgebra::Matrix2x6::zeros();
            j.fixed_view_mut::<2, 3>(0, 0)
                .copy_from(&(-by_body * hat(p)));
            j.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_body);
            let floor = nalgebra::Matrix2::identity() * CORNER_FLOOR_PX * CORNER_FLOOR_PX;
            let w = (s.tag.covariances_px2[k] + floor).try_inverse()?;
            let e = s.tag.corners_px[k] - predicted;
            chi2 += (e.transpose() * w * e)[0];
            information += j.transpose() * w * j;
            gradient += j.transpose() * w * e;
        }
    }
    Some((chi2, information, gradient))
}

/// Derivative of the right-hand side of [`linearise`] by the cameras' parameters, 6 x parameters.
pub(crate) fn gradient_by_calibration(
    stereo: &StereoCameras,
    observations: &[TagObservation],
    pose: &Isometry3<f64>,
) -> DMatrix<f64> {
    let gradient = |s: &StereoCameras| {
        linearise(s, observations, pose).map_or_else(Vector6::zeros, |found| found.2)
    };
    let now = gradient(stereo);
    let mut out = DMatrix::zeros(6, stereo.parameters());
    for k in 0..stereo.parameters() {
        let h = stereo.difference_step(k);
        out.set_column(k, &((gradient(&stereo.moved(k, h)) - now) / h));
    }
    out
}

/// The two poses that a single view of a square allows: from its homography, and that tilted the
/// other way about the line of sight.
fn planar_solutions(camera: &Camera, size_mm: f64, tag: &Tag) -> Vec<Isometry3<f64>> {
    let h = 0.5 * size_mm;
    let image: Option<Vec<_>> = tag.corners_px.iter().map(|p| camera.undistort(p)).collect();
    let Some(q) = image else { return Vec::new() };
    let Some(found) = homography(&tag_corners(2.0).map(|p| p.xy()), &q) else {
        return Vec::new();
    };
    let [c0, c1, c2] = [0, 1, 2].map(|k| found.column(k) / found[(2, 2)]);
    let scale = 2.0 / (c0.norm() + c1.norm());
    let rotation =
        Matrix3::from_columns(&[c0 * scale, c1 * scale, (c0 * scale).cross(&(c1 * scale))]);
    let first = pose_from_parts(&rotation, &(c2 * scale * h));
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
