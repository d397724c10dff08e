//! The residual loop for sessions with one value a reading: kinds "transducer" and "axis".

pub mod admission;
pub mod detect;
pub mod effects;
pub mod floor;
pub mod frame;
pub mod held_out;
pub mod model;
pub mod next;
mod notes;
pub mod parameters;
pub mod polynomial;
pub mod records;
pub mod steadiness;
pub mod system;
pub mod verdict;
pub mod verify;

pub use crate::engine::spread::{Spread, SpreadLaw, spread_test};
pub use frame::{Declared, Frame, ScalarData, ScalarRow, Scaling};
pub use model::{ModelError, ScalarModel, ScalarPrediction};
pub use polynomial::{LackOfFit, Polynomial};
pub use system::{ScalarEffect, ScalarSystem};
pub use verify::{ScalarError, ScalarOptions, ScalarVerification, verify_scalar};
