//! Lag: the response belongs to an earlier stimulus.

use super::memory::{delayed, relaxed};
use super::{amplitude, law};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct Lag;

impl Effect for Lag {
    fn id(&self) -> &'static str {
        "lag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("delay", vec![amplitude("delay", "duration", [0.0, 0.1], 2e-3)], &[])
                .needing(&[LawRequirement::Slope, LawRequirement::Time]),
            law("first-order", vec![amplitude("time_constant", "duration", [0.0, 0.1], 2e-3)], &[])
                .needing(&[LawRequirement::Slope, LawRequirement::Time]),
        ]
    }
    fn has_memory(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "The response lags behind the stimulus in time."
    }
    fn source(&self) -> &'static str {
        "pure delay of unsynchronised clocks, or a first-order low pass"
    }
}

impl ScalarEffect for Lag {
    fn warp(&self, values: &Values, frame: &Frame, u: &mut [f64]) -> bool {
        let Some(time) = &frame.time else { return false };
        let late = match values.law() {
            "delay" => values.of("delay"),
            _ => values.of("time_constant"),
        };
        if late > 0.0 {
            let moved = if values.law() == "delay" { delayed(u, time, late) } else { relaxed(u, time, late) };
            u.copy_from_slice(&moved);
        }
        true
    }
}
