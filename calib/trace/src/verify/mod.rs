//! `wcal verify`: one procedure, generic over the measurement model of a session, from the twin check to the unsealed holdout.

pub mod acceptance;
pub mod conclusion;
pub mod copied_holdout;
pub mod detect;
mod document;
pub mod error_summary;
pub mod gp_baseline;
pub mod held_out;
pub mod holdout_check;
pub mod identifiability;
pub mod judgement;
pub mod noise_report;
pub mod options;
pub mod procedure;
pub mod refutation;
pub mod session_model;

pub use options::VerifyOptions;
pub use procedure::{Verification, verify};
pub use session_model::{HeldOut, SessionModel};
