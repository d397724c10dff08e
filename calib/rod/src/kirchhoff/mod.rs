//! The continuous rod in the groove: integration, one equilibrium, its branch along a path.

pub(crate) mod broyden;
pub(crate) mod continuation;
pub mod integrate;
pub(crate) mod solve;
