//! Reasons not to trust what comes out of a calibration.

/// One reason not to trust what comes out of a calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrustIssue {
    /// The content is not what was sealed: place, hash of the content, hash in the file.
    #[error(
        "{place}: field `content_sha256`: expected {content_sha256}, found {stated_sha256}: the file was changed"
    )]
    Changed {
        /// File.
        place: String,
        /// Hash of the content.
        content_sha256: String,
        /// Hash that the file states.
        stated_sha256: String,
    },
    /// Its time is over: `expires` of the file, RFC 3339.
    #[error("the calibration expired at {0}")]
    Expired(String),
    /// `verify` found it not good enough.
    #[error("the calibration failed its verification")]
    FailedVerification,
    /// It was never verified.
    #[error("the calibration was never verified")]
    NeverVerified,
    /// The tracker was trained for another whisker: what differs.
    #[error("the model was trained for another whisker than the calibration's: {0}")]
    OtherWhisker(String),
    /// The session was taken with another whisker: what differs.
    #[error("the session was taken with another whisker than the calibration's: {0}")]
    OtherSession(String),
    /// The readings come at another pace than the tracker was trained with, s.
    #[error("the network was trained with {:.3} to {:.3} s between readings, found {found_s:.3} s", .trained_s[0], .trained_s[1])]
    SampleRate {
        /// Least and largest time between readings in training.
        trained_s: [f64; 2],
        /// Time between the readings.
        found_s: f64,
    },
}

impl TrustIssue {
    /// Short code for the rows of a table.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Changed { .. } => "changed",
            Self::Expired(_) => "expired",
            Self::FailedVerification => "failed",
            Self::NeverVerified => "unverified",
            Self::OtherWhisker(_) | Self::OtherSession(_) => "other-whisker",
            Self::SampleRate { .. } => "sample-rate",
        }
    }
}
