//! AprilTags: detection, corners fitted to the pixels, poses of the bodies that carry them.

pub mod apriltag_ffi;
pub mod base_pose;
pub mod detection;
mod edges;
pub mod pose;
mod regions;
pub(crate) mod size;

use nalgebra::Vector3;

/// Corners of a tag of side `size` in its own frame (x right, y down, z into the tag), in the order
/// of [`apriltag_ffi::Tag::corners_px`].
pub(crate) fn tag_corners(size: f64) -> [Vector3<f64>; 4] {
    let h = 0.5 * size;
    [(-h, h), (h, h), (h, -h), (-h, -h)].map(|(x, y)| Vector3::new(x, y, 0.0))
}
