//! Errors of the MuJoCo twin.

use wcal_mesh::MeshError;

/// What went wrong with the engine or what it was given.
#[derive(Debug, thiserror::Error)]
pub enum TwinError {
    /// An object, a plan, a value or a file.
    #[error(transparent)]
    Sim(#[from] MeshError),
    /// The MuJoCo engine is missing or refuses.
    #[error("MuJoCo engine: {0}")]
    Engine(String),
    /// The MuJoCo engine ended while it was asked.
    #[error("MuJoCo engine: {0}")]
    EngineDied(String),
}

impl TwinError {
    /// A value that cannot be.
    pub fn value(
        what: &'static str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Sim(MeshError::Value {
            what: what.to_owned(),
            expected: expected.into(),
            found: found.into(),
        })
    }
}
