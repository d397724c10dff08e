//! The calibration artefact's envelope; what lies inside belongs to the crate that fitted it.

use crate::provenance::Provenance;
use serde::{Deserialize, Serialize};

/// Format tag of `calibration.json`.
pub const CALIBRATION_FORMAT: &str = "wcal-calibration/1";

/// Whether the calibration was verified on data that it was not fitted to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum VerificationStatus {
    /// Never verified.
    Unverified,
    /// `verify` found it adequate, or accepted the effects that it carries.
    Verified,
    /// `verify` found it not good enough.
    Failed,
}

/// `calibration.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFile<M> {
    /// Always [`CALIBRATION_FORMAT`].
    pub format: String,
    /// Session identifier.
    pub session: String,
    /// Result of verification.
    pub verification: VerificationStatus,
    /// Last moment of validity, RFC 3339; none: no expiry.
    pub expires: Option<String>,
    /// The fitted model.
    pub model: M,
    /// What made it.
    pub provenance: Provenance,
    /// SHA-256 over the compact JSON of `session`, `verification`, `expires`, `model` and `provenance`; tampering changes it.
    pub content_sha256: String,
}

impl<M: Serialize> CalibrationFile<M> {
    /// Hash of everything but the hash itself.
    ///
    /// # Errors
    /// Where the model cannot be written as JSON.
    pub fn compute_hash(&self) -> Result<String, serde_json::Error> {
        let body = serde_json::to_vec(&(
            &self.session,
            &self.verification,
            &self.expires,
            serde_json::to_value(&self.model)?,
            &self.provenance,
        ))?;
        Ok(crate::provenance::sha256_hex(&body))
    }
}
