//! The errors of verify.json on readings that no fit saw, and what each accepted effect, a given
//! calibration or the tracker does to them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Held-out errors of one model. The root mean squares stand under their names:
/// `wavelength_rmse_pm` (wavelengths, pm) and `moment_rmse_nmm` (both moments pooled, N mm) of a
/// whisker. One with pictures has `contact_rmse_mm` (distance of the seen contact from the predicted
/// one, mm), too. A transducer has `response_rmse` (unit of the response). An axis has
/// `error_rmse_um` (position error, um).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct HeldOutError {
    /// `holdout`, `loto` or `loo`.
    #[schemars(extend("enum" = ["holdout", "loto", "loo"]))]
    pub split: String,
    /// Error by name: `wavelength_rmse_pm`, `moment_rmse_nmm`, `response_rmse`, `error_rmse_um`.
    #[serde(flatten)]
    pub rmse: BTreeMap<String, f64>,
    /// The two moments separately (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_rmse_nmm_each: Option<[f64; 2]>,
    /// 95 % intervals by the names of the errors: of the root mean square over further groups
    /// (cycles, trajectories, folds) like those that counted.
    pub interval95: BTreeMap<String, [f64; 2]>,
    /// What the model says of these very rows: root mean square of the standard deviations that
    /// noise and the uncertainty of what was fitted give their errors, by the names of the errors.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub expected: BTreeMap<String, f64>,
    /// Rows that counted.
    pub points: usize,
}

/// What is lost without one accepted effect, the others refitted.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct EffectAblation {
    /// Effect.
    pub id: String,
    /// Root mean square of what the fit leaves, over that with the effect.
    pub misfit_ratio: f64,
    /// Chance of that gain without the effect, adjusted for the whole catalogue.
    #[schemars(range(min = 0, max = 1))]
    pub p_value: f64,
    /// Error with it on open readings that are left out in turn, in the unit of the first error of
    /// `after`.
    pub left_out: Option<f64>,
    /// The same without it.
    pub left_out_without: Option<f64>,
}

/// What the sealed readings say of what was decided without them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum HoldoutOutcome {
    /// Nothing that counts was sealed.
    #[default]
    Absent,
    /// They agree with the accepted model, and contradict the declared one where effects were
    /// accepted.
    Confirmed,
    /// They do not contradict the accepted model, and do not tell it from the declared one.
    NotContradicted,
    /// They contradict the accepted model: it gives no calibration.
    Contradicted,
}

/// `holdout` of verify.json: one look at the sealed readings, after everything was decided. It
/// never changes the verdict.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct HoldoutJudgement {
    /// What they say.
    pub outcome: HoldoutOutcome,
    /// Chance of residuals as large where the accepted model is right (prediction F test); null
    /// where none was sealed, or the noise is not known.
    #[schemars(range(min = 0, max = 1))]
    pub p: Option<f64>,
    /// Number of different decisions that these files have met, this one included; 0 where nothing
    /// was sealed.
    pub look: usize,
    /// Level that this look may spend, a part of 0.0002 that gets smaller with each look.
    #[schemars(range(min = 0, max = 1))]
    pub level: Option<f64>,
    /// Hash of the decision: the same in `unsealed.json`.
    pub decision_sha256: Option<String>,
    /// In words.
    pub why: String,
}

/// How an existing calibration does on readings that were not in its fit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationJudgement {
    /// File.
    pub path: String,
    /// Hash of its content.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub content_sha256: String,
    /// Its errors.
    pub error: HeldOutError,
    /// Share of its stated 95 % intervals that hold their value.
    pub coverage95: f64,
    /// Error in stated standard deviations, root mean square.
    pub ratio: Option<f64>,
    /// Whether it holds.
    pub holds: bool,
    /// In words.
    pub why: String,
}

/// Error of contacts by one model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrackError {
    /// Distance in space from where the contact is known to be, root mean square, mm.
    pub rms_mm: f64,
    /// Its 95 % interval, mm (jackknife over trajectories, of the logarithm); null where fewer than
    /// two were compared.
    #[serde(default)]
    pub interval95: Option<[f64; 2]>,
}

/// Contact of a trajectory by both models.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrajectoryContact {
    /// Identifier of the trajectory.
    pub trajectory: u32,
    /// True arc length of first touch, mm.
    pub arclength_mm: f64,
    /// Error by the declared model, root mean square, mm.
    pub before_mm: f64,
    /// Error by the accepted model, mm.
    pub after_mm: f64,
}

