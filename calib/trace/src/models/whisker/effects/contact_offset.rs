//! Constant offset of the groove in the rig frame (three components; one along the wire is weak).

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;

/// See the module.
pub struct ContactOffset;

impl Effect for ContactOffset {
    fn id(&self) -> &'static str {
        "contact-offset"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("rigid")
                .amplitude("offset_x_mm", "mm", [-2.0, 2.0], 0.1)
                .amplitude("offset_y_mm", "mm", [-2.0, 2.0], 0.1)
                .amplitude("offset_z_mm", "mm", [-2.0, 2.0], 0.1),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The groove is displaced from its stated position by a constant offset."
    }
    fn source(&self) -> &'static str {
        "mounting tolerance of the rig"
    }
}

impl WhiskerEffect for ContactOffset {
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        for (offset, name) in rod.offset_mm.iter_mut().zip(["offset_x_mm", "offset_y_mm", "offset_z_mm"]) {
            *offset += values.of(name);
        }
    }
}
