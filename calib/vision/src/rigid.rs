//! Rigid motions: local updates, Jacobians of rotated points, conversions.

use nalgebra::{Isometry3, Matrix3, Matrix4, Translation3, UnitQuaternion, Vector3, Vector6};
pub use wcal_core::rigid::{pose_from_parts, pose_from_rows};

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

/// Rows of the 4x4 matrix, for JSON.
pub fn rows(pose: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let m: Matrix4<f64> = pose.to_homogeneous();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}
