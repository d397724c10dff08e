//! The calibration artefact's envelope; what lies inside belongs to the crate that fitted it.

use crate::observation::{MomentAxes, RestShape, WhiskerSpec};
use crate::provenance::Provenance;
use crate::verify_document::CalibrationContact;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Format tag of `calibration.json`.
pub const CALIBRATION_FORMAT: &str = "wcal-calibration/1";

/// Whether the calibration was verified on data that it was not fitted to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum VerificationStatus {
    /// Never verified.
    Unverified,
    /// `verify` found it adequate, or accepted the effects that it carries.
    Verified,
    /// The same, on sealed readings that another decision had met before: its level was a part of
    /// that of a first look.
    Reverified,
    /// `verify` found it not good enough.
    Failed,
}

/// The frame of a calibration's session: how the wire lies in it, and along what its moments are
/// components.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationFrame {
    /// Stress-free centre line, root first, base frame.
    pub rest_shape: RestShape,
    /// Unit vectors of the moment components, base frame.
    #[schemars(with = "[[f64; 3]; 2]")]
    pub moment_axes: [Vector3<f64>; 2],
    /// +1: moment = r x F acting on the base; -1: its reaction.
    pub moment_sign: f64,
    /// Way of the base past an object at rest that a network takes for the one of its training:
    /// against the wire's bend. Base frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<[f64; 3]>")]
    pub sweep_direction: Option<Vector3<f64>>,
}

impl CalibrationFrame {
    /// The moments that the calibration gives.
    pub fn moments(&self) -> MomentAxes {
        MomentAxes {
            axes: self.moment_axes,
            sign: self.moment_sign,
        }
    }
}

/// What the errors of a calibration's moments are made of: standard deviations of the two moments,
/// N mm; none where they are not known.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationNoise {
    /// Noise of a single reading.
    pub reading_sd_nmm: Option<[f64; 2]>,
    /// Drift of the zero within a session.
    pub drift_sd_nmm: Option<[f64; 2]>,
    /// What the fitted law leaves of the calibration's own readings beyond their noise: an error
    /// that later readings share.
    pub misfit_sd_nmm: Option<[f64; 2]>,
}

/// What `predict` and `track` apply; `judged-calibration.json` is one that `verify --calibration`
/// found not to hold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationFile<M> {
    /// Format and version.
    #[schemars(extend("const" = CALIBRATION_FORMAT))]
    pub format: String,
    /// Identifier of the session.
    pub session: String,
    /// Whether it was verified on data that it was not fitted to.
    pub verification: VerificationStatus,
    /// Last moment of validity, RFC 3339; none: no expiry.
    pub expires: Option<String>,
    /// The model, distinguished by `kind`.
    pub model: M,
    /// What made it.
    pub provenance: Provenance,
    /// The wire that it was made with; absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub whisker: Option<WhiskerSpec>,
    /// Map U to contact U: what the uncertainty of this calibration and of its readings makes of a
    /// contact whose motion is known; absent where verify did not track the groove.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_uncertainty: Option<CalibrationContact>,
    /// Frame of the session: what turns the calibration's moments and a sweep's motion into the
    /// frame of the wire; absent: moments about y and z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<CalibrationFrame>,
    /// What the errors of the moments are made of: standard deviations, N mm; null: not known.
    /// Absent where there is no whisker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<CalibrationNoise>,
    /// SHA-256 over the compact JSON of the list `session`, `verification`, `expires`, `model`,
    /// `provenance`, and of a whisker `whisker`, `contact_uncertainty`, `frame`, `noise` with
    /// `null` for what is not there. Tampering changes it.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub content_sha256: String,
}

impl<M: Serialize> CalibrationFile<M> {
    /// Hash of everything but the format and the hash itself.
    ///
    /// # Errors
    /// Where the model cannot be written as JSON.
    pub fn compute_hash(&self) -> Result<String, serde_json::Error> {
        let (session, model, made) = (&self.session, &self.model, &self.provenance);
        let (judged, until, wire, noise) = (
            &self.verification,
            &self.expires,
            &self.whisker,
            &self.noise,
        );
        let (contact, frame) = (&self.contact_uncertainty, &self.frame);
        let body = match (wire, contact, frame, noise) {
            (None, None, None, None) => serde_json::to_vec(&(session, judged, until, model, made))?,
            _ => serde_json::to_vec(&(
                session, judged, until, model, made, wire, contact, frame, noise,
            ))?,
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
        let rest_shape = RestShape::StraightArc {
            straight_mm: 30.0,
            arc_radius_mm: 20.0,
            length_mm: 60.0,
        };
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
            frame: None,
            noise: None,
            content_sha256: String::new(),
        }
    }

