//! Drift of the zero, linear in time.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct ZeroDrift;

impl Effect for ZeroDrift {
    fn id(&self) -> &'static str {
        "zero-drift"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("linear").needing(&[LawRequirement::Time]).column("drift_pm_per_min", "pm/min")]
    }
    fn sentence(&self) -> &'static str {
        "The zero of the readings drifts with time."
    }
    fn source(&self) -> &'static str {
        "relaxation of bonds and packaging, interrogator drift"
    }
}

impl WhiskerEffect for ZeroDrift {
    fn columns(
        &self,
        _values: &Values,
        path: &WhiskerPath,
        _moments_nmm: &[[f64; 2]],
        out: &mut Vec<Vec<f64>>,
    ) {
        out.push(path.readings.iter().map(|r| r.t_s / 60.0).collect());
    }
}
