//! AprilTags: detection, corners fitted to the pixels, poses of the bodies that carry them.

pub mod apriltag_ffi;
pub mod base_pose;
pub mod detection;
mod edges;
pub mod pose;
mod regions;
pub(crate) mod size;
