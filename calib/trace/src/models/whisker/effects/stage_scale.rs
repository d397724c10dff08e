//! Scale error of the stage: x (1 + e).

use super::law;
use crate::effect::{Effect, EffectModel};
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
    fn sentence(&self) -> &'static str {
        "The stage travels a constant factor more or less than commanded."
    }
    fn source(&self) -> &'static str {
        "lead error of the screw"
    }
}

impl WhiskerEffect for StageScale {
    fn pose(&self, _law: usize, values: &[f64], _path: &WhiskerPath, xs_mm: &mut [f64]) {
        for x in xs_mm {
            *x *= 1.0 + values[0];
        }
    }
}
