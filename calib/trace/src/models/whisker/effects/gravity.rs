//! Weight less buoyancy of the wire.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;

/// See the module.
pub struct Gravity;

impl Effect for Gravity {
    fn id(&self) -> &'static str {
        "gravity"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("weight").needing(&[LawRequirement::Weight]).amplitude("weight_share", "1", [0.0, 1.5], 1.0)]
    }
    fn sentence(&self) -> &'static str {
        "The wire bends under its own weight."
    }
    fn source(&self) -> &'static str {
        "int r x (rho_w - rho_f) A g ds, about 0.008 N mm"
    }
}

impl WhiskerEffect for Gravity {
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        rod.weight += values.of("weight_share");
    }
}
