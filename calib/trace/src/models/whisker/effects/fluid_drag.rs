//! Drag of the fluid on a moving base.

use super::law;
use crate::effect::{Effect, EffectModel};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// See the module.
pub struct FluidDrag;

impl Effect for FluidDrag {
    fn id(&self) -> &'static str {
        "fluid-drag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("quadratic")]
    }
    fn sentence(&self) -> &'static str {
        "The surrounding water drags on the wire while the base moves."
    }
    fn source(&self) -> &'static str {
        "1/2 rho Cd d v |v|; 0.005 N mm at 0.1 m/s in water"
    }
}

impl WhiskerEffect for FluidDrag {
    fn not_observable(&self, _path: &WhiskerPath, _data: &wcal_core::WhiskerData) -> Option<String> {
        Some("the base does not move on the stage, so the fluid does not drag on it".to_owned())
    }
}
