//! The simulated whisker's world: objects, sweeps over them by the quasi-static rod, and the dataset that they make.
//!
//! Lengths in mm, forces in N, moments in N mm, in the frame of the whisker's base: x along the root's tangent, the pre-curved tip
//! toward -z. All that these modules make is SIMULATED.
//!
//! In the order of the work: [`objects`] and [`mesh`], a [`Sweep`] drawn by its [`SweepPlan`] ([`sweep`], [`physics`]), run by the
//! [`rod_engine`], or by MuJoCo in a crate of its own.

mod error;
mod grid;
pub mod mesh;
pub mod objects;
mod outside;
pub mod physics;
pub mod rod_engine;
mod solids;
pub mod stl;
pub mod sweep;
mod test_objects;

pub use error::SimError;
pub use mesh::Mesh;
pub use rod_engine::RodEngine;
pub use sweep::{Sample, Sweep, SweepPlan, Turn, Verdict};
