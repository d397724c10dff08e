use std::path::PathBuf;
use wcal_core::files::FileError;
use wcal_core::text::brief;

/// Errors from a model to tracks.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// A wire that cannot be bent.
    #[error("whisker: {0}")]
    Rod(#[from] wcal_rod::RodError),
    /// A file cannot be read.
    #[error(transparent)]
    Unread(#[from] FileError),
    /// A file could not be read or written.
    #[error("{action} {}: {detail}", path.display())]
    File {
        /// What was tried.
        action: &'static str,
        /// Where.
        path: PathBuf,
        /// Why not.
        detail: String,
    },
    /// A value that cannot be used.
    #[error("{what}: expected {expected}, found {found}")]
    Value {
        /// Which.
        what: String,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
    },
}

impl NetworkError {
    /// For `map_err` on file operations.
    pub fn file<E: std::fmt::Display>(
        action: &'static str,
        path: &std::path::Path,
    ) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |e| Self::File {
            action,
            path,
            detail: brief(&e.to_string()),
        }
    }

    /// A value that cannot be used.
    pub fn value(
        what: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Value {
            what: what.into(),
            expected: brief(&expected.into()),
            found: brief(&found.into()),
        }
    }
}
