//! The whisker's measurement model: pose -> rod -> moment -> memory -> wavelength, and what the
//! procedure asks of it.

mod admission;
mod branch_cache;
mod check;
mod covariates;
pub mod effects;
pub mod floor;
pub mod groove_motion;
pub mod judgement;
mod kept;
mod measurement;
pub mod next;
mod noise;
pub mod path;
pub mod physical;
mod picture_observations;
pub mod pictures;
pub mod plan_check;
pub mod predictions;
mod readings_model;
pub mod rod_parameters;
pub mod rod_tables;
pub mod seatings;
pub mod sensitivity;
mod solve_cache;
mod stage_clock;
mod stage_motion;
pub mod stream;
pub mod system;
pub mod tables;
pub mod temperature;
pub mod twin_check;
pub mod verify;
mod whisker_effect;

pub use physical::PhysicalModel;

pub use pictures::Pictures;
pub use stream::PhysicalStream;
pub use system::{Moments, WhiskerSystem};
pub use verify::{Verified, WhiskerVerification, verify_whisker};
