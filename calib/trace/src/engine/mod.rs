//! The engine shared by every kind of session: fit, screen, refit, compare. It knows systems and candidates, not whiskers.

pub mod atoms;
pub mod fit;
pub mod linear;
pub mod null;
