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
    /// The explanation to be accepted is none that the data leave open.
    #[error(
        "accepting {asked}: expected one of the explanations that the data do not reject ({survivors}), found another"
    )]
    NotASurvivor {
        /// What was asked for.
        asked: String,
        /// What is open.
        survivors: String,
    },
}
