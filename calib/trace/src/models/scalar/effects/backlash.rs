//! Backlash: after a reversal the output stays until the play is taken up.

use super::memory::play;
use super::{amplitude, law, needs_both_directions, needs_slope};
use crate::effect::{Effect, EffectModel};
use crate::scalar::frame::{Declared, Frame};
use crate::scalar::system::ScalarEffect;

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
        let play = law("play", vec![amplitude("backlash", "half-range", [0.0, 0.5], 0.01)], &[]);
        if self.declared == Declared::Axis {
            vec![play, law("reversal", Vec::new(), &[("reversal_value", "response")])]
        } else {
            vec![play]
        }
    }
    fn sentence(&self) -> &'static str {
        "After a reversal the output stays until the play is taken up."
    }
    fn source(&self) -> &'static str {
        "play operator; reversal value B of ISO 230-2"
    }
}

impl ScalarEffect for Backlash {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        needs_slope(frame).or_else(|| needs_both_directions(frame))
    }
    fn warp(&self, law: usize, values: &[f64], _frame: &Frame, u: &mut [f64]) -> bool {
        if law == 0 {
            let held = play(u, values[0]);
            u.copy_from_slice(&held);
        }
        true
    }
    fn columns(&self, law: usize, _values: &[f64], frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if law == 1 {
            let Some(direction) = &frame.direction else { return false };
            // Zero on the way up: the coefficient is the difference down less up.
            out.push(direction.iter().map(|d| 0.5 * (1.0 - d)).collect());
        }
        true
    }
}
