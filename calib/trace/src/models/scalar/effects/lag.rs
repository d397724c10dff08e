//! Lag: the response belongs to an earlier stimulus.

use super::memory::{delayed, relaxed};
use super::{amplitude, law, needs_slope, needs_time};
use crate::effect::{Effect, EffectModel};
use crate::scalar::frame::Frame;
use crate::scalar::system::ScalarEffect;

/// See the module.
pub struct Lag;

impl Effect for Lag {
    fn id(&self) -> &'static str {
        "lag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("delay", vec![amplitude("delay", "duration", [0.0, 0.1], 2e-3)], &[]),
            law("first-order", vec![amplitude("time_constant", "duration", [0.0, 0.1], 2e-3)], &[]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The response lags behind the stimulus in time."
    }
    fn source(&self) -> &'static str {
        "pure delay of unsynchronised clocks, or a first-order low pass"
    }
}

impl ScalarEffect for Lag {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        needs_slope(frame).or_else(|| needs_time(frame))
    }
    fn warp(&self, law: usize, values: &[f64], frame: &Frame, u: &mut [f64]) -> bool {
        let Some(time) = &frame.time else { return false };
        if values[0] > 0.0 {
            let late = if law == 0 { delayed(u, time, values[0]) } else { relaxed(u, time, values[0]) };
            u.copy_from_slice(&late);
        }
        true
    }
}
