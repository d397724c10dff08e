//! The rig tag is glued askew: the groove is not where the tag says.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::{PairObservation, WhiskerEffect};
use nalgebra::Vector3;

/// See the module.
pub struct RigTag;

impl Effect for RigTag {
    fn id(&self) -> &'static str {
        "rig-tag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("rigid")
                .needing(&[LawRequirement::Pictures])
                .amplitude("offset_x_mm", "mm", [-5.0, 5.0], 0.2)
                .amplitude("offset_y_mm", "mm", [-5.0, 5.0], 0.2)
                .amplitude("offset_z_mm", "mm", [-5.0, 5.0], 0.2),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The rig tag is displaced from its stated position: the contact appears shifted along the wire by a constant."
    }
    fn source(&self) -> &'static str {
        "the tag says where along the wire the groove is, the wire's own pictures say where across"
    }
}

impl WhiskerEffect for RigTag {
    fn pictures(&self, values: &Values, seen: &mut [PairObservation]) {
        let offset = ["offset_x_mm", "offset_y_mm", "offset_z_mm"].map(|name| values.of(name));
        for s in seen {
            match s.derivatives.clone().rig_tag.as_ref() {
                Some(by) => by.iter().zip(offset).for_each(|(by, size)| s.add(by, size)),
                // The foot of the tag's groove on the wire moves along it.
                None => {
                    let along = s.tangent.dot(&Vector3::from(offset));
                    s.groove_mm += s.tangent * along;
                    s.arclength_mm += along;
                }
            }
        }
    }
}
