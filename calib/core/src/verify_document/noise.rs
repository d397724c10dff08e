//! The noise of verify.json: its floor, its parts, and the readings that it does not explain.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The noise floor and where it came from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct NoiseFloor {
    /// pm (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wavelength_pm: Option<f64>,
    /// The same of readings in motion, averaged over far fewer samples, pm (whisker); absent where
    /// all readings are averaged alike.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moving_wavelength_pm: Option<f64>,
    /// N mm (kind whisker).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_nmm: Option<f64>,
    /// Unit of the response (transducer).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response: Option<f64>,
    /// um (kind axis).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_um: Option<f64>,
    /// Distance of a contact from where it is seen that the shapes' stated covariance gives, root
    /// mean square, mm (with pictures).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_mm: Option<f64>,
    /// `replicates`, `difference`, `declared`, `none`.
    #[schemars(extend("enum" = ["replicates", "difference", "declared", "none"]))]
    pub source: String,
}

/// A part of the noise: standard deviation (or degrees of freedom) with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoisePart {
    /// Estimate.
    pub value: f64,
    /// 95 % interval: lower and upper end.
    pub interval95: [f64; 2],
}

/// The part of the noise that is correlated in time (first-order Gauss-Markov process).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CorrelatedNoise {
    /// Standard deviation.
    pub sd: f64,
    /// 95 % interval: lower and upper end.
    pub interval95: [f64; 2],
    /// Time constant, s; readings where the session has no clock.
    pub time_constant_s: f64,
}

/// How the spread of single readings follows a covariate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoiseLaw {
    /// Covariate: `load`, `depth` or `stimulus`.
    #[schemars(extend("enum" = ["load", "depth", "stimulus"]))]
    pub follows: String,
    /// Standard deviation at the covariate's largest value over that at its smallest.
    pub ratio: f64,
    /// 95 % interval: lower and upper end.
    pub interval95: [f64; 2],
}

/// The noise in parts; what the design cannot tell is absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct NoiseDocument {
    /// A loaded reading by itself, repeated without moving where pose scatter is known.
    pub repeat: Option<NoisePart>,
    /// What setting a pose adds.
    pub pose: Option<NoisePart>,
    /// Zero from session to session.
    pub session: Option<NoisePart>,
    /// Correlated in time (first-order Gauss-Markov).
    pub correlated: Option<CorrelatedNoise>,
    /// Rounding of the recorded values, part of the repeat noise.
    pub rounding: Option<NoisePart>,
    /// Degrees of freedom of Student's t; absent where a Gaussian does as well.
    pub tails_dof: Option<NoisePart>,
    /// Law of the spread; absent where it is the same everywhere.
    pub law: Option<NoiseLaw>,
    /// Unit of the standard deviations.
    pub unit: String,
}

/// A reading that was left out of the fit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FlaggedReading {
    /// File.
    pub source: String,
    /// Point in that file.
    pub point: i64,
}
