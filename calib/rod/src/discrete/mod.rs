//! The wire as rigid links: energy and equilibrium against bodies, for sweeps over meshes.

mod block_tridiagonal;
mod centre_line;
pub mod contact;
mod inverse_statics;
pub mod rod;

pub use contact::{ClosestPoint, Contact, ContactState, FrictionStep, Surface};
pub use inverse_statics::PointLoad;
pub use rod::{Configuration, DiscreteRod};
