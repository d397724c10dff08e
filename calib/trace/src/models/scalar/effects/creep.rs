//! Creep: the response goes on moving after the stimulus has changed, onward or (negative, recovery) back.

use super::memory::relaxed;
use super::{amplitude, law, shape};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

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
                    amplitude("creep_fraction", "1", [-0.5, 0.5], 0.02),
                    shape("time_constant", "duration", [1e-3, 3.0], &[0.003, 0.01, 0.03, 0.1, 0.3, 1.0]),
                ],
                &[],
            )
            .needing(&[LawRequirement::Time]),
            law(
                "settling",
                vec![shape("time_constant", "duration", [0.01, 0.6], &[0.02, 0.05, 0.1, 0.2, 0.4])],
                &[("size_at_start", "response")],
            )
            .needing(&[LawRequirement::Time]),
        ]
    }
    fn has_memory(&self) -> bool {
        true
    }
    fn acts_severally(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "The response creeps: it keeps changing after the stimulus has settled."
    }
    fn source(&self) -> &'static str {
        "one Prony term driven by the stimulus, or the settling of an earlier load"
    }
}

impl ScalarEffect for Creep {
    fn warp(&self, values: &Values, frame: &Frame, u: &mut [f64]) -> bool {
        if values.law() == "settling" {
            return true;
        }
        let (true, Some(time)) = (frame.sloped(), &frame.time) else { return false };
        let slow = relaxed(u, time, values.of("time_constant"));
        let fraction = values.of("creep_fraction");
        for (v, r) in u.iter_mut().zip(slow) {
            *v += fraction * r;
        }
        true
    }
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if values.law() == "settling" {
            let Some(time) = &frame.time else { return false };
            let constant = values.of("time_constant");
            out.push(time.iter().map(|t| (-t / constant).exp()).collect());
        }
        true
    }
}
