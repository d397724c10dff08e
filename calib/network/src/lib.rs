//! Contact tracking: from transverse base moments to the point that the whisker touches.
//!
//! Base frame throughout: lengths in mm, moments in N mm, time in s.

mod error;
pub mod filter;
pub mod inverse;
pub mod model_file;
pub mod network;
pub mod sd_factors;
pub mod segments;
pub mod stream;
pub mod tracker;

pub use error::NetworkError;
pub use inverse::{InverseGrid, InverseSolution, StaticInverse};
pub use tracker::{Sample, Tracker, TrackerStream};
