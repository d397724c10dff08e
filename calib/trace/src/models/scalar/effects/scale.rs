//! Scale error: the response follows x (1 + e); a free slope takes it up whole.

use super::{amplitude, law};
use crate::effect::{Effect, EffectModel, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct Scale {
    /// The declared model follows the stimulus.
    pub sloped: bool,
}

impl Effect for Scale {
    fn id(&self) -> &'static str {
        "scale"
    }
    fn laws(&self) -> Vec<EffectModel> {
        if self.sloped {
            vec![law("relative", vec![amplitude("relative_scale", "1", [-0.5, 0.5], 1e-3)], &[])]
        } else {
            vec![law("slope", Vec::new(), &[("slope", "response/half-range")])]
        }
    }
    fn sentence(&self) -> &'static str {
        "The response changes in proportion to the stimulus beyond the declared model."
    }
    fn source(&self) -> &'static str {
        "sensitivity or lead error; ISO 230-2 systematic deviation"
    }
}

impl ScalarEffect for Scale {
    fn warp(&self, values: &Values, frame: &Frame, u: &mut [f64]) -> bool {
        if self.sloped {
            let error = values.of("relative_scale");
            for v in u {
                *v += error * (*v - frame.zero_u);
            }
        }
        true
    }
    fn degree(&self) -> Option<usize> {
        Some(1)
    }
    fn columns(&self, _values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if !self.sloped {
            out.push(frame.u.clone());
        }
        true
    }
}
