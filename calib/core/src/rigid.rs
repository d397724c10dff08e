//! Rigid motions as documents state them: the rows of a 4x4 matrix.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

/// A pose in a document, lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "[[f64; 4]; 4]")]
pub struct RigidPose(pub Isometry3<f64>);

impl TryFrom<[[f64; 4]; 4]> for RigidPose {
    type Error = String;

    fn try_from(rows: [[f64; 4]; 4]) -> Result<Self, String> {
        let found = || format!("expected a rigid 4x4 transform, found {rows:?}");
        pose_from_rows(&rows).map(Self).ok_or_else(found)
    }
}

/// A pose from a rotation matrix (made orthonormal) and a translation.
pub fn pose_from_parts(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Isometry3<f64> {
    // Singular values rather than an iteration: exact also for a half turn.
    let svd = rotation.svd(true, true);
    let r = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            let r = u * v_t;
            // The nearest orthogonal matrix may be a mirror: then the nearest rotation.
            if r.determinant() < 0.0 {
                u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0)) * v_t
            } else {
                r
            }
        }
        _ => Matrix3::identity(),
    };
    Isometry3::from_parts(
        Translation3::from(*translation),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r)),
    )
}

/// A pose from the rows of a 4x4 matrix; none where it is no rigid motion (to 1e-3).
pub fn pose_from_rows(m: &[[f64; 4]; 4]) -> Option<Isometry3<f64>> {
    let r = Matrix3::from_fn(|i, j| m[i][j]);
    let rigid = (r * r.transpose() - Matrix3::identity()).norm() < 1e-3
        && r.determinant() > 0.0
        && m[3] == [0.0, 0.0, 0.0, 1.0]
        && m.iter().flatten().all(|v| v.is_finite());
    rigid.then(|| pose_from_parts(&r, &Vector3::new(m[0][3], m[1][3], m[2][3])))
}
