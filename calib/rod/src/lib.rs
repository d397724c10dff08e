//! Quasi-static Kirchhoff rod held by a V-groove: the fast twin and the oracle of wcal.
//!
//! Inextensible wire, clamped at the root: r' = R e1, R' = R [u]x, m = R D (u - u0), m(s) = (P - r(s)) x F up to the contact at
//! s_c, free beyond. Lengths in mm, forces in N, moments in N mm, base frame.
//!
//! Source of the formulation: S. S. Antman, "Nonlinear Problems of Elasticity", ch. VIII; contact as in docs/src/method.md, Rod.

mod blocks;
pub mod chain;
pub mod dual;
mod equilibria;
mod error;
pub mod integrate;
pub mod material;
pub mod near;
pub mod path;
pub mod pressed;
pub mod pushed;
pub mod rest_fit;
pub mod shape;
pub mod solve;
pub mod stability;

pub use chain::{Chain, Links};
pub use error::RodError;
pub use material::{Section, Softening};
pub use near::Anchor;
pub use path::{Line, Outcome, Touch, Tracker};
pub use pressed::{Contact, Near, Pressed, Rubbing, Surface};
pub use pushed::Push;
pub use rest_fit::{MeasuredShape, RestChoice, RestFit, RestModel, fit_rest};
pub use shape::Shape;
pub use solve::{Equilibrium, Failure, Guess, Rod, Tangential, WORKING_STEP_MM};
pub use stability::{Hold, Loss, LossKind, StabilityScan};
