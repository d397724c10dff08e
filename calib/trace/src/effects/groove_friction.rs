//! Friction along the wire in the V-groove: stick inside the cone, slip at its edge, with the history of the whole path.

use super::law;
use crate::candidate::{Candidate, Law};
use crate::mechanics::Mechanics;
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct GrooveFriction;

impl Candidate for GrooveFriction {
    fn id(&self) -> &'static str {
        "groove-friction"
    }
    fn laws(&self) -> Vec<Law> {
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
    fn mechanics(&self, law: usize, values: &[f64], mechanics: &mut Mechanics) {
        mechanics.friction += values[0];
        if law == 1 {
            mechanics.moving_share = values[1];
        }
    }
}
