//! The digital twin's world: objects, sweeps of the whisker over them, and the dataset that they make.
//!
//! Lengths in mm, forces in N, moments in N mm, in the frame of the whisker's base: x along the root's tangent, the pre-curved tip
//! toward -z. All that these modules make is SIMULATED.

pub mod against;
pub mod cable_engine;
pub mod columns;
pub mod compare;
pub mod convex;
pub mod dataset;
pub mod dynamics;
pub mod engine;
mod error;
mod grid;
pub mod groove;
pub mod labels;
pub mod mesh;
pub mod mjcf;
pub mod objects;
pub mod physics;
pub mod read;
pub mod recipe;
pub mod rod_engine;
pub mod shard;
pub mod sweep;

pub use cable_engine::CableEngine;
pub use dataset::{Dataset, Missing, Survey, SweepEngine, Total};
pub use engine::MujocoEngine;
pub use error::TwinError;
pub use mesh::Mesh;
pub use rod_engine::RodEngine;
pub use sweep::{Sample, Sweep, SweepPlan, Turn, Verdict};
