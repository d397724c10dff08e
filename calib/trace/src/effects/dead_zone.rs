//! No response below a moment m0.

use super::law;
use crate::candidate::{Candidate, Law};
use crate::path::WhiskerPath;
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct DeadZone;

impl Candidate for DeadZone {
    fn id(&self) -> &'static str {
        "dead-zone"
    }
    fn laws(&self) -> Vec<Law> {
        vec![
            law("radial").amplitude("threshold_nmm", "N mm", [0.0, 1.0], 0.05),
            law("by-axis").amplitude("threshold_nmm", "N mm", [0.0, 1.0], 0.05),
        ]
    }
    fn sentence(&self) -> &'static str {
        "Small moments do not reach the gratings: there is play in the bond or the seat."
    }
    fn source(&self) -> &'static str {
        "play of the seat; radial or by axis"
    }
}

impl WhiskerEffect for DeadZone {
    fn sensor(&self, law: usize, values: &[f64], _path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let threshold = values[0];
        for m in moments_nmm {
            if law == 0 {
                let size = m[0].hypot(m[1]);
                let left = if size > threshold { 1.0 - threshold / size } else { 0.0 };
                *m = [m[0] * left, m[1] * left];
            } else {
                *m = m.map(|v| v.signum() * (v.abs() - threshold).max(0.0));
            }
        }
    }
}
