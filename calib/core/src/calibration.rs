//! The calibration artefact's envelope; what lies inside belongs to the crate that fitted it.

use crate::observation::WhiskerSpec;
use crate::provenance::Provenance;
use crate::verify_document::CalibrationContact;
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
    /// The wire that it was made with; absent in older files and where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub whisker: Option<WhiskerSpec>,
    /// Map U to contact U, where `verify` tracked the groove; absent in older files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact_uncertainty: Option<CalibrationContact>,
    /// SHA-256 over the compact JSON of `session`, `verification`, `expires`, `model`, `provenance` and, where they are there, `whisker` and
    /// `contact_uncertainty` (then with `null` for a whisker that is not); tampering changes it.
    pub content_sha256: String,
}

impl<M: Serialize> CalibrationFile<M> {
    /// Hash of everything but the hash itself.
    ///
    /// # Errors
    /// Where the model cannot be written as JSON.
    pub fn compute_hash(&self) -> Result<String, serde_json::Error> {
        let model = serde_json::to_value(&self.model)?;
        let old = (&self.session, &self.verification, &self.expires, model, &self.provenance);
        // Files from before the whisker, and from before the contact's uncertainty, keep their hash.
        let body = match (&self.whisker, &self.contact_uncertainty) {
            (None, None) => serde_json::to_vec(&old)?,
            (Some(whisker), None) => serde_json::to_vec(&(old.0, old.1, old.2, old.3, old.4, whisker))?,
            (whisker, Some(contact)) => {
                serde_json::to_vec(&(old.0, old.1, old.2, old.3, old.4, whisker, contact))?
            }
        };
        Ok(crate::provenance::sha256_hex(&body))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::RestShape;
    use crate::verify_document::ContactUncertainty;

    fn whisker() -> WhiskerSpec {
        let rest_shape = RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: 60.0 };
        WhiskerSpec {
            diameter_mm: 0.3,
            youngs_gpa: 75.0,
            shear_gpa: 28.2,
            density_kg_m3: None,
            rest_shape,
            gravity_direction: None,
        }
    }

    fn file(whisker: Option<WhiskerSpec>) -> CalibrationFile<u8> {
        CalibrationFile {
            format: CALIBRATION_FORMAT.to_owned(),
            session: "s".to_owned(),
            verification: VerificationStatus::Verified,
            expires: None,
            model: 7,
            provenance: Provenance::default(),
            whisker,
            contact_uncertainty: None,
            content_sha256: String::new(),
        }
    }

    #[test]
    fn the_hash_covers_the_whisker_and_that_of_older_files_stays() {
        let old = file(None);
        let body = serde_json::to_vec(&("s", "verified", None::<()>, 7, &old.provenance)).unwrap();
        assert_eq!(old.compute_hash().unwrap(), crate::provenance::sha256_hex(&body));
        assert!(!serde_json::to_string(&old).unwrap().contains("whisker"));
        let with = file(Some(whisker()));
        let thinner = file(Some(WhiskerSpec { diameter_mm: 0.29, ..whisker() }));
        let hashes = [&old, &with, &thinner].map(|f| f.compute_hash().unwrap());
        assert!(hashes[0] != hashes[1] && hashes[1] != hashes[2], "{hashes:?}");
        let again: CalibrationFile<u8> =
            serde_json::from_str(&serde_json::to_string(&with).unwrap()).unwrap();
        assert_eq!(again.compute_hash().unwrap(), hashes[1]);
    }

    #[test]
    fn the_hash_covers_the_uncertainty_of_the_contact_and_that_of_older_files_stays() {
        let row = ContactUncertainty {
            arclength_mm: 23.0,
            trajectories: 4,
            moment_nmm: 1.2,
            moment_u_nmm: 0.01,
            contact_u_by_map_mm: 0.02,
            contact_u_mm: 0.22,
        };
        let contact = CalibrationContact {
            coverage_factor: 2.0,
            method: "m".to_owned(),
            split: "fit".to_owned(),
            rows: vec![row],
        };
        let old = file(Some(whisker()));
        // What was hashed before the field was there.
        let body =
            serde_json::to_vec(&("s", "verified", None::<()>, 7, &old.provenance, &old.whisker)).unwrap();
        assert_eq!(old.compute_hash().unwrap(), crate::provenance::sha256_hex(&body));
        assert!(!serde_json::to_string(&old).unwrap().contains("contact_uncertainty"));
        let with = |contact: &CalibrationContact| CalibrationFile {
            contact_uncertainty: Some(contact.clone()),
            ..old.clone()
        };
        let hash = with(&contact).compute_hash().unwrap();
        let smaller = CalibrationContact {
            rows: vec![ContactUncertainty { contact_u_mm: 0.21, ..row }],
            ..contact.clone()
        };
        let other_factor = CalibrationContact { coverage_factor: 1.0, ..contact.clone() };
        for changed in [&smaller, &other_factor] {
            assert_ne!(with(changed).compute_hash().unwrap(), hash);
        }
        assert_ne!(hash, old.compute_hash().unwrap());
        let text = serde_json::to_string(&with(&contact)).unwrap();
        let again: CalibrationFile<u8> = serde_json::from_str(&text).unwrap();
        assert_eq!(again.compute_hash().unwrap(), hash);
    }

    #[test]
    fn whiskers_differ_by_what_bends_them() {
        let own = whisker();
        assert_eq!(
            own.difference(&WhiskerSpec { youngs_gpa: 75.5, density_kg_m3: Some(6450.0), ..whisker() }),
            None
        );
        let found = own.difference(&WhiskerSpec { youngs_gpa: 60.0, ..whisker() }).unwrap();
        assert_eq!(found, "youngs_gpa: 75 and 60");
        let bent = RestShape::StraightArc { straight_mm: 28.0, arc_radius_mm: 20.0, length_mm: 60.0 };
        assert!(
            own.difference(&WhiskerSpec { rest_shape: bent, ..whisker() }).unwrap().contains("straight_mm")
        );
        let line = RestShape::Polyline(vec![nalgebra::Vector3::zeros(), nalgebra::Vector3::x()]);
        assert!(own.difference(&WhiskerSpec { rest_shape: line, ..whisker() }).is_some());
    }
}
