//! Stereo calibration, tags, wire centreline, 3D shape and groove contact.
//!
//! Conventions: pixel centres at integers; camera axes x right, y down, z forward; lengths in mm (boards may use any unit);
//! `right_from_left` takes left camera coordinates to right ones.

pub mod apriltag_ffi;
pub mod base_pose;
pub mod bundle;
pub mod calibrate;
pub mod calibrate_folders;
pub mod camera;
mod checks;
pub mod chessboard;
pub mod corner;
mod describe;
pub mod document;
pub mod error;
pub mod exchange;
pub mod groove;
pub mod initial;
pub mod joint;
pub mod look;
pub mod markers;
pub mod overlay;
pub mod page;
pub mod pair_fit;
pub mod pairs;
pub mod picture;
pub mod profile;
mod refinement;
pub mod ridge;
pub mod rig;
pub mod rigid;
pub mod rod;
pub mod shape_fit;
pub mod shapes;
pub mod shapes_document;
mod shared_errors;
mod tag_edges;
pub mod tag_pose;
pub mod tags;
pub mod tip;
pub mod trace;
pub mod wire;
pub use error::VisionError;
