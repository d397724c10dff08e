//! What speaks against using a calibration.

use crate::artefact::CalibrationModel;
use crate::error::CalibrationError;
use crate::trust_issue::TrustIssue;
use std::path::Path;
use wcal_core::{CalibrationFile, VerificationStatus};

/// What speaks against using the calibration at the time `now`.
///
/// # Errors
/// Where `expires` is no RFC 3339 time.
pub fn standing(
    file: &CalibrationFile<CalibrationModel>,
    now: jiff::Timestamp,
) -> Result<Vec<TrustIssue>, CalibrationError> {
    let mut issues = Vec::new();
    if let Some(expires) = &file.expires {
        let until: jiff::Timestamp = expires.parse().map_err(|e| {
            let detail = format!("field `expires`: expected an RFC 3339 time, found {expires:?}: {e}");
            CalibrationError::content(Path::new("calibration"), detail)
        })?;
        if now > until {
            issues.push(TrustIssue::Expired(expires.clone()));
        }
    }
    if file.verification == VerificationStatus::Failed {
        issues.push(TrustIssue::FailedVerification);
    }
    Ok(issues)
}
