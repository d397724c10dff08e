//! Scale error of the stage: x (1 + e).

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct StageScale;

impl Effect for StageScale {
    fn id(&self) -> &'static str {
        "stage-scale"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("linear").amplitude("relative_scale", "1", [-0.03, 0.03], 0.01)]
    }
    fn helped_by(&self) -> Option<&'static str> {
        Some("stage_mm")
    }
    fn sentence(&self) -> &'static str {
        "Scale error: the stage travels a constant factor more or less than commanded."
    }
    fn source(&self) -> &'static str {
        "lead error of the screw"
    }
}

impl WhiskerEffect for StageScale {
    fn pose(&self, values: &Values, _path: &WhiskerPath, xs_mm: &mut [f64]) {
        let relative_scale = values.of("relative_scale");
        for x in xs_mm {
            *x *= 1.0 + relative_scale;
        }
    }
}
