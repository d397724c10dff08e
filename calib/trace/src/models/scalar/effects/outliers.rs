//! Single readings far outside the noise.

use super::law;
use crate::effect::{Effect, EffectModel};
use crate::scalar::ScalarEffect;

/// See the module.
pub struct Outliers;

impl Effect for Outliers {
    fn id(&self) -> &'static str {
        "outliers"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("single-readings", Vec::new(), &[])]
    }
    fn in_single_readings(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "Single readings lie far outside the noise of the others."
    }
    fn source(&self) -> &'static str {
        "found reading by reading (engine: outliers), not by a law"
    }
}

impl ScalarEffect for Outliers {}
