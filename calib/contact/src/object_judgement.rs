//! Whether moments, motion and an object whose place is known belong together, before any contact is located.

use crate::ContactError;
use crate::sweep_suspects::{Suspect, sentence, suspects};
use crate::sweep_witness::SweepWitness;
use schemars::JsonSchema;
use serde::Serialize;
use wcal_calibration::WhiskerCalibration;
use wcal_core::observation::WhiskerSpec;
use wcal_core::verify_document::SurfaceDistance;

/// What an object says of the readings that passed it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, JsonSchema)]
pub struct ObjectJudgement {
    /// Whether the object refutes calibration and motion; absent where it cannot judge.
    pub refuted: Option<bool>,
    /// Probability of gaps as unlikely where they are right within their uncertainty.
    pub p_value: Option<f64>,
    /// Readings that judge, and how near the contacts that they allow come to the surface.
    pub samples: usize,
    /// See `samples`.
    #[serde(flatten)]
    pub distance: Option<SurfaceDistance>,
    /// Moment of the free wire after the contact, where it is no longer the zero, N mm.
    pub zero_drift_nmm: Option<f64>,
    /// What would explain a refutation, one thing at a time, the likeliest first.
    pub suspects: Vec<Suspect>,
    /// Why the object cannot judge.
    pub cannot_judge: Option<String>,
}

impl ObjectJudgement {
    /// Of a calibration.
    ///
    /// # Errors
    /// Where the sweep's table cannot be read.
    pub fn new(
        witness: &SweepWitness,
        calibration: &dyn WhiskerCalibration,
        declared: &WhiskerSpec,
    ) -> Result<Self, ContactError> {
        let verdict = match witness.judge(calibration, declared) {
            Ok(verdict) => verdict,
            Err(why @ ContactError::Value { .. }) => {
                let suspects = suspects(witness, calibration, declared)?;
                return Ok(Self { suspects, cannot_judge: Some(why.to_string()), ..Self::default() });
            }
            Err(other) => return Err(other),
        };
        let refuted = verdict.refuted();
        let suspects = if refuted { suspects(witness, calibration, declared)? } else { Vec::new() };
        Ok(Self {
            refuted: Some(refuted),
            p_value: Some(verdict.p_value),
            samples: verdict.samples,
            distance: Some(verdict.distance),
            // Loaded where the free wire would be clear: not of the zero, where the motion is wrong.
            zero_drift_nmm: verdict.drift_nmm.filter(|_| !refuted),
            suspects,
            cannot_judge: None,
        })
    }

    /// Whether moments, motion and object belong together as far as the object shows; rows of others are flagged.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.refuted == Some(false)
    }

    /// What speaks against them, for people.
    #[must_use]
    pub fn messages(&self) -> Vec<String> {
        let mut all = Vec::new();
        if let (Some(true), Some(p), Some(d)) = (self.refuted, self.p_value, &self.distance) {
            all.push(format!(
                "moments, motion and object do not belong together (p = {p:.1e}; the contacts that the moments allow lie {:.2} mm from the \
                 surface in the median): {}; marked object-disagrees in status",
                d.distance_median_mm,
                sentence(&self.suspects)
            ));
        }
        if let Some(why) = &self.cannot_judge {
            let explained = self.suspects.iter().any(|s| s.explains);
            let explained = if explained { format!("; {}", sentence(&self.suspects)) } else { String::new() };
            all.push(format!(
                "the object cannot judge the sweep: {why}{explained}; marked object-disagrees in status"
            ));
        }
        if let Some(nmm) = self.zero_drift_nmm {
            all.push(format!(
                "the zero drifts: where the wire is clear of the object again its moment is off by {nmm:.3} N mm from the beginning"
            ));
        }
        all
    }
}
