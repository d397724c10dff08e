//! `verify.json` (format `wcal-verify/1`, docs/src/formats.md).

use crate::observation::PairLeftOut;
use crate::provenance::InputFile;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Format tag of `verify.json`.
pub const VERIFY_FORMAT: &str = "wcal-verify/1";

/// What the residual loop concluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing beyond noise is left.
    Adequate,
    /// One class of effects explains what was left.
    Effect,
    /// Explanations of more than one class survive.
    Ambiguous,
    /// Something is left that nothing in the catalogue explains.
    UnknownEffect,
    /// The twin's labels were faulty; repaired, nothing else is found.
    TwinFault,
    /// The data cannot be used.
    Refused,
}

/// A group of labels that the twin got wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TwinFault {
    /// Point numbers.
    pub points: Vec<i64>,
    /// `branch`, `contact-lost`, `discretisation`, `not-settled`, `unit`.
    pub kind: String,
    /// Plain sentence.
    pub detail: String,
}

/// Result of stage 0.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TwinCheck {
    /// Faults found.
    pub faults: Vec<TwinFault>,
}

/// A fitted parameter of an effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectParameter {
    /// Name, e.g. `friction_coefficient`.
    pub name: String,
    /// Estimate.
    pub value: f64,
    /// Unit, `1` where dimensionless.
    pub unit: String,
    /// 95 % interval.
    pub interval95: [f64; 2],
}

/// An effect that the data asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NamedEffect {
    /// Identifier of docs/src/formats.md.
    pub id: String,
    /// Effects that this data cannot tell apart from it, itself included.
    pub class: Vec<String>,
    /// p-value adjusted for the whole catalogue.
    pub p_value: f64,
    /// Fitted parameters.
    pub parameters: Vec<EffectParameter>,
    /// Plain sentence for the report.
    #[serde(default)]
    pub sentence: String,
}

/// What drives a residual that nothing explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnknownEffect {
    /// Covariate.
    pub driver: String,
    /// `linear`, `quadratic`, `sinusoid`, `step`, `exponential`, `sign`, `dead-zone`, `irregular`.
    pub shape: String,
    /// All covariates, strongest first.
    pub drivers_ranked: Vec<String>,
    /// Period in the covariate's unit, for a sinusoid.
    pub period: Option<f64>,
}

/// The noise floor and where it came from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct NoiseFloor {
    /// pm (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wavelength_pm: Option<f64>,
    /// N mm (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_nmm: Option<f64>,
    /// Response unit (kind transducer).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response: Option<f64>,
    /// um (kind axis).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_um: Option<f64>,
    /// Distance of a contact from where it is seen that the shapes' stated covariance gives, root mean square, mm (with pictures).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact_mm: Option<f64>,
    /// `replicates`, `difference`, `declared`, `none`.
    pub source: String,
}

/// A part of the noise: standard deviation (or degrees of freedom) with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NoisePart {
    /// Estimate.
    pub value: f64,
    /// 95 % interval.
    pub interval95: [f64; 2],
}

/// The part of the noise that is correlated in time (first-order Gauss-Markov process).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CorrelatedNoise {
    /// Standard deviation.
    pub sd: f64,
    /// Its 95 % interval.
    pub interval95: [f64; 2],
    /// Time constant, s; readings where the session has no clock.
    pub time_constant_s: f64,
}

/// How the spread of single readings follows a covariate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NoiseLaw {
    /// Covariate: `load`, `depth` or `stimulus`.
    pub follows: String,
    /// Standard deviation at the covariate's largest value over that at its smallest.
    pub ratio: f64,
    /// Its 95 % interval.
    pub interval95: [f64; 2],
}

/// The noise in parts; what the design cannot tell is absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct NoiseDocument {
    /// A loaded reading by itself, repeated without moving where pose scatter is known.
    pub repeat: Option<NoisePart>,
    /// What setting a pose adds.
    pub pose: Option<NoisePart>,
    /// Zero from session to session.
    pub session: Option<NoisePart>,
    /// Correlated in time.
    pub correlated: Option<CorrelatedNoise>,
    /// Rounding of the recorded values, part of the repeat noise.
    pub rounding: Option<NoisePart>,
    /// Degrees of freedom of Student's t; absent where a Gaussian does as well.
    pub tails_dof: Option<NoisePart>,
    /// Law of the spread; absent where it is the same everywhere.
    #[serde(default)]
    pub law: Option<NoiseLaw>,
    /// Unit of the standard deviations.
    pub unit: String,
}

/// A reading that was left out of the fit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlaggedReading {
    /// File.
    pub source: String,
    /// Point in that file.
    pub point: i64,
}

