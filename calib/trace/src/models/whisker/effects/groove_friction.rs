//! Friction along the wire in the V-groove: stick inside the cone, slip at its edge, with the history of the whole path.

use super::law;
use crate::effect::{Effect, EffectModel};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_tables::RodParameters;

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
    fn sentence(&self) -> &'static str {
        "The wire drags in the V-groove: the contact force has a part along the wire until it slips."
    }
    fn source(&self) -> &'static str {
        "Coulomb friction at a point contact; a groove of half angle a raises the coefficient by up to 1/sin a"
    }
}

impl WhiskerEffect for GrooveFriction {
    fn rod_parameters(&self, law: usize, values: &[f64], rod_parameters: &mut RodParameters) {
        rod_parameters.friction += values[0];
        if law == 1 {
            rod_parameters.moving_share = values[1];
        }
    }
}
