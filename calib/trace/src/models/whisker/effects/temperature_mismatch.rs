//! Rest of the temperature compensation: dk (T - T0) in each channel.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct TemperatureMismatch;

impl Effect for TemperatureMismatch {
    fn id(&self) -> &'static str {
        "temperature-mismatch"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("linear").needing(&[LawRequirement::Temperature]).column("mismatch_pm_per_degc", "pm/degC")]
    }
    fn sentence(&self) -> &'static str {
        "Sensing and reference gratings differ in temperature sensitivity: compensation is incomplete."
    }
    fn source(&self) -> &'static str {
        "difference of the temperature coefficients; tens of pm/K where bonded to polymer"
    }
}

impl WhiskerEffect for TemperatureMismatch {
    fn columns(
        &self,
        _values: &Values,
        path: &WhiskerPath,
        _moments_nmm: &[[f64; 2]],
        out: &mut Vec<Vec<f64>>,
    ) {
        // Of the other readings: this one's own noise is in its compensated shifts as well, and would pull the coefficient.
        out.push(path.readings.iter().map(|r| r.temperature_loo_degc).collect());
    }
}
