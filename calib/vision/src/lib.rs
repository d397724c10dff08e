//! Stereo calibration, tags, wire centreline, 3D shape and groove contact.
//!
//! Conventions: pixel centres at integers; camera axes x right, y down, z forward; lengths in mm
//! (boards may use any unit); `right_from_left` takes left camera coordinates to right ones.
//!
//! Folders in the order of the work: [`calibrate`] (pictures of a board to two cameras), [`tags`]
//! (where base and rig stand), [`wire`] (the wire found and measured in each picture), [`shape`]
//! (one curve a pair, the groove's contact, what all pairs share).

pub mod calibrate;
pub mod camera;
pub mod error;
mod homography;
mod median;
pub mod pairs;
pub mod picture;
pub mod profile;
pub mod rig;
pub mod rigid;
pub mod shape;
pub mod stereo;
pub mod tags;
pub mod wire;
