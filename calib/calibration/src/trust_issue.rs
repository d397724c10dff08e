//! Reasons not to trust what comes out of a calibration.

use std::fmt;

/// One reason not to trust what comes out of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub enum TrustIssue {
    /// The content is not what was sealed: place, hash of the content, hash in the file.
    Changed {
        /// File.
        place: String,
        /// Hash of the content.
        content_sha256: String,
        /// Hash that the file states.
        stated_sha256: String,
    },
    /// Its time is over: `expires` of the file, RFC 3339.
    Expired(String),
    /// `verify` found it not good enough.
    FailedVerification,
    /// It was never verified.
    NeverVerified,
    /// The tracker was trained for another whisker: what differs.
    OtherWhisker(String),
    /// The session was taken with another whisker: what differs.
    OtherSession(String),
    /// The readings come at another pace than the tracker was trained with, s.
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

impl fmt::Display for TrustIssue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Changed {
                place,
                content_sha256,
                stated_sha256,
            } => write!(
                f,
                "{place}: field `content_sha256`: expected {content_sha256}, found {stated_sha256}: the file was changed"
            ),
            Self::Expired(at) => write!(f, "the calibration expired at {at}"),
            Self::FailedVerification => write!(f, "the calibration failed its verification"),
            Self::NeverVerified => write!(f, "the calibration was never verified"),
            Self::OtherWhisker(found) => {
                write!(
                    f,
                    "the model was trained for another whisker than the calibration's: {found}"
                )
            }
            Self::OtherSession(found) => {
                write!(
                    f,
                    "the session was taken with another whisker than the calibration's: {found}"
                )
            }
            Self::SampleRate {
                trained_s: [low, high],
                found_s,
            } => write!(
                f,
                "the network was trained with {low:.3} to {high:.3} s between readings, found {found_s:.3} s"
            ),
        }
    }
}
