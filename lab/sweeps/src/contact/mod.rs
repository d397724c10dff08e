//! A wire against a body of any shape: quasi-static, any number of contacts, with Coulomb friction
//! where asked for.
//!
//! Unknown are the links' rotations phi and the contact forces f_i; E is the energy of [`rod`],
//! g_i(phi) the gap of a place on the centre line (signed distance of the body less the wire's
//! radius):
//!
//! min E(phi) subject to g_i(phi) >= 0, that is grad E = sum_i f_i grad g_i, f_i >= 0, g_i >= 0,
//! f_i g_i = 0 (Signorini's conditions).
//!
//! - [`candidates`]: places where the distance along the wire is smallest;
//! - [`newton`]: one step of sequential quadratic programming: gaps linear in phi, forces from the
//!   small dual problem;
//! - [`solve`]: the loop over steps, damping and plane constraints; [`penalty`]: the same
//!   equilibrium by a penalty on overlap;
//! - [`friction`]: Coulomb's law over one step of the body.
//!
//! The surface is seen through its signed distance only; how a contact slides enters the stiffness
//! (the minimum of the distance along the wire moves with the wire). Source: P. Wriggers,
//! "Computational Contact Mechanics" (2006), ch. 6.

mod block_tridiagonal;
mod candidates;
mod centre_line;
mod configuration;
mod friction;
mod newton;
mod penalty;
mod rod;
mod solve;
mod surface;

pub use configuration::Configuration;
pub use friction::FrictionStep;
pub use rod::ContactRod;
pub use surface::{Contact, ContactState, Surface};
