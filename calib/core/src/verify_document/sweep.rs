//! What a sweep over an object that is known says of the explanations.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How near the contacts that the moments allow come to the object, over the readings in contact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SurfaceDistance {
    /// Root mean square, mm.
    pub distance_rmse_mm: f64,
    /// Mean, mm.
    pub distance_mean_mm: f64,
    /// Median, mm.
    pub distance_median_mm: f64,
}

/// An explanation before the sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SweepExplanation {
    /// Its effects; empty for the declared model.
    pub effects: Vec<String>,
    /// Distances under it.
    #[serde(flatten)]
    pub distance: SurfaceDistance,
    /// Whether the sweep refutes it.
    pub refuted: bool,
    /// Probability of distances as unlikely where the calibration is right within its uncertainty.
    #[schemars(range(min = 0, max = 1))]
    pub p_value: f64,
}

/// `sweep` of verify.json.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SweepJudgement {
    /// Identifier of the sweep.
    pub session: String,
    /// Readings that judge: from first load to the largest.
    pub samples: usize,
    /// Distances under the declared model.
    pub before: SurfaceDistance,
    /// Distances under the accepted model.
    pub after: SurfaceDistance,
    /// Every explanation that was judged, in the order in which they came up.
    pub explanations: Vec<SweepExplanation>,
}
