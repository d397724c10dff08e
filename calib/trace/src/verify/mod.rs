//! `wcal verify`: one procedure, generic over the measurement model of a session, from the twin check to the unsealed holdout.

pub mod acceptance;
pub mod conclusion;
pub mod detect;
mod document;
pub mod error_summary;
pub mod held_out;
pub mod holdout_check;
pub mod identifiability;
pub mod judgement;
pub mod noise_report;
pub mod options;
pub mod procedure;
pub mod refutation;
pub(crate) mod sealed_in_fit;
pub mod session_model;
mod support;

pub use options::VerifyOptions;
pub use procedure::{Verification, verify};
pub use session_model::{HeldOut, SessionModel, SessionText};
