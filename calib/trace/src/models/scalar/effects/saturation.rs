//! Saturation: beyond a knee, away from zero, the response follows the stimulus less or not at all.

use super::{amplitude, law, shape};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct Saturation;

const UPPER: &[f64] = &[-0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8];
const LOWER: &[f64] = &[-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4];

impl Effect for Saturation {
    fn id(&self) -> &'static str {
        "saturation"
    }
    fn laws(&self) -> Vec<EffectModel> {
        // A share of one is complete saturation.
        let share = amplitude("slope_lost", "1", [0.0, 1.0], 0.2);
        vec![
            law("upper-knee", vec![share, shape("knee", "stimulus", [-0.9, 0.98], UPPER)], &[])
                .needing(&[LawRequirement::Slope]),
            law("lower-knee", vec![share, shape("knee", "stimulus", [-0.98, 0.9], LOWER)], &[])
                .needing(&[LawRequirement::Slope]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "Saturation: above a threshold the sensitivity decreases."
    }
    fn source(&self) -> &'static str {
        "limit stop or full-scale limit, piecewise linear"
    }
}

impl ScalarEffect for Saturation {
    fn warp(&self, values: &Values, frame: &Frame, u: &mut [f64]) -> bool {
        let (share, knee) = (values.of("slope_lost"), values.of("knee"));
        let upper = values.law() == "upper-knee";
        // Toward zero a lost slope is a dead zone.
        let away = if upper { knee >= frame.zero_u } else { knee <= frame.zero_u };
        if !away {
            return false;
        }
        for v in u {
            let beyond = if upper { (*v - knee).max(0.0) } else { (*v - knee).min(0.0) };
            *v -= share * beyond;
        }
        true
    }
}
