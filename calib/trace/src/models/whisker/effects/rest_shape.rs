//! The wire at rest is not as declared: its straight part is longer or shorter, its arc flatter or narrower.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;

/// See the module.
pub struct RestShape;

impl Effect for RestShape {
    fn id(&self) -> &'static str {
        "rest-shape"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("straight-and-arc")
                .needing(&[LawRequirement::Pictures, LawRequirement::StraightArc])
                .amplitude("straight_change_mm", "mm", [-6.0, 6.0], 0.5)
                .amplitude("arc_radius_change_mm", "mm", [-6.0, 6.0], 0.5),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The rest shape differs from the declared one: straight length or arc radius."
    }
    fn source(&self) -> &'static str {
        "bending tolerance of the wire; the free tail in the pictures shows it with no load"
    }
}

impl WhiskerEffect for RestShape {
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        rod.straight_change_mm += values.of("straight_change_mm");
        rod.arc_radius_change_mm += values.of("arc_radius_change_mm");
    }
}
