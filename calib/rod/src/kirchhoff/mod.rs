//! The continuous rod in the groove: integration, one equilibrium, its branch along a path, its stability.

pub mod broyden;
pub mod continuation;
mod equilibria;
pub mod integrate;
pub mod solve;
pub mod stability;
