//! The crate's error: what was attempted, what was expected and what was found.

use wcal_core::files::FileError;
use wcal_core::text::brief;

/// Errors of wcal-vision. A rejected view or pair is no error: it is listed with its reason in the
/// result.
#[derive(Debug, thiserror::Error)]
pub enum VisionError {
    /// A file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A file was read, but its content is not what it has to be.
    #[error("{path}: expected {expected}, found {found}")]
    Content {
        /// File or folder.
        path: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// A computation has no usable result.
    #[error("{action}: expected {expected}, found {found}")]
    Result {
        /// What was computed.
        action: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// OpenCV failed.
    #[error("OpenCV, {action}: {source}")]
    OpenCv {
        /// What was called.
        action: &'static str,
        /// Cause.
        source: opencv::Error,
    },
}

impl VisionError {
    /// Adds to what a computation has found.
    pub(crate) fn and(mut self, more: &str) -> Self {
        if let Self::Result { found, .. } = &mut self {
            found.push_str(more);
        }
        self
    }

    pub(crate) fn content(
        path: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Content {
            path: path.into(),
            expected: brief(&expected.into()),
            found: brief(&found.into()),
        }
    }

    pub(crate) fn result(
        action: &'static str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Result {
            action,
            expected: expected.into(),
            found: found.into(),
        }
    }
}

/// Adds the name of the OpenCV call to its error.
pub(crate) trait OpenCvContext<T> {
    /// Names the call.
    fn doing(self, action: &'static str) -> Result<T, VisionError>;
}

impl<T> OpenCvContext<T> for opencv::Result<T> {
    fn doing(self, action: &'static str) -> Result<T, VisionError> {
        self.map_err(|source| VisionError::OpenCv { action, source })
    }
}
