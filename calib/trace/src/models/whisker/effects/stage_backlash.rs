//! Lost motion of the stage: after a reversal the groove stays until the play is taken up.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct StageBacklash;

impl Effect for StageBacklash {
    fn id(&self) -> &'static str {
        "stage-backlash"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("play-from-loading").amplitude("backlash_mm", "mm", [0.0, 0.3], 0.01),
            law("play-centred").amplitude("backlash_mm", "mm", [0.0, 0.3], 0.01),
        ]
    }
    fn helped_by(&self) -> Option<&'static str> {
        Some("direction (readings of loading and unloading)")
    }
    fn sentence(&self) -> &'static str {
        "Backlash: after a reversal the stage lags behind its command."
    }
    fn source(&self) -> &'static str {
        "play between screw and nut; X-LSM100A states < 12 um with encoder (device notes)"
    }
}

impl WhiskerEffect for StageBacklash {
    fn pose(&self, values: &Values, path: &WhiskerPath, xs_mm: &mut [f64]) {
        let play = values.of("backlash_mm");
        // Loading reads true where the axis was referenced that way; centred play is off by half on either side.
        let shift = if values.law() == "play-from-loading" { 0.0 } else { -0.5 * play };
        let mut line = None;
        let mut held = 0.0;
        for (node, x) in path.nodes.iter().zip(xs_mm.iter_mut()) {
            if node.line != line {
                line = node.line;
                held = *x;
            }
            held = held.clamp(*x, *x + play);
            *x = held + shift;
        }
    }
}
