//! `verify.json` (format `wcal-verify/2`, docs/src/formats.md).

mod errors;
mod findings;
mod noise;
mod witness;

use crate::data_sheet::DataSheet;
use crate::provenance::InputFile;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use errors::{
    CalibrationContact, CalibrationJudgement, ContactComparison, ContactUncertainty,
    EffectAblation, GrooveTracking, HeldOutError, HoldoutJudgement, HoldoutOutcome, TrackError,
    TrajectoryContact,
};
pub use findings::{
    Detectable, EffectParameter, NamedEffect, NextMeasurement, NextPose, TwinCheck, TwinFault,
    UnknownEffect,
};
pub use noise::{CorrelatedNoise, FlaggedReading, NoiseDocument, NoiseFloor, NoiseLaw, NoisePart};
pub use witness::WitnessTest;

/// Format tag of `verify.json`.
pub const VERIFY_FORMAT: &str = "wcal-verify/2";

/// What the residual loop concluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing beyond noise remains.
    Adequate,
    /// One class of effects explains what was left.
    Effect,
    /// Explanations of more than one class survive.
    Ambiguous,
    /// Something remains that nothing in the catalogue explains.
    UnknownEffect,
    /// The twin's labels were faulty; repaired, nothing else is found.
    TwinFault,
    /// The data cannot be used.
    #[default]
    Refused,
}

/// What the residual loop found in a session.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct VerifyDocument {
    /// Format and version.
    #[schemars(extend("const" = VERIFY_FORMAT))]
    pub format: String,
    /// Identifier of the session.
    pub session: String,
    /// The session, or one that it was joined with, is simulated.
    pub simulated: bool,
    /// `whisker`, `transducer` or `axis`.
    #[schemars(extend("enum" = ["whisker", "transducer", "axis"]))]
    pub kind: String,
    /// The one answer.
    pub verdict: Verdict,
    /// One plain sentence.
    pub reason: String,
    /// The check of an outside twin's labels.
    pub twin: TwinCheck,
    /// The effects of the best explanation.
    pub effects: Vec<NamedEffect>,
    /// Every surviving explanation, best first, the best included.
    pub alternatives: Vec<Vec<String>>,
    /// The residual where nothing of the catalogue explains it.
    pub unknown: Option<UnknownEffect>,
    /// What a new reading at a new pose can reach.
    pub noise_floor: NoiseFloor,
    /// The noise in parts, null where the design cannot tell.
    pub noise: Option<NoiseDocument>,
    /// Readings that no tails of the noise explain, left out of the fit.
    pub flagged: Vec<FlaggedReading>,
    /// Held-out error of the declared model.
    pub before: Option<HeldOutError>,
    /// Held-out error of the accepted model.
    pub after: Option<HeldOutError>,
    /// Held-out error of the accepted model without sealed readings far outside the noise; absent
    /// where there is none. Where it stands, the exit code is 3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub after_trimmed: Option<HeldOutError>,
    /// What the sealed readings say; it never changes the verdict. Where they contradict the
    /// accepted model, no calibration is written and the exit code is 4.
    pub holdout: HoldoutJudgement,
    /// Share of the stated 95 % intervals that hold the held-out value.
    #[schemars(range(min = 0, max = 1))]
    pub coverage95: Option<f64>,
    /// The measurement that would decide.
    pub next_measurement: Option<NextMeasurement>,
    /// Detectability of each effect: the smallest size that these data show.
    pub detectable: Vec<Detectable>,
    /// Seed.
    pub seed: u64,
    /// Files read.
    pub inputs: Vec<InputFile>,
    /// What limits the use of the result although nothing contradicts it; where one stands, the
    /// exit code is 3. Absent without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cautions: Vec<String>,
    /// Remarks: what was absent, what was marked and kept.
    pub notes: Vec<String>,
    /// What each accepted effect is worth; absent without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub leave_one_effect_out: Vec<EffectAblation>,
    /// What to write down of the instrument (transducer, axis); absent where no calibration is
    /// written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_sheet: Option<DataSheet>,
    /// How a given calibration does on readings that were not in its fit; absent without
    /// `--calibration`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationJudgement>,
    /// Contacts where their place is known (the groove), by the declared and by the accepted model;
    /// null where it is not, or no model is accepted.
    pub contact: Option<ContactComparison>,
    /// Where the tracker by known motion puts the groove through the accepted calibration
    /// (whisker); absent where it was not tracked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub groove_tracking: Option<GrooveTracking>,
    /// What further measurements of the instrument say: a sweep over a known object (`--sweep`) of
    /// each explanation, pictures of each, too; absent without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tests: Vec<WitnessTest>,
}

impl VerifyDocument {
    /// What readings of this kind of session are grouped by.
    pub fn group_name(&self) -> &'static str {
        match self.kind.as_str() {
            "whisker" => "trajectory",
            _ => "cycle",
        }
    }

    /// How the readings of an error were held out, in the words of the kind.
    pub fn split_name(&self, split: &str) -> String {
        match split {
            "holdout" => "sealed holdout".to_owned(),
            "loto" => format!("leave one {} out", self.group_name()),
            "loo" => "leave one out".to_owned(),
            other => other.to_owned(),
        }
    }

    /// The document of data that cannot be used; `inputs` are left to the caller.
    pub fn refused(
        session: impl Into<String>,
        kind: impl Into<String>,
        reason: impl Into<String>,
        seed: u64,
    ) -> Self {
        Self {
            format: VERIFY_FORMAT.to_owned(),
            session: session.into(),
            kind: kind.into(),
            reason: reason.into(),
            noise_floor: NoiseFloor {
                source: "none".into(),
                ..NoiseFloor::default()
            },
            seed,
            ..Self::default()
        }
    }
}
