//! Errors of `verify`: what stops verification outright. "Not good enough" is a verdict, not
//! an error.

use thiserror::Error;

/// What went wrong.
#[derive(Debug, Error)]
pub enum VerifyError {
    /// The whisker's description cannot be used.
    #[error("building the whisker's model: {0}")]
    Rod(#[from] wcal_rod::RodError),
    /// The declared model has no solution at the session's poses.
    #[error(
        "following the wire along the session's trajectories: expected an equilibrium at every pose, found none on {0}"
    )]
    NoEquilibrium(String),
    /// The declared model has no solution at the readings.
    #[error("fitting the declared model: expected a solution at every reading, found none")]
    NoSolution,
    /// Another measurement of the instrument cannot be used.
    #[error("{0}")]
    Witness(String),
    /// It cannot be written down that the holdout is opened.
    #[error(
        "opening the holdout: expected a record of it beside the session or the result, found {0}"
    )]
    NoLedger(String),
    /// The explanation to be accepted is none that the data leave open.
    #[error(
        "accepting {asked}: expected one of the explanations that the data do not reject ({survivors}), found another; without --accept the data decide"
    )]
    NotASurvivor {
        /// What was asked for.
        asked: String,
        /// What is open.
        survivors: String,
    },
}

impl VerifyError {
    /// Names the session whose wire has no equilibrium.
    pub(crate) fn of_session(self, session: &str) -> Self {
        if matches!(self, Self::NoSolution) {
            Self::NoEquilibrium(session.to_owned())
        } else {
            self
        }
    }
}
