//! The calibration board is not as large as stated: every length that the cameras measure is off by one factor.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::{PairObservation, WhiskerEffect};

/// See the module.
pub struct BoardScale;

impl Effect for BoardScale {
    fn id(&self) -> &'static str {
        "board-scale"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("one-factor").needing(&[LawRequirement::Pictures]).amplitude(
            "relative_scale",
            "1",
            [-0.1, 0.1],
            0.005,
        )]
    }
    fn sentence(&self) -> &'static str {
        "All lengths in the pictures are wrong by one factor: the calibration board differs from its stated size."
    }
    fn source(&self) -> &'static str {
        "Hartley & Zisserman, Multiple View Geometry, ch. 10.2: a stereo pair has the scale of its board"
    }
}

impl WhiskerEffect for BoardScale {
    fn pictures(&self, values: &Values, seen: &mut [PairObservation]) {
        let scale = values.of("relative_scale");
        for s in seen {
            match s.derivatives.clone().board_scale.as_ref() {
                Some(by) => s.add(by, scale),
                // About the base's origin, from which every length is taken.
                None => {
                    s.groove_mm *= 1.0 + scale;
                    s.arclength_mm *= 1.0 + scale;
                    s.stations_mm.iter_mut().for_each(|p| *p *= 1.0 + scale);
                }
            }
        }
    }
}
