//! Contacts of a whisker: readings and motion in, places with their regions out.
//!
//! ```text
//! source                          estimator                              sink
//! table_source, session_groove,   tracker (motion known, or none),       track_table, track_document
//! stream_source (scans)           network
//!               Reading  ->  WhiskerTrack { Estimator }  ->  TrackRow, WhiskerDocument, Outcome        one loop: track
//! ```
//!
//! Sources and sinks speak in the base frame of the session, estimators in that of the wire
//! ([`frame`]): lengths in mm, moments in N mm, time in s.

pub mod arc;
pub mod arc_posterior;
pub mod calibrated_wire;
mod contact_so_far;
mod error;
pub mod estimator;
pub mod frame;
pub mod groove_comparison;
pub mod known_groove;
pub mod known_motion;
pub mod mesh_score;
pub mod network;
pub mod reading;
pub mod regimes;
pub mod session_groove;
pub mod sliding;
pub mod stream_motion;
pub mod stream_source;
mod sweep_record;
pub mod sweep_witness;
pub mod table_source;
pub mod track;
pub mod track_document;
pub mod track_table;
pub mod tracker;
pub mod trust;
pub mod whisker_track;
mod whole_contact;
pub mod zero;

pub use error::TrackError;
