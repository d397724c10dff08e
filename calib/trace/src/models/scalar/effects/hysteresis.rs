//! Hysteresis: the response depends on whether the stimulus was rising or falling.

use super::memory::bouc_wen;
use super::{amplitude, law, shape};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::{Declared, Frame};

/// See the module.
pub struct Hysteresis {
    /// Declared model: an axis counts a mere offset by direction as backlash.
    pub declared: Declared,
}

impl Effect for Hysteresis {
    fn id(&self) -> &'static str {
        "hysteresis"
    }
    fn laws(&self) -> Vec<EffectModel> {
        let gradual = law(
            "bouc-wen",
            vec![
                amplitude("half_loop", "half-range", [-0.5, 0.5], 0.01),
                shape("width", "half-range", [0.005, 2.0], &[0.02, 0.1, 0.3, 1.0]),
            ],
            &[],
        )
        .needing(&[LawRequirement::BothDirections]);
        if self.declared == Declared::Axis {
            return vec![gradual];
        }
        let plain = law("by-direction", Vec::new(), &[("half_loop", "response")]);
        vec![plain.needing(&[LawRequirement::BothDirections]), gradual]
    }
    fn has_memory(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "Hysteresis: the response differs between rising and falling stimulus."
    }
    fn source(&self) -> &'static str {
        "Coulomb friction by direction; Bouc-Wen with n = 1 (Wen 1976)"
    }
}

impl ScalarEffect for Hysteresis {
    fn warp(&self, values: &Values, frame: &Frame, u: &mut [f64]) -> bool {
        if values.law() == "by-direction" {
            return true;
        }
        if !frame.sloped() {
            return false;
        }
        let state = bouc_wen(u, values.of("width"));
        let half_loop = values.of("half_loop");
        for (v, s) in u.iter_mut().zip(state) {
            *v += half_loop * s;
        }
        true
    }
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if values.law() == "by-direction" {
            let Some(direction) = &frame.direction else { return false };
            out.push(direction.clone());
        }
        true
    }
}
