//! Drag of the fluid on a moving base.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement};
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct FluidDrag;

impl Effect for FluidDrag {
    fn id(&self) -> &'static str {
        "fluid-drag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("quadratic").needing(&[LawRequirement::MovingBase])]
    }
    fn sentence(&self) -> &'static str {
        "Fluid drag: the surrounding water loads the wire while the base moves."
    }
    fn source(&self) -> &'static str {
        "1/2 rho Cd d v |v|; 0.005 N mm at 0.1 m/s in water"
    }
}

impl WhiskerEffect for FluidDrag {}
