//! The residual loop: find the residual, trace it to an effect that the model lacks, add it, show the held-out error.

pub mod candidate;
pub mod effects;
pub mod engine;
mod error;
pub mod mechanics;
pub mod path;
mod points;
pub mod scalar;
pub mod tables;
pub mod temperature;
pub mod verify;
mod walked;
pub mod whisker;

pub use error::TraceError;
