//! Wavelength-to-moment maps: two grating shifts (pm) in, two base moments (N mm) out.
//!
//! [`fit_map`] fits every candidate (affine, quadratic, thin plate, Matern 5/2), leaves out poses
//! and whole trajectories, chooses one and returns it as a [`MapArtefact`]; [`MapPredictor`]
//! evaluates that artefact one reading at a time.
//!
//! - Each moment is a separate process: trend + correlated part + noise, with hyperparameters by
//!   restricted likelihood.
//! - Intervals are Student t: the variance is estimated from the same readings. They are widened
//!   where left-out coverage contradicts 95 %; the factor is in the artefact.
//! - The choice goes by leave-one-trajectory-out, with everything refitted, and leans to the
//!   simpler map.
//! - Readings outside the grown hull of the training readings are refused by the callers
//!   ([`MapPrediction::is_valid`]).

mod artefact;
mod candidate;
mod choose;
mod document;
mod error;
mod evidence;
mod fit;
mod geometry;
mod identifiability;
mod kernel;
mod predictor;
mod process;
mod region;
pub mod released;
mod rest;
mod student;
mod training;
mod trend;

pub use artefact::{MapArtefact, OutputMap};
pub use candidate::MapKind;

pub use choose::choose;
pub use document::document;
pub use error::MapError;

pub use evidence::{choose_hyperparameters, log_evidence};

pub use fit::{FitOptions, MapFit, fit_map};
pub use identifiability::identify;

pub use kernel::Kernel;

pub use predictor::MapPredictor;
pub use process::{LeftOut, Process, ProcessModel};

pub use rest::test_rest;
pub use student::{binomial_bounds, half95};
pub use training::MapTraining;
pub use trend::Trend;
