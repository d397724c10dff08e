//! The continuous rod in the groove: integration, one equilibrium, its branch along a path.

pub mod broyden;
pub mod continuation;
pub mod integrate;
pub mod solve;
