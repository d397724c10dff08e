//! Acquisition: from rig, plan and devices to a recording, and from the recording to the tables of
//! a session.
//!
//! In the order of the work: [`rig`] and [`plan`] describe the bench and the measurement;
//! [`record`] opens the devices and begins the session; [`sweep`] carries out the steps while scans
//! and pictures are recorded ([`recorder`], [`message`]); [`replay`] reads a recording back;
//! [`reduce`] makes the tables of it. Live and replayed devices run the same code.

pub mod assign;
pub mod camera_pair;
mod camera_watch;
pub mod clock_watch;
pub mod clocks;
pub mod error;
mod lag;
pub mod limits;
mod make_safe;
pub mod message;
pub mod monitor;
pub mod pictures;
pub mod plan;
pub mod pose_pictures;
pub mod record;
pub mod recorder;
pub mod reduce;
mod reduction;
mod reference;
pub mod replay;
pub mod replay_interrogator;
pub mod rig;
pub mod run_file;
mod session_begin;
mod stage_track;
mod steps;
pub mod sweep;
mod tables;
pub mod whisker_reader;
mod windows;

pub use error::AcquisitionError;