/// Held-out errors of one model.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct HeldOutError {
    /// `holdout`, `loto` or `loo`.
    pub split: String,
    /// Error by name: `wavelength_rmse_pm`, `moment_rmse_nmm`, `response_rmse`, `error_rmse_um`.
    #[serde(flatten)]
    pub rmse: BTreeMap<String, f64>,
    /// The two moments apart (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_rmse_nmm_each: Option<[f64; 2]>,
    /// 95 % intervals by the same names.
    pub interval95: BTreeMap<String, [f64; 2]>,
    /// Rows that counted.
    pub points: usize,
    /// Leave-one-out errors of the map from wavelengths to this model's moments, where there is no holdout (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loo: Option<MapLeftOut>,
}

/// Leave-one-out error of a map from wavelengths to moments, N mm. Readings of one pose are left out together.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MapLeftOut {
    /// Map: `affine`, or the one that the data choose.
    pub map: String,
    /// Both moments pooled.
    pub moment_rmse_nmm: f64,
    /// The two moments apart.
    pub moment_rmse_nmm_each: [f64; 2],
    /// Readings, rest among them.
    pub points: usize,
    /// The map that the data choose, where it is another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chosen: Option<Box<MapLeftOut>>,
}

/// What is lost without one accepted effect, the others refitted.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct EffectLeftOut {
    /// Effect.
    pub id: String,
    /// Root mean square of what the fit leaves, over that with the effect.
    pub misfit_ratio: f64,
    /// Chance of that gain without the effect, adjusted for the whole catalogue.
    pub p_value: f64,
    /// Held-out error with it, in the unit of the first error of `after`; absent without a holdout.
    pub held_out: Option<f64>,
    /// Held-out error without it.
    pub held_out_without: Option<f64>,
}

/// How an existing calibration does on readings that were not in its fit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CalibrationJudgement {
    /// File.
    pub path: String,
    /// Hash of its content.
    pub content_sha256: String,
    /// Errors.
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

/// A pose of the next measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NextPose {
    /// Trajectory.
    pub trajectory: u32,
    /// Stage position, mm.
    pub stage_mm: f64,
    /// +1 loading, -1 unloading.
    pub direction: f64,
    /// Speed, mm/s; 0 settled.
    pub speed_mm_s: f64,
    /// Dwell before the reading, s.
    #[serde(default)]
    pub dwell_s: f64,
}

/// The measurement that would decide.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NextMeasurement {
    /// Effects that it separates.
    pub separates: Vec<String>,
    /// Plain instruction.
    pub instruction: String,
    /// Poses in order.
    pub poses: Vec<NextPose>,
    /// Probability that the measurement decides.
    pub expected_power: f64,
}

/// What this data could have shown of one effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detectable {
    /// Effect identifier.
    pub id: String,
    /// Smallest size found with 90 % probability; absent where not testable.
    pub smallest: Option<f64>,
    /// The same without the pictures; absent where there are none, or where the wavelengths alone do not show it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smallest_without_pictures: Option<f64>,
    /// Unit of both.
    pub unit: String,
    /// `testable`, `absorbed`, `not-observable`.
    pub status: String,
    /// Reason.
    pub why: String,
}

/// The tracker on the groove: its place from the moments and the stage's way alone, beside where it is known to be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GrooveTracking {
    /// Error in space, root mean square, mm.
    pub rmse_mm: f64,
    /// Cramer-Rao bound of that error under the calibration's covariance and the noise, root mean square, mm.
    pub bound_mm: f64,
    /// Share of the readings whose groove lies in the stated 95 % region.
    pub coverage95: f64,
    /// Loaded readings that were compared.
    pub points: usize,
    /// Trajectories; the error is one and the same at all readings of a trajectory.
    pub trajectories: usize,
    /// Trajectories whose groove lies in the stated 95 % region at half of their readings and more: what may be counted.
    #[serde(default)]
    pub trajectories_held: usize,
    /// Trajectories on which moments and motion do not belong together.
    pub doubted: usize,
    /// `holdout`: readings that were sealed; `fit`: those that the calibration was fitted to.
    pub split: String,
    /// What the uncertainty of the map makes of a contact, by arc length.
    #[serde(default)]
    pub uncertainty: Vec<ContactUncertainty>,
}

