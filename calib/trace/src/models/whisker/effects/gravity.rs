//! Weight less buoyancy of the wire.

use super::law;
use crate::effect::{Effect, EffectModel};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;
use crate::whisker::rod_tables::RodParameters;

/// See the module.
pub struct Gravity;

impl Effect for Gravity {
    fn id(&self) -> &'static str {
        "gravity"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("weight").amplitude("weight_share", "1", [0.0, 1.5], 1.0)]
    }
    fn sentence(&self) -> &'static str {
        "The weight of the wire bends it."
    }
    fn source(&self) -> &'static str {
        "int r x (rho_w - rho_f) A g ds, about 0.008 N mm"
    }
}

impl WhiskerEffect for Gravity {
    fn not_observable(&self, path: &WhiskerPath, data: &wcal_core::WhiskerData) -> Option<String> {
        if !path.columns.gravity {
            return Some("the session does not give the direction of gravity".to_owned());
        }
        data.whisker
            .density_kg_m3
            .is_none()
            .then(|| "the session does not give the density of the wire".to_owned())
    }

    fn rod_parameters(&self, _law: usize, values: &[f64], rod_parameters: &mut RodParameters) {
        rod_parameters.weight += values[0];
    }
}
