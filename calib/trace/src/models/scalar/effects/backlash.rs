//! Backlash: after a reversal the output stays until the play is taken up.

use super::memory::play;
use super::{amplitude, law};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::{Declared, Frame};

/// See the module.
pub struct Backlash {
    /// Declared model: for an axis an offset by direction is backlash too (ISO 230-2 reversal value).
    pub declared: Declared,
}

impl Effect for Backlash {
    fn id(&self) -> &'static str {
        "backlash"
    }
    fn laws(&self) -> Vec<EffectModel> {
        let play = law("play", vec![amplitude("backlash", "half-range", [0.0, 0.5], 0.01)], &[])
            .needing(&[LawRequirement::Slope, LawRequirement::BothDirections]);
        if self.declared == Declared::Axis {
            vec![
                play,
                law("reversal", Vec::new(), &[("reversal_value", "response")])
                    .needing(&[LawRequirement::BothDirections]),
            ]
        } else {
            vec![play]
        }
    }
    fn has_memory(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "After a reversal the output stays until the play is taken up."
    }
    fn source(&self) -> &'static str {
        "play operator; reversal value B of ISO 230-2"
    }
}

impl ScalarEffect for Backlash {
    fn warp(&self, values: &Values, _frame: &Frame, u: &mut [f64]) -> bool {
        if values.law() == "play" {
            let held = play(u, values.of("backlash"));
            u.copy_from_slice(&held);
        }
        true
    }
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if values.law() == "reversal" {
            let Some(direction) = &frame.direction else { return false };
            // Zero on the way up: the coefficient is the difference down less up.
            out.push(direction.iter().map(|d| 0.5 * (1.0 - d)).collect());
        }
        true
    }
}
