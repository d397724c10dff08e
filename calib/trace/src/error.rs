//! Errors of the trace crate: what stops verification outright. "Not good enough" is a verdict, not an error.

use thiserror::Error;

/// What went wrong.
#[derive(Debug, Error)]
pub enum TraceError {
    /// The whisker's description cannot be used.
    #[error("building the whisker's model: {0}")]
    Rod(#[from] wcal_rod::RodError),
    /// The declared model has no solution at the session's poses.
    #[error(
        "following the wire along the session's trajectories: expected an equilibrium at every pose, found none on {0}"
    )]
    NoEquilibrium(String),
}
