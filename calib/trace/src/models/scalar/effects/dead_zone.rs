//! Dead zone: near zero the response follows the stimulus less or not at all.

use super::{amplitude, law, shape};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct DeadZone;

impl Effect for DeadZone {
    fn id(&self) -> &'static str {
        "dead-zone"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law(
                "about-zero",
                vec![
                    amplitude("slope_lost", "1", [0.0, 1.0], 0.2),
                    shape("half_width", "half-range", [0.005, 1.6], &[0.05, 0.1, 0.2, 0.4, 0.8]),
                ],
                &[],
            )
            .needing(&[LawRequirement::Slope]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "Dead zone: near zero the response does not follow the stimulus."
    }
    fn source(&self) -> &'static str {
        "play or threshold about zero, piecewise linear"
    }
}

impl ScalarEffect for DeadZone {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        let outside = frame.zero_u.abs() > 1.2;
        outside.then(|| "no reading was taken near stimulus zero".to_owned())
    }
    fn warp(&self, values: &Values, frame: &Frame, u: &mut [f64]) -> bool {
        let (share, width) = (values.of("slope_lost"), values.of("half_width"));
        for v in u {
            *v -= share * (*v - frame.zero_u).clamp(-width, width);
        }
        true
    }
}
