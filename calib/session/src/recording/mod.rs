//! Recording a sweep and reducing it to points.
//!
//! `rig.toml` and a plan become [`plan::Step`]s; [`sweep::run`] carries them out on any stage and interrogator while
//! [`sweep::acquire`] reads the stream; [`reduce::reduce`] turns the recording into the tables of a session.

pub mod assign;
pub mod clocks;
pub mod error;
pub mod lag;
pub mod message;
pub mod monitor;
pub mod path_text;
pub mod plan;
pub mod recorder;
pub mod reduce;
pub mod replay;
pub mod rig;
pub mod run_file;
pub mod sensed;
mod steps;
pub mod sweep;
pub mod tables;
pub mod tracks;
pub mod windows;

pub use error::RecordingError;
