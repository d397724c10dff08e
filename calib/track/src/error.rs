use std::path::{Path, PathBuf};
use wcal_calibration::CalibrationError;
use wcal_network::NetworkError;
use wcal_session::{InputError, SessionError};

/// Why contacts cannot be tracked.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// A network, a filter or a wire that cannot be used.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A calibration that cannot be used.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// A session that cannot be explained.
    #[error(transparent)]
    Verify(#[from] wcal_verify::VerifyError),
    /// A mesh that cannot be used.
    #[error(transparent)]
    Mesh(#[from] wcal_mesh::MeshError),
    /// A table that cannot be read.
    #[error(transparent)]
    Table(#[from] SessionError),
    /// A stream that cannot be used.
    #[error(transparent)]
    Stream(#[from] wcal_acquisition::AcquisitionError),
    /// In a file.
    #[error("{place}: {source}")]
    In {
        /// Which.
        place: String,
        /// What is wrong there.
        source: Box<Self>,
    },
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
        /// Which, and where.
        what: String,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
    },
}

impl From<InputError> for TrackError {
    fn from(error: InputError) -> Self {
        Self::Table(error.into())
    }
}

impl From<wcal_rod::RodError> for TrackError {
    fn from(error: wcal_rod::RodError) -> Self {
        Self::Network(error.into())
    }
}

impl TrackError {
    /// For `map_err` on file operations.
    pub fn file<E: std::fmt::Display>(action: &'static str, path: &Path) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |e| Self::File {
            action,
            path,
            detail: e.to_string(),
        }
    }

    /// For `map_err`: the file in which it happened.
    pub fn in_file<E: Into<Self>>(path: &Path) -> impl FnOnce(E) -> Self {
        let place = path.display().to_string();
        move |e| Self::In {
            place,
            source: Box::new(e.into()),
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
            expected: expected.into(),
            found: found.into(),
        }
    }
}
