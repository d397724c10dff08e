//! A delay between stage and wavelengths: the reading belongs to x - v tau.

use super::law;
use crate::effect::{Effect, EffectModel, Need, Values};
use crate::whisker::Observers;
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct TimeLag;

impl Effect for TimeLag {
    fn id(&self) -> &'static str {
        "time-lag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("delay").needing(&[Need::Motion]).amplitude("lag_s", "s", [0.0, 1.0], 0.02)]
    }
    fn sentence(&self) -> &'static str {
        "Readings taken while the stage moves belong to an earlier position."
    }
    fn source(&self) -> &'static str {
        "clock offset or filter delay between interrogator and stage"
    }
}

impl WhiskerEffect for TimeLag {
    fn observers(&self) -> Observers {
        Observers::Gratings
    }

    fn pose(&self, values: &Values, path: &WhiskerPath, xs_mm: &mut [f64]) {
        let lag_s = values.of("lag_s");
        for (node, x) in path.nodes.iter().zip(xs_mm.iter_mut()) {
            if let Some(i) = node.reading {
                *x -= path.readings[i].velocity_mm_s * lag_s;
            }
        }
    }
}
