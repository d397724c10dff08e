//! `fit-gpr.json` (format `wcal-map/1`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Format tag of `fit-gpr.json`.
pub const MAP_FORMAT: &str = "wcal-map/1";

/// One candidate map with its cross-validated errors, one entry a moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapCandidate {
    /// `affine`, `quadratic`, `thin-plate`, `matern52`, `released`, ...
    pub name: String,
    /// Leave-one-out error of each moment, N mm.
    pub loo_rmse_nmm: [f64; 2],
    /// Leave-one-trajectory-out error, N mm; absent with fewer than three trajectories.
    pub loto_rmse_nmm: Option<[f64; 2]>,
    /// Leave-one-out coverage of the stated 95 % intervals.
    pub coverage95: [f64; 2],
    /// Leave-one-out mean negative log predictive density.
    pub nll: [f64; 2],
    /// Log evidence, summed over the moments; absent where it is not defined.
    pub log_evidence: Option<f64>,
}

/// How well the readings determine the moments.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Identifiability {
    /// Condition number of the wavelength-from-moment matrix.
    pub condition: f64,
    /// Plain sentences: which moment is barely determined, and why.
    pub warnings: Vec<String>,
}

/// Readings at rest, tested by the map of the loaded poses alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RestZero {
    /// Readings at rest.
    pub readings: usize,
    /// Moment of the free wire by the loaded poses, N mm.
    pub offset_nmm: [f64; 2],
    /// Its standard deviation as one more pose, N mm.
    pub sd_nmm: [f64; 2],
    /// Probability of an offset as large where all readings share one zero.
    pub p_value: f64,
    /// They belong to another zero and were left out: the map's zero is not that of the free wire.
    pub left_out: bool,
}

/// The choice of the wavelength-to-moment map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapDocument {
    /// Format and version.
    #[schemars(extend("const" = MAP_FORMAT))]
    pub format: String,
    /// The session is simulated; absent: measured.
    #[serde(default, skip_serializing_if = "crate::provenance::is_measured")]
    pub simulated: bool,
    /// Calibration poses used (rest rows not counted).
    pub points: usize,
    /// Where the moment labels came from: `rod`, `twin.csv`, `twin.csv repaired by rod`.
    pub labels: String,
    /// Name of the chosen candidate.
    pub chosen: String,
    /// Every candidate.
    pub candidates: Vec<MapCandidate>,
    /// Readings at rest, tested by the map of the loaded poses alone; absent where there are none,
    /// or too few loaded ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest: Option<RestZero>,
    /// How well the readings determine the moments.
    pub identifiability: Identifiability,
    /// Where the map may be used: `kind` (`hull`), `vertices_pm` (counter-clockwise, pm),
    /// `margin_pm`.
    pub valid_region: serde_json::Value,
    /// Hyperparameters of the chosen map, by name.
    pub hyperparameters: BTreeMap<String, serde_json::Value>,
}
