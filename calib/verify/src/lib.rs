//! The residual loop: find the residual, trace it to an effect that the model lacks, add it, show
//! the held-out error.
//!
//! `method` holds the statistics, `models` the two kinds of session, `verify` the procedure that
//! joins them; `effect` and `measurement_model` are the traits between them.

pub mod effect;
mod error;
pub mod levels;
pub mod measurement_model;
pub mod method;
mod models;
pub mod verify;

pub use effect::{Effect, EffectTerm};
pub use error::VerifyError;
pub use measurement_model::MeasurementModel;
pub use models::{change, scalar, whisker};
