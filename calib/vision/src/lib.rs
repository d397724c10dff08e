//! Stereo calibration, tags, wire centreline, 3D shape and groove contact.
//!
//! Conventions: pixel centres at integers; camera axes x right, y down, z forward; lengths in mm (boards may use any unit);
//! `right_from_left` takes left camera coordinates to right ones.

pub mod bundle;
pub mod calibrate;
pub mod camera;
mod checks;
pub mod chessboard;
pub mod corner;
pub mod document;
pub mod error;
pub mod initial;
pub mod pairs;
pub mod picture;
pub mod profile;
pub mod rigid;

pub use error::VisionError;
