//! Bending stiffness that varies along the wire.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;

/// See the module.
pub struct WireTaper;

impl Effect for WireTaper {
    fn id(&self) -> &'static str {
        "wire-taper"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("linear-diameter").amplitude("relative_stiffness_change", "1", [-0.6, 1.5], 0.1)]
    }
    fn sentence(&self) -> &'static str {
        "Taper: the wire's diameter changes from root to tip."
    }
    fn source(&self) -> &'static str {
        "EI goes with the fourth power of the diameter"
    }
}

impl WhiskerEffect for WireTaper {
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        rod.taper += values.of("relative_stiffness_change");
    }
}
