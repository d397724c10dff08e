//! The pictures' clock is off: a pair taken while the stage moves shows the groove at another time than its row says.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::Observers;
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct PictureClock;

impl Effect for PictureClock {
    fn id(&self) -> &'static str {
        "picture-clock"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("offset").needing(&[LawRequirement::Pictures, LawRequirement::MovingPictures]).amplitude(
            "clock_s",
            "s",
            [-1.0, 1.0],
            0.02,
        )]
    }
    fn sentence(&self) -> &'static str {
        "The cameras' clock is offset: pictures taken in motion show another position than their rows."
    }
    fn source(&self) -> &'static str {
        "offset between the cameras' clock and the stage's: the groove is seen at x + v tau"
    }
}

impl WhiskerEffect for PictureClock {
    fn observers(&self) -> Observers {
        Observers::Cameras
    }

    fn pose(&self, values: &Values, path: &WhiskerPath, xs_mm: &mut [f64]) {
        let clock_s = values.of("clock_s");
        for (node, x) in path.nodes.iter().zip(xs_mm.iter_mut()) {
            if let Some(i) = node.reading {
                *x += path.readings[i].velocity_mm_s * clock_s;
            }
        }
    }
}