/// Contacts in the groove, whose place is stated, tracked through the declared and through the
/// accepted model: every trajectory by the calibrations that were fitted without it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ContactComparison {
    /// Declared model.
    pub before: TrackError,
    /// Accepted model.
    pub after: TrackError,
    /// After less before, mm.
    #[serde(default)]
    pub difference_mm: f64,
    /// Its 95 % interval, mm (jackknife over trajectories): where it holds 0 there is no
    /// difference. Null where fewer than two were compared.
    #[serde(default)]
    pub difference_interval95: Option<[f64; 2]>,
    /// The error of the accepted model that is expected, mm: what the noise of these readings and
    /// the calibration's own uncertainty allow (Cramer-Rao bound).
    pub bound_mm: f64,
    /// Readings compared: loaded ones, settled and on the move, that both models locate.
    pub readings: usize,
    /// Loaded readings that one of them does not locate.
    #[serde(default)]
    pub not_located: usize,
    /// Those whose place lies in the accepted model's 95 % region.
    pub inside95: usize,
    /// How far from the stated place the accepted effects put the groove, root mean square, mm;
    /// after is the distance from there. 0 where they leave it where it is stated.
    #[serde(default)]
    pub groove_moved_mm: f64,
    /// The same by trajectory, whose readings share one error.
    pub trajectories: Vec<TrajectoryContact>,
    /// The same on sealed trajectories, through the calibrations of all the others; null where none
    /// was sealed.
    #[serde(default)]
    pub sealed: Option<Box<ContactComparison>>,
}

impl ContactComparison {
    /// Nothing tells the accepted model's error from the declared one's; false where there is no
    /// interval to say so.
    pub fn is_same(&self) -> bool {
        self.difference_interval95
            .is_some_and(|[low, high]| low <= 0.0 && high >= 0.0)
    }
}

/// The tracker on the groove: its place from the moments and the stage's way alone, compared with
/// where it is known to be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GrooveTracking {
    /// Error in space, root mean square, mm.
    pub rmse_mm: f64,
    /// Cramer-Rao bound of that error under the calibration's covariance and the noise, root mean
    /// square, mm.
    pub bound_mm: f64,
    /// Share of the readings whose groove lies in the stated 95 % region.
    pub coverage95: f64,
    /// Loaded readings that were compared.
    pub points: usize,
    /// Trajectories; the error is one and the same at all readings of a trajectory.
    pub trajectories: usize,
    /// Trajectories whose groove lies in the stated 95 % region at half of their readings and more:
    /// what may be counted.
    pub trajectories_held: usize,
    /// Trajectories on which moments and motion do not belong together.
    pub doubted: usize,
    /// `holdout`: readings that were sealed; `fit`: those that the calibration was fitted to.
    #[schemars(extend("enum" = ["holdout", "fit"]))]
    pub split: String,
    /// What the uncertainty of the map makes of a contact, by arc length.
    pub uncertainty: Vec<ContactUncertainty>,
}

/// Expanded uncertainties (twice the standard deviation) of a moment and of the contact that
/// follows from it, on the trajectories of one arc length: root mean squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ContactUncertainty {
    /// Arc length of first touch, whole mm.
    pub arclength_mm: f64,
    /// Trajectories.
    pub trajectories: usize,
    /// Moment at the deepest reading, N mm.
    pub moment_nmm: f64,
    /// Its expanded uncertainty (k = 2) by the calibration alone, N mm.
    pub moment_u_nmm: f64,
    /// Uncertainty of the contact by the calibration and by where the object passes the free wire,
    /// mm.
    pub contact_u_by_map_mm: f64,
    /// The same with the noise of the readings, mm.
    pub contact_u_mm: f64,
}

/// What a calibration makes of a contact whose motion is known: `contact_uncertainty` of
/// calibration.json.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationContact {
    /// k: expanded uncertainties are k standard deviations.
    pub coverage_factor: f64,
    /// How the uncertainties were computed.
    pub method: String,
    /// The readings whose trajectories and noise stand behind them: `holdout` (sealed) or `fit`.
    #[schemars(extend("enum" = ["holdout", "fit"]))]
    pub split: String,
    /// By arc length of first touch.
    pub rows: Vec<ContactUncertainty>,
}