/// Expanded uncertainties (twice the standard deviation) of a moment and of the contact that follows from it, on the trajectories of one arc
/// length: root mean squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContactUncertainty {
    /// Arc length of first touch, mm.
    pub arclength_mm: f64,
    /// Trajectories.
    pub trajectories: usize,
    /// Moment at the deepest reading, N mm.
    pub moment_nmm: f64,
    /// Its uncertainty by the calibration alone, N mm.
    pub moment_u_nmm: f64,
    /// Uncertainty of the contact by the calibration and by where the object passes the free wire, mm.
    pub contact_u_by_map_mm: f64,
    /// The same with the noise of the readings, mm.
    pub contact_u_mm: f64,
}

/// What the pictures say beside the wavelengths.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SecondWitness {
    /// Pairs that count.
    pub pairs: usize,
    /// Pairs that stand aside, and why.
    #[serde(default)]
    pub left_out: Vec<PairLeftOut>,
    /// Scatter about the accepted model over what the shapes state; 1 where they state it right.
    pub reduced_chi: f64,
    /// Fall of the misfit of the wavelengths by the accepted effects, in variances of the noise.
    pub gain_wavelengths: f64,
    /// The same of the pictures.
    pub gain_pictures: f64,
    /// Which witness decided, see [`VerifyDocument::witness`].
    #[serde(skip)]
    pub decided: Option<String>,
}

/// `verify.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VerifyDocument {
    /// Always [`VERIFY_FORMAT`].
    pub format: String,
    /// Session identifier.
    pub session: String,
    /// The session, or one that it was joined with, is simulated; absent in files from before the mark.
    #[serde(default)]
    pub simulated: bool,
    /// `whisker`, `transducer` or `axis`.
    pub kind: String,
    /// Conclusion.
    pub verdict: Verdict,
    /// One plain sentence.
    pub reason: String,
    /// Stage 0.
    pub twin: TwinCheck,
    /// The best explanation's effects.
    pub effects: Vec<NamedEffect>,
    /// Every surviving explanation, best first, the best included.
    pub alternatives: Vec<Vec<String>>,
    /// Present with the verdict "unknown-effect".
    pub unknown: Option<UnknownEffect>,
    /// Noise floor.
    pub noise_floor: NoiseFloor,
    /// The noise in parts.
    #[serde(default)]
    pub noise: Option<NoiseDocument>,
    /// Readings that no tails of the noise explain, left out of the fit.
    #[serde(default)]
    pub flagged: Vec<FlaggedReading>,
    /// Held-out error of the declared model.
    pub before: Option<HeldOutError>,
    /// Held-out error of the accepted model.
    pub after: Option<HeldOutError>,
    /// Held-out coverage of the stated 95 % intervals.
    pub coverage95: Option<f64>,
    /// What to measure next.
    pub next_measurement: Option<NextMeasurement>,
    /// Smallest detectable sizes.
    pub detectable: Vec<Detectable>,
    /// Seed.
    pub seed: u64,
    /// Files read.
    pub inputs: Vec<InputFile>,
    /// Remarks: what was absent, what was marked and kept.
    #[serde(default)]
    pub notes: Vec<String>,
    /// What each accepted effect is worth.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub leave_one_effect_out: Vec<EffectLeftOut>,
    /// Which fitted values the data determine only together, in sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub identifiability: Vec<String>,
    /// How a given calibration does on readings that were not in its fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationJudgement>,
    /// Where the tracker puts the groove through the accepted calibration (kind whisker).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groove_tracking: Option<GrooveTracking>,
    /// Which witness decided for the accepted effects, by the gain that each gives: `wavelengths`, `pictures` or `both`; absent without
    /// pictures or effects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub witness: Option<String>,
    /// The pictures beside the wavelengths; absent without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pictures: Option<SecondWitness>,
}

impl VerifyDocument {
    /// The document of data that cannot be used; `inputs` are left to the caller.
    #[must_use]
    pub fn refused(
        session: impl Into<String>,
        kind: impl Into<String>,
        reason: impl Into<String>,
        seed: u64,
    ) -> Self {
        Self {
            format: VERIFY_FORMAT.to_owned(),
            session: session.into(),
            simulated: false,
            kind: kind.into(),
            verdict: Verdict::Refused,
            reason: reason.into(),
            twin: TwinCheck::default(),
            effects: Vec::new(),
            alternatives: Vec::new(),
            unknown: None,
            noise_floor: NoiseFloor { source: "none".into(), ..NoiseFloor::default() },
            noise: None,
            flagged: Vec::new(),
            before: None,
            after: None,
            coverage95: None,
            next_measurement: None,
            detectable: Vec::new(),
            seed,
            inputs: Vec::new(),
            notes: Vec::new(),
            leave_one_effect_out: Vec::new(),
            identifiability: Vec::new(),
            calibration: None,
            groove_tracking: None,
            witness: None,
            pictures: None,
        }
    }
}
