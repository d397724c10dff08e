//! Rigid motions: local updates, conversions.

use nalgebra::{Isometry3, UnitQuaternion, Vector6};
pub use wcal_core::rigid::{pose_from_parts, pose_from_rows};

/// The pose after a local update: rotation `exp(w) R`, translation `t + d`, with `step` = (w, d).
pub fn updated(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    let shifted = pose.translation.vector + step.fixed_rows::<3>(3);
    Isometry3::from_parts(shifted.into(), rotation)
}

/// Rows of the 4x4 matrix, for JSON.
pub fn rows(pose: &Isometry3<f64>) -> [[f64; 4]; 4] {
    pose.to_homogeneous().transpose().into()
}
