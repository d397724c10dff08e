//! Periodic error of the stage: A sin(2 pi x / pitch) + B cos(2 pi x / pitch).

use super::law;
use crate::effect::{Effect, EffectModel, Values};
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
    fn helped_by(&self) -> Option<&'static str> {
        Some("stage_mm")
    }
    fn sentence(&self) -> &'static str {
        "Periodic error: the stage position errs with the period of the screw."
    }
    fn source(&self) -> &'static str {
        "LSM100A screw lead 0.6096 mm a turn (device notes)"
    }
}

impl WhiskerEffect for StagePeriodic {
    fn pose(&self, values: &Values, _path: &WhiskerPath, xs_mm: &mut [f64]) {
        let [sine_mm, cosine_mm, pitch_mm] = ["sine_mm", "cosine_mm", "pitch_mm"].map(|name| values.of(name));
        for x in xs_mm {
            let (sin, cos) = (std::f64::consts::TAU * *x / pitch_mm).sin_cos();
            *x += sine_mm * sin + cosine_mm * cos;
        }
    }
}
