use std::path::PathBuf;

/// What went wrong with an object or a sweep plan.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// A file could not be read or written.
    #[error("{action} {}: {cause}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// Where.
        path: PathBuf,
        /// Why not; part of the message, so no separate source.
        cause: std::io::Error,
    },
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

impl MeshError {
    /// For `map_err` on file operations.
    pub fn io(action: &'static str, path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Io {
            action,
            path,
            cause,
        }
    }
}
