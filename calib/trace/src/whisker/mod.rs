//! The whisker's measurement model: pose -> rod -> moment -> memory -> wavelength, and what the procedure asks of it.

pub mod between;
pub mod floor;
pub mod groove_motion;
pub mod judgement;
pub mod listings;
mod map_left_out;
mod measurement;
pub mod next;
mod noise;
pub mod physical;
pub mod plan_check;
pub mod predictions;
pub mod stream;
pub mod system;
pub mod twin_check;
pub mod verify;

pub use physical::PhysicalModel;
pub use stream::PhysicalStream;
pub use system::{Memory, Moments, WhiskerEffect, WhiskerSystem};
pub use verify::{Verified, WhiskerVerification, verify_whisker};
