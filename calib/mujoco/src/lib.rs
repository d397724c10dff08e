//! The whisker as a MuJoCo model: the MJCF writer, the client of the engine, and what is run
//! through it.
//!
//! MuJoCo is SI; lengths here are in mm, forces in N, moments in N mm, and are converted at the
//! border ([`engine`], [`mjcf`]). The frame is that of the whisker's base: x along the root's
//! tangent, the pre-curved tip toward -z. All that these modules make is SIMULATED.

pub mod compare;
pub mod dynamics;
pub mod engine;
mod error;
pub mod groove;
pub mod labels;
pub mod mjcf;

pub use engine::MujocoEngine;
pub use error::TwinError;