    #[test]
    fn the_hash_covers_every_part_and_survives_being_written() {
        let row = ContactUncertainty {
            arclength_mm: 23.0,
            trajectories: 4,
            moment_nmm: 1.2,
            moment_u_nmm: 0.01,
            contact_u_by_map_mm: 0.02,
            contact_u_mm: 0.22,
        };
        let contact = |factor: f64, contact_u_mm: f64| CalibrationContact {
            coverage_factor: factor,
            method: "m".to_owned(),
            split: "fit".to_owned(),
            rows: vec![ContactUncertainty {
                contact_u_mm,
                ..row
            }],
        };
        let frame = |moment_sign: f64| CalibrationFrame {
            rest_shape: whisker().rest_shape,
            moment_axes: [Vector3::x(), Vector3::z()],
            moment_sign,
            sweep_direction: None,
        };
        let noise = CalibrationNoise {
            reading_sd_nmm: Some([0.01, 0.02]),
            ..CalibrationNoise::default()
        };
        let with = file(Some(whisker()));
        let of = |contact: CalibrationContact| CalibrationFile {
            contact_uncertainty: Some(contact),
            ..with.clone()
        };
        let framed = |sign: f64| CalibrationFile {
            frame: Some(frame(sign)),
            ..with.clone()
        };
        let all = [
            file(None),
            with.clone(),
            file(Some(WhiskerSpec {
                diameter_mm: 0.29,
                ..whisker()
            })),
            of(contact(2.0, 0.22)),
            of(contact(2.0, 0.21)),
            of(contact(1.0, 0.22)),
            framed(1.0),
            framed(-1.0),
            CalibrationFile {
                noise: Some(noise),
                ..framed(1.0)
            },
        ];
        let hashes: std::collections::BTreeSet<String> =
            all.iter().map(|f| f.compute_hash().unwrap()).collect();
        assert_eq!(hashes.len(), all.len());
        for file in all {
            let text = serde_json::to_string(&file).unwrap();
            let again: CalibrationFile<u8> = serde_json::from_str(&text).unwrap();
            assert_eq!(again.compute_hash().unwrap(), file.compute_hash().unwrap());
            assert_eq!(text.contains("\"whisker\""), file.whisker.is_some());
        }
    }

    #[test]
    fn whiskers_differ_by_what_bends_them() {
        let own = whisker();
        assert_eq!(
            own.difference(&WhiskerSpec {
                youngs_gpa: 75.5,
                density_kg_m3: Some(6450.0),
                ..whisker()
            }),
            None
        );
        let found = own
            .difference(&WhiskerSpec {
                youngs_gpa: 60.0,
                ..whisker()
            })
            .unwrap();
        assert_eq!(found, "youngs_gpa: 75 and 60");
        let bent = RestShape::StraightArc {
            straight_mm: 28.0,
            arc_radius_mm: 20.0,
            length_mm: 60.0,
        };
        assert!(
            own.difference(&WhiskerSpec {
                rest_shape: bent,
                ..whisker()
            })
            .unwrap()
            .contains("straight_mm")
        );
        let line = RestShape::Polyline(vec![nalgebra::Vector3::zeros(), nalgebra::Vector3::x()]);
        assert!(
            own.difference(&WhiskerSpec {
                rest_shape: line,
                ..whisker()
            })
            .unwrap()
            .contains("length_mm")
        );
        // The same wire as points; and one that leans by four degrees at its root.
        let points = RestShape::Polyline(own.rest_shape.points(0.5));
        assert_eq!(
            own.difference(&WhiskerSpec {
                rest_shape: points,
                ..whisker()
            }),
            None
        );
        let lean = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), 0.07);
        let leaning = own
            .rest_shape
            .points(0.5)
            .iter()
            .map(|p| lean * p)
            .collect();
        let found = own
            .difference(&WhiskerSpec {
                rest_shape: RestShape::Polyline(leaning),
                ..whisker()
            })
            .unwrap();
        assert!(
            found.contains("rest_shape") && found.contains("mm apart"),
            "{found}"
        );
    }
}
