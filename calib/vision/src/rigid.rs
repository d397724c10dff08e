//! Rigid motions: local updates, Jacobians of rotated points, conversions.

use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Cross-product matrix of a vector.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// The pose after a local update: rotation `exp(w) R`, translation `t + d`, with `step` = (w, d).
pub fn updated(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + Vector3::new(step[3], step[4], step[5])),
        rotation,
    )
}

/// A pose from a rotation matrix (made orthonormal) and a translation.
pub fn pose_from_parts(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Isometry3<f64> {
    // Singular values rather than an iteration: exact also for a half turn.
    let svd = rotation.svd(true, true);
    let r = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            let r = u * v_t;
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

/// Rows of the 4x4 matrix, for JSON.
pub fn rows(pose: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let m: Matrix4<f64> = pose.to_homogeneous();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
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
