//! Sweeps of the simulated whisker over objects: by the quasi-static rod, and by MuJoCo.
//!
//! Lengths in mm, forces in N, moments in N mm, in the frame of the whisker's base: x along the
//! root's tangent, the pre-curved tip toward -z. All that these modules make is SIMULATED.
//!
//! In the order of the work: [`objects`], a [`Sweep`] drawn by its [`SweepPlan`] ([`sweep`],
//! [`physics`]), run by the [`rod_engine`] (its contacts: [`contact`]) or by MuJoCo
//! ([`cable_engine`], [`convex`]), and the two compared ([`rod_comparison`]).

pub mod cable_engine;
pub mod contact;
pub mod convex;
pub mod objects;
pub mod physics;
pub mod rod_comparison;
pub mod rod_engine;
mod solids;
pub mod sweep;
mod test_objects;

pub use cable_engine::CableEngine;
pub use rod_engine::RodEngine;
pub use sweep::{Sample, Sweep, SweepPlan, Turn, Verdict};
