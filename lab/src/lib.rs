//! What making, training and scoring a contact tracker takes, beside the program `wcal` that uses
//! it. All data made here are SIMULATED.
//!
//! In the order of the work: a [`dataset`] of sweeps, read as labelled [`sweep_series`] (or drawn
//! on the spot, [`generate_sweeps`]); a [`network`] trained on them ([`train`]), with its spread
//! and its card ([`train_model`], [`model_file`]); and its [`evaluation`] beside baselines
//! ([`evaluate`], [`score`], [`bootstrap`]). [`commands`] are what a person types.

#[macro_use]
extern crate wcal;

pub mod bootstrap;
pub mod commands;
pub mod dataset;
mod error;
pub mod evaluate;
pub mod evaluation;
pub mod generate_sweeps;
pub mod model_file;
pub mod network;
mod resampling;
pub mod score;
pub mod sweep_series;
pub mod tare;
pub mod train;
pub mod train_model;
pub mod training_sweeps;

#[cfg(test)]
#[path = "../../tests/support/json_reference.rs"]
mod json_reference;
#[cfg(test)]
mod schemas_test;

pub use error::LabError;
pub use sweep_series::{Contact, SweepSample, SweepSeries};
