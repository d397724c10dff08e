//! How a network is trained, and its learning curve.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::ranges::Range;
use wcal_network::filter::{BayesSettings, FilterBank};

/// Numbers that a training may state.
pub const TRAINING_RANGES: &[Range] = &[
    Range::whole("training.epochs", 0.0, 1e6),
    Range::whole("training.batch", 1.0, 65_536.0),
    Range::whole("training.window", 1.0, 65_536.0),
    Range::real("training.rate", 0.0, 10.0),
    Range::whole("training.patience", 0.0, 1e6),
    Range::whole("training.passes_per_draw", 0.0, 1e6),
    Range::real("training.speed_known", 0.0, 1.0),
    Range::real("training.time_factor", 1e-3, 1e3),
    Range::real("training.noise_nmm", 0.0, 1e3),
    Range::real("training.gain", 0.0, 1.0),
    Range::real("training.drift_nmm_s", 0.0, 1e3),
    Range::whole("training.seed", 0.0, 1.9e19),
];

/// How a network is trained.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainSettings {
    /// Passes over the series at most.
    pub epochs: usize,
    /// Sweep series in a batch, and tokens of each.
    pub batch: usize,
    /// Tokens of each.
    pub window: usize,
    /// Largest learning rate; it rises over the first part and falls to nothing along a half
    /// cosine.
    pub rate: f64,
    /// Passes without progress on the held-out objects after which training stops.
    pub patience: usize,
    /// Passes for which windows are windows once: what the bench adds is costly to make (the filter
    /// runs over it), not to learn from.
    pub passes_per_draw: usize,
    /// Share of the series for which the base's speed is given.
    pub speed_known: f64,
    /// Bounds of the factor on time (the wire is quasi-static: a faster sweep is the same one in
    /// less time).
    pub time_factor: [f64; 2],
    /// Largest noise of a moment, N mm (small ones are windows more often), gain error, and drift,
    /// N mm/s.
    pub noise_nmm: f64,
    /// Gain error.
    pub gain: f64,
    /// Drift, N mm/s.
    pub drift_nmm_s: f64,
    /// Whether half of the series, others in each pass, are taken as their mirror images, where the
    /// free wire lies in a plane.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub mirror: bool,
    /// What the filter below the network assumes; models of before it was written down had the
    /// default one.
    #[serde(default)]
    pub filter: BayesSettings,
    /// A second one, which the network weighs against it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter_frictionless: Option<BayesSettings>,
    /// Seed of all draws.
    pub seed: u64,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            epochs: 20,
            batch: 16,
            window: 128,
            rate: 1.5e-3,
            patience: 8,
            passes_per_draw: 5,
            speed_known: 0.7,
            time_factor: [0.4, 1.5],
            noise_nmm: 0.006,
            gain: 0.005,
            drift_nmm_s: 0.0004,
            mirror: true,
            filter: BayesSettings::coulomb(),
            filter_frictionless: Some(BayesSettings::default()),
            seed: 1,
        }
    }
}

impl TrainSettings {
    /// The filters below the network.
    pub fn filters(&self) -> FilterBank {
        FilterBank {
            frictional: self.filter,
            frictionless: self.filter_frictionless,
        }
    }

    /// Sweep series as the twin made them.
    pub(crate) fn without_disturbances(&self) -> Self {
        Self {
            noise_nmm: 0.0,
            gain: 0.0,
            drift_nmm_s: 0.0,
            time_factor: [1.0; 2],
            ..*self
        }
    }
}

/// One pass in the learning curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Pass {
    /// Number, from 1.
    pub epoch: usize,
    /// Mean loss of training.
    pub loss: f64,
    /// On the held-out objects: loss, and RMSE of the true contact, mm.
    pub held_out_loss: f64,
    /// RMSE of the true contact there, mm.
    pub held_out_mm: f64,
    /// RMSE to the surface, mm, where the objects' meshes were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out_surface_mm: Option<f64>,
    /// Seconds since the beginning.
    pub seconds: f64,
    /// Processor time since the beginning, all threads together, s; models of before 2026-11-25 do
    /// not have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cpu_s: Option<f64>,
}

/// The pass with the least loss on the held-out objects.
pub fn best(passes: &[Pass]) -> Option<&Pass> {
    passes
        .iter()
        .min_by(|a, b| a.held_out_loss.total_cmp(&b.held_out_loss))
}
