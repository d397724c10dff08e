//! Contact tracking: from transverse base moments to the point that the whisker touches.
//!
//! Base frame throughout: lengths in mm, moments in N mm, time in s.

pub mod bayes;
pub mod bootstrap;
pub mod classes;
pub mod course;
mod device;
pub mod drawn;
mod error;
pub mod evaluate;
pub mod inverse;
pub mod known_motion;
pub mod live;
pub mod make;
pub mod model_file;
pub mod motion;
pub mod network;
pub mod score;
pub mod segments;
pub mod several;
pub mod spread;
pub mod stream;
pub mod surface;
mod tare;
pub mod train;

pub use burn::tensor::Device;
pub use course::{Contact, Course, Instant};
pub use device::device;
pub use error::TrackError;
pub use inverse::{Candidate, InverseGrid, StaticInverse};
pub use stream::{Sample, Stream, Tracker};
pub use tare::Tare;
