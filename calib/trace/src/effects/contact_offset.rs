//! Constant offset of the groove in the rig frame (three components; one along the wire is weak).

use super::law;
use crate::candidate::{Candidate, Law};
use crate::mechanics::Mechanics;
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct ContactOffset;

impl Candidate for ContactOffset {
    fn id(&self) -> &'static str {
        "contact-offset"
    }
    fn laws(&self) -> Vec<Law> {
        vec![
            law("rigid")
                .amplitude("offset_x_mm", "mm", [-2.0, 2.0], 0.1)
                .amplitude("offset_y_mm", "mm", [-2.0, 2.0], 0.1)
                .amplitude("offset_z_mm", "mm", [-2.0, 2.0], 0.1),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The groove sits a constant distance from where the session says."
    }
    fn source(&self) -> &'static str {
        "mounting tolerance of the rig"
    }
}

impl WhiskerEffect for ContactOffset {
    fn mechanics(&self, _law: usize, values: &[f64], mechanics: &mut Mechanics) {
        for (offset, value) in mechanics.offset_mm.iter_mut().zip(values) {
            *offset += value;
        }
    }
}
