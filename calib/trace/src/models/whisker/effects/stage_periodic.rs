//! Periodic error of the stage: A sin(2 pi x / pitch) + B cos(2 pi x / pitch).

use super::law;
use crate::effect::{Effect, EffectModel};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct StagePeriodic;

impl Effect for StagePeriodic {
    fn id(&self) -> &'static str {
        "stage-periodic"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("screw")
                .amplitude("sine_mm", "mm", [-0.1, 0.1], 0.005)
                .amplitude("cosine_mm", "mm", [-0.1, 0.1], 0.005)
                .shape("pitch_mm", "mm", [0.25, 1.3], &[0.6096, 0.3048, 1.2192]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The stage position has an error that repeats with the screw."
    }
    fn source(&self) -> &'static str {
        "LSM100A screw lead 0.6096 mm a turn (device notes)"
    }
}

impl WhiskerEffect for StagePeriodic {
    fn pose(&self, _law: usize, values: &[f64], _path: &WhiskerPath, xs_mm: &mut [f64]) {
        for x in xs_mm {
            let (sin, cos) = (std::f64::consts::TAU * *x / values[2]).sin_cos();
            *x += values[0] * sin + values[1] * cos;
        }
    }
}
