//! Friction along the wire in the V-groove: stick inside the cone, slip at its edge, with the history of the whole path.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;

/// See the module.
pub struct GrooveFriction;

impl Effect for GrooveFriction {
    fn id(&self) -> &'static str {
        "groove-friction"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("coulomb").amplitude("friction_coefficient", "1", [0.0, 0.7], 0.15),
            law("coulomb-two-speed").amplitude("friction_coefficient", "1", [0.0, 0.7], 0.15).shape(
                "moving_share",
                "1",
                [0.2, 1.5],
                &[0.75],
            ),
        ]
    }
    fn helped_by(&self) -> Option<&'static str> {
        Some("direction (readings of loading and unloading)")
    }
    fn sentence(&self) -> &'static str {
        "Friction in the V-groove: the contact force has a component along the wire until it slips."
    }
    fn source(&self) -> &'static str {
        "Coulomb friction at a point contact; a groove of half angle a raises the coefficient by up to 1/sin a"
    }
}

impl WhiskerEffect for GrooveFriction {
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        rod.friction += values.of("friction_coefficient");
        if values.law() == "coulomb-two-speed" {
            rod.moving_share = values.of("moving_share");
        }
    }
}
