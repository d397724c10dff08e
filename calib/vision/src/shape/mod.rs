//! The wire's shape in space: one curve through the pieces of both pictures of a pair, the
//! correction of the base that all pairs agree on, the groove's contact, and errors that all pairs
//! share.

pub mod curve;
pub mod curve_fit;
mod describe;
pub mod folder;
pub mod groove;
pub mod joint;
mod other_pose;
mod pair_errors;
pub mod pair_fit;
pub mod socp_start;
