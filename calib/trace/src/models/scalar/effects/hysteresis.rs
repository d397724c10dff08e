//! Hysteresis: the response depends on whether the stimulus was rising or falling.

use super::memory::bouc_wen;
use super::{amplitude, law, needs_both_directions, shape};
use crate::effect::{Effect, EffectModel};
use crate::scalar::frame::{Declared, Frame};
use crate::scalar::system::ScalarEffect;

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
        );
        if self.declared == Declared::Axis {
            return vec![gradual];
        }
        vec![law("by-direction", Vec::new(), &[("half_loop", "response")]), gradual]
    }
    fn sentence(&self) -> &'static str {
        "The response differs between rising and falling stimulus, as with friction or hysteresis."
    }
    fn source(&self) -> &'static str {
        "Coulomb friction by direction; Bouc-Wen with n = 1 (Wen 1976)"
    }
}

impl ScalarEffect for Hysteresis {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        needs_both_directions(frame)
    }
    fn warp(&self, law: usize, values: &[f64], frame: &Frame, u: &mut [f64]) -> bool {
        if law == 0 && self.declared != Declared::Axis {
            return true;
        }
        if !frame.sloped() {
            return false;
        }
        let state = bouc_wen(u, values[1]);
        for (v, s) in u.iter_mut().zip(state) {
            *v += values[0] * s;
        }
        true
    }
    fn columns(&self, law: usize, _values: &[f64], frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if law == 0 && self.declared != Declared::Axis {
            let Some(direction) = &frame.direction else { return false };
            out.push(direction.clone());
        }
        true
    }
}
