//! Quasi-static Kirchhoff rod: the fast twin and the oracle of wcal.
//!
//! An inextensible wire of arc length s with centre line r(s) and frame R(s) = (t, d1, d2), clamped
//! at the root, held at s_c by the point P of a V-groove with the force F:
//!
//! - kinematics: r' = R e1, R' = R [u]x, u the body curvature (torsion first);
//! - constitutive law: R^T m = D (u - u0), D = diag(GJ, EI, EI), softening past an onset curvature
//!   ([`Softening`]);
//! - balance: m(s) = (P - r(s)) x F for s < s_c, m = 0 beyond; with weight, its moment besides;
//! - clamp: r(0) = 0, R(0) = R_clamp, turned by compliance times root moment where the root gives
//!   way;
//! - contact: r(s_c) = P and t(s_c) . F = 0 (frictionless groove); the moment at the root is M = P
//!   x F.
//!
//! [`kirchhoff`] integrates these equations (fourth order) and solves for (F, s_c); [`discrete`] is
//! the wire as rigid links, and [`inverse_statics`] their equilibrium under a known force; [`fit`]
//! finds the rest shape u0 and the clamp from measured centre lines. Lengths in mm, forces in N,
//! moments in N mm, base frame.
//!
//! Source: S. S. Antman, "Nonlinear Problems of Elasticity" (2005), ch. VIII.

pub mod discrete;
pub mod dual;
mod error;
pub mod fit;
pub(crate) mod inverse_statics;
pub(crate) mod kirchhoff;
pub mod material;
pub mod se3;
pub mod shape;

pub use discrete::DiscreteRod;
pub use error::RodError;
pub use fit::{MeasuredShape, RestChoice, RestFit, RestModel, fit_rest};
pub use inverse_statics::PointLoad;
pub use kirchhoff::broyden::Anchor;

pub use kirchhoff::continuation::{Line, Outcome, Touch};
pub use kirchhoff::integrate;
pub use kirchhoff::solve::{
    Equilibrium, Failure, Guess, Rod, Tangential, WORKING_STEP_MM, interpolated_point,
};
pub use material::{Section, Softening};
pub use shape::Shape;
