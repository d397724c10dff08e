//! Errors of rigs, plans, recordings and their reduction.

use thiserror::Error;
use wcal_core::device::DeviceError;
use wcal_core::document::DocumentError;
use wcal_core::files::FileError;
use wcal_core::text::brief;

/// Errors of planning, recording or reducing.
#[derive(Debug, Error)]
pub enum AcquisitionError {
    /// A rig, plan or recording that cannot be used.
    #[error("{place}: expected {expected}, found {found}")]
    Input {
        /// File and field.
        place: String,
        /// What was needed.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The file system refused.
    #[error(transparent)]
    File(#[from] FileError),
    /// The recorder failed.
    #[error("recording: {0}")]
    Recorder(String),
    /// A device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl AcquisitionError {
    /// An input error.
    pub fn input(
        place: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Input {
            place: place.into(),
            expected: brief(&expected.into()),
            found: brief(&found.into()),
        }
    }

    /// The error of a document: a key by its name, anything else as the wrong kind of file.
    pub(crate) fn document(place: &str, expected: &str, error: DocumentError) -> Self {
        match error {
            DocumentError::Range(e) => {
                Self::input(format!("{place}: {}", e.key), e.expected, e.found)
            }
            DocumentError::Format(e) => Self::input(
                format!("{place}: format"),
                e.expected,
                e.found.replace('"', ""),
            ),
            other => Self::input(place, expected, other.to_string()),
        }
    }
}
