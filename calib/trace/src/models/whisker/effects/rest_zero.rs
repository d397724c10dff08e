//! Rest readings of another zero than the loaded ones: `y = y0 + z` at rest, `y = y0 + K m` under load.
//!
//! A rest reading that was taken on another day, after a remount or before the wire was seated says nothing of the zero that the loaded
//! readings have.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct RestZero;

impl Effect for RestZero {
    fn id(&self) -> &'static str {
        "rest-zero"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("step").needing(&[LawRequirement::RestReadings]).column("rest_zero_pm", "pm")]
    }
    fn sentence(&self) -> &'static str {
        "The rest readings have another zero than the loaded ones (taken at another time or mounting)."
    }
    fn source(&self) -> &'static str {
        "a zero holds for one mounting and one day; packaging and bond settle at first load"
    }
}

impl WhiskerEffect for RestZero {
    fn columns(
        &self,
        _values: &Values,
        path: &WhiskerPath,
        _moments_nmm: &[[f64; 2]],
        out: &mut Vec<Vec<f64>>,
    ) {
        out.push(path.readings.iter().map(|r| f64::from(u8::from(r.rest))).collect());
    }
}
