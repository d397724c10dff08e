//! The commands of `wcal-lab`, one file each.

pub mod evaluate;
pub mod exam;
pub mod man;
pub mod simulate;
pub mod train;
