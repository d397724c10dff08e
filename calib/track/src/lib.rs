//! Contact tracking: from transverse base moments to the point that the whisker touches.
//!
//! Base frame throughout: lengths in mm, moments in N mm, time in s.

pub mod bootstrap;
pub mod classes;
mod device;
mod error;
pub mod evaluate;
pub mod filter;
pub mod generate_sweeps;
pub mod inverse;
pub mod model_file;
pub mod network;
pub mod score;
pub mod sd_factors;
pub mod segments;
pub mod stream;
pub mod surface;
pub mod sweep_series;
mod tare;
pub mod tracker;
pub mod train;
pub mod train_model;
pub mod training_sweeps;
pub mod two_contacts;
pub mod untrained_motion;

pub use burn::tensor::Device;
pub use device::device;
pub use error::TrackError;
pub use inverse::{InverseGrid, InverseSolution, StaticInverse};
pub use sweep_series::{Contact, SweepSample, SweepSeries};
pub use tare::Tare;
pub use tracker::{Sample, Tracker, TrackerStream};
