//! Bending stiffness that varies along the wire.

use super::law;
use crate::candidate::{Candidate, Law};
use crate::mechanics::Mechanics;
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct WireTaper;

impl Candidate for WireTaper {
    fn id(&self) -> &'static str {
        "wire-taper"
    }
    fn laws(&self) -> Vec<Law> {
        vec![law("linear-diameter").amplitude("relative_stiffness_change", "1", [-0.6, 1.5], 0.1)]
    }
    fn sentence(&self) -> &'static str {
        "The wire is thinner or thicker toward its tip than at its root."
    }
    fn source(&self) -> &'static str {
        "EI goes with the fourth power of the diameter"
    }
}

impl WhiskerEffect for WireTaper {
    fn mechanics(&self, _law: usize, values: &[f64], mechanics: &mut Mechanics) {
        mechanics.taper += values[0];
    }
}
