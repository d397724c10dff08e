//! Contacts of a whisker: readings and motion in, places with their regions out.
//!
//! Base frame throughout: lengths in mm, moments in N mm, time in s.

pub mod arc;
pub mod contact_history;
mod error;
pub mod groove_table;
pub mod known_groove;
pub mod known_motion;
pub mod mesh_score;
pub mod motion_judge;
pub mod motion_row_tracker;
pub mod motion_table;
pub mod row_tracker;
pub mod session_groove;
pub mod sliding;
pub mod sliding_episodes;
pub mod stream_motion;
pub mod trust;

pub use error::ContactError;
