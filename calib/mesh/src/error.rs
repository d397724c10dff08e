use wcal_core::files::FileError;

/// What went wrong with an object or a sweep plan.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A mesh that no sweep can use.
    #[error("object {object}: expected {expected}, found {found}")]
    Mesh {
        /// Its name.
        object: String,
        /// What a sweep needs.
        expected: &'static str,
        /// What is there.
        found: String,
    },
    /// A value that no sweep can have.
    #[error("{what}: expected {expected}, found {found}")]
    Value {
        /// Which.
        what: String,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// An engine other than the rod is missing, refuses or failed; the text names it.
    #[error("{0}")]
    Engine(String),
}

impl From<wcal_core::ranges::OutOfRange> for MeshError {
    fn from(e: wcal_core::ranges::OutOfRange) -> Self {
        Self::Value {
            what: e.key,
            expected: e.expected,
            found: e.found,
        }
    }
}
