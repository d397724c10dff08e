//! What verify.json says was found, what could have been, and what to measure next.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A group of labels that the twin got wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TwinFault {
    /// Point numbers.
    pub points: Vec<i64>,
    /// `axes`, `branch`, `contact-lost`, `discretisation`, `not-settled`, `sign`, `unit`.
    #[schemars(extend("enum" = ["axes", "branch", "contact-lost", "discretisation", "not-settled", "sign", "unit"]))]
    pub kind: String,
    /// Plain sentence.
    pub detail: String,
}

/// Result of stage 0.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct TwinCheck {
    /// Groups of faulty labels.
    pub faults: Vec<TwinFault>,
}

/// A fitted parameter of an effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EffectParameter {
    /// Name, e.g. `friction_coefficient`.
    pub name: String,
    /// Estimate.
    pub value: f64,
    /// Unit, `1` where dimensionless.
    pub unit: String,
    /// 95 % interval: lower and upper end.
    pub interval95: [f64; 2],
}

/// An effect that the data asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NamedEffect {
    /// Identifier of docs/src/method.md.
    pub id: String,
    /// Law by which each of its terms acts, in the catalogue's words.
    pub laws: Vec<String>,
    /// Effects that this data cannot distinguish from it, itself included.
    pub class: Vec<String>,
    /// p-value adjusted for the whole catalogue.
    #[schemars(range(min = 0, max = 1))]
    pub p_value: f64,
    /// Fitted parameters.
    pub parameters: Vec<EffectParameter>,
    /// Plain sentence for the report.
    pub sentence: String,
}

/// What drives a residual that nothing explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UnknownEffect {
    /// Covariate that drives it.
    pub driver: String,
    /// `linear`, `quadratic`, `sinusoid`, `step`, `exponential`, `sign`, `dead-zone`, `irregular`.
    pub shape: String,
    /// All covariates, strongest first.
    pub drivers_ranked: Vec<String>,
    /// Period in the covariate's unit, for a sinusoid.
    pub period: Option<f64>,
}

/// A pose of the next measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    pub dwell_s: f64,
}

/// The measurement that would decide.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NextMeasurement {
    /// Effects that it separates.
    pub separates: Vec<String>,
    /// Plain instruction.
    pub instruction: String,
    /// Poses in order.
    pub poses: Vec<NextPose>,
    /// Probability that the measurement decides.
    #[schemars(range(min = 0, max = 1))]
    pub expected_power: f64,
}

/// Detectability of one effect: the smallest size that these data show.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detectable {
    /// Effect identifier.
    pub id: String,
    /// Smallest size with which a session like this one is not called adequate, with 90 %
    /// probability; absent where not testable. To name the effect may take more.
    pub smallest: Option<f64>,
    /// Law of the effect that has this size. May be absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<String>,
    /// Values of the law's shape for this size (a period, a place, a time constant), in the
    /// session's units. May be absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub shape: BTreeMap<String, f64>,
    /// The same without the pictures; absent where there are none, or where the wavelengths alone
    /// do not show it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smallest_without_pictures: Option<f64>,
    /// Unit of both.
    pub unit: String,
    /// `testable`, `absorbed`, `not-observable`.
    #[schemars(extend("enum" = ["testable", "absorbed", "not-observable"]))]
    pub status: String,
    /// Reason.
    pub why: String,
}
