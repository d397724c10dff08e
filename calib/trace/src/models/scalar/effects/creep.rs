//! Creep: the response goes on moving after the stimulus has changed.

use super::memory::relaxed;
use super::{amplitude, law, needs_time, shape};
use crate::effect::{Effect, EffectModel};
use crate::scalar::frame::Frame;
use crate::scalar::system::ScalarEffect;

/// See the module.
pub struct Creep;

impl Effect for Creep {
    fn id(&self) -> &'static str {
        "creep"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law(
                "prony",
                vec![
                    amplitude("creep_fraction", "1", [0.0, 0.5], 0.02),
                    shape("time_constant", "duration", [1e-3, 3.0], &[0.003, 0.01, 0.03, 0.1, 0.3, 1.0]),
                ],
                &[],
            ),
            law(
                "settling",
                vec![shape("time_constant", "duration", [0.01, 0.6], &[0.02, 0.05, 0.1, 0.2, 0.4])],
                &[("size_at_start", "response")],
            ),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The response goes on moving after the stimulus has changed: it creeps."
    }
    fn source(&self) -> &'static str {
        "one Prony term driven by the stimulus, or the settling of an earlier load"
    }
}

impl ScalarEffect for Creep {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        needs_time(frame)
    }
    fn warp(&self, law: usize, values: &[f64], frame: &Frame, u: &mut [f64]) -> bool {
        if law == 1 {
            return true;
        }
        let (true, Some(time)) = (frame.sloped(), &frame.time) else { return false };
        let slow = relaxed(u, time, values[1]);
        for (v, r) in u.iter_mut().zip(slow) {
            *v += values[0] * r;
        }
        true
    }
    fn columns(&self, law: usize, values: &[f64], frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if law == 1 {
            let Some(time) = &frame.time else { return false };
            out.push(time.iter().map(|t| (-t / values[0]).exp()).collect());
        }
        true
    }
}
