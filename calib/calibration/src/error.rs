//! Why a calibration cannot be read or applied.

use crate::trust_issue::TrustIssue;
use std::path::{Path, PathBuf};
use wcal_core::text::brief;
use wcal_session::{InputError, SessionError};

/// What went wrong, and where.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The file system said no.
    #[error("reading {}: {source}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// A calibration or a table of readings that cannot be used: what was expected and what was
    /// found.
    #[error("{place}: {detail}")]
    Content {
        /// File.
        place: String,
        /// What was expected and what was found.
        detail: String,
    },
    /// The content is not what was sealed.
    #[error("{0}")]
    Changed(TrustIssue),
    /// It is of another kind of session.
    #[error("expected one of a session of kind {expected:?}, found {found:?}")]
    OtherKind {
        /// Kind of the session.
        expected: String,
        /// Kind that the calibration is of.
        found: String,
    },
    /// It is of another unit.
    #[error("{0}")]
    OtherUnit(String),
    /// It cannot be written as code: what was expected and what was found.
    #[error("export: {0}; use wcal predict")]
    NotExported(String),
    /// A table that cannot be read.
    #[error(transparent)]
    Table(#[from] SessionError),
    /// The model inside is damaged, or of another version.
    #[error(transparent)]
    Map(#[from] wcal_gpr::MapError),
    /// The model inside is damaged, of another version, or cannot answer.
    #[error(transparent)]
    Model(#[from] wcal_verify::scalar::ModelError),
}

impl From<InputError> for CalibrationError {
    fn from(error: InputError) -> Self {
        Self::Table(error.into())
    }
}

impl CalibrationError {
    /// One of another kind of session than `expected`.
    pub(crate) fn other_kind(expected: &str, found: &str) -> Self {
        Self::OtherKind {
            expected: expected.to_owned(),
            found: found.to_owned(),
        }
    }

    /// It says that calibration and readings do not belong together.
    pub fn is_mismatch(&self) -> bool {
        matches!(self, Self::OtherKind { .. } | Self::OtherUnit(_))
    }

    /// An error of a file's content.
    pub(crate) fn content(place: &Path, detail: impl ToString) -> Self {
        Self::Content {
            place: place.display().to_string(),
            detail: brief(&detail.to_string()),
        }
    }
}
