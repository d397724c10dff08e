//! Stereo calibration, tags, wire centreline, 3D shape and groove contact.
//!
//! Conventions: pixel centres at integers; camera axes x right, y down, z forward; lengths in mm (boards may use any unit);
//! `right_from_left` takes left camera coordinates to right ones.

pub mod apriltag_ffi;
mod bar;
pub mod base_pose;
pub mod bundle;
pub mod calibrate;
pub mod calibrate_folders;
pub mod camera;
pub mod chain;
mod checks;
pub mod chessboard;
pub mod corner;
mod describe;
pub mod document;
pub mod drawing;
pub mod error;
pub mod exchange;
pub mod groove;
pub mod imports;
mod initial;
pub mod joint;
pub mod look;
pub mod markers;
pub mod overlay;

pub mod pair_fit;
pub mod pairs;
pub mod picture;
pub mod profile;
pub mod reference;
mod refinement;
pub mod ridge;
pub mod rig;
pub mod rigid;
pub mod rod;
pub mod scene;
mod search;
pub mod shape_fit;
pub mod shapes;
pub mod shapes_document;
mod shared_errors;
pub mod stages;
mod tag_edges;
pub mod tag_pose;
mod tag_regions;
pub mod tags;
pub mod tip;
pub mod trace;
pub mod wire;
pub use error::VisionError;
