//! `wcal verify`: the stages in order, from the twin check to the unsealed holdout.

pub mod between;
pub mod detect;
pub mod floor;
pub mod heldout;
pub mod holdout_check;
pub mod listings;
mod map_left_out;
pub mod next;
pub mod noise_report;
pub mod physical;
pub mod predictions;
pub mod rival;
pub mod stream;
pub mod twin_check;
mod unseal;
pub mod verdict;
pub mod whisker;

pub use physical::PhysicalModel;
pub use stream::PhysicalStream;
pub use whisker::{VerifyOptions, WhiskerVerification, verify_whisker};
