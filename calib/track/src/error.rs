use std::path::Path;
use wcal_calibration::CalibrationError;
use wcal_network::NetworkError;
use wcal_session::{InputError, SessionError};

/// Why contacts cannot be tracked.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// A value, a file or a network that cannot be used.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A wire that cannot be bent.
    #[error("whisker: {0}")]
    Rod(#[from] wcal_rod::RodError),
    /// A calibration that cannot be used.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// A session that cannot be explained.
    #[error(transparent)]
    Verify(#[from] wcal_verify::VerifyError),
    /// A mesh that cannot be used.
    #[error(transparent)]
    Mesh(#[from] wcal_mesh::MeshError),
    /// A number that its key cannot have.
    #[error(transparent)]
    Range(#[from] wcal_core::ranges::OutOfRange),
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
}

impl From<InputError> for TrackError {
    fn from(error: InputError) -> Self {
        Self::Table(error.into())
    }
}

impl TrackError {
    /// For `map_err` on file operations.
    pub fn file<E: std::fmt::Display>(action: &'static str, path: &Path) -> impl FnOnce(E) -> Self {
        let failed = NetworkError::file(action, path);
        move |e| Self::Network(failed(e))
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
        Self::Network(NetworkError::value(what, expected, found))
    }
}
