//! Errors of the rod crate.

use thiserror::Error;

/// What went wrong.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RodError {
    /// The rest shape or the mesh cannot be used.
    #[error("building the wire's rest shape: expected {expected}, found {found}")]
    Shape {
        /// What was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// The rest geometry could not be fitted.
    #[error("fitting the rest geometry: {0}")]
    RestFit(String),
}
