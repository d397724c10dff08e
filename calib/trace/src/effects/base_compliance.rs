//! Compliance of the root: it turns by C m about the transverse axes.

use super::law;
use crate::candidate::{Candidate, Law};
use crate::mechanics::Mechanics;
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct BaseCompliance;

impl Candidate for BaseCompliance {
    fn id(&self) -> &'static str {
        "base-compliance"
    }
    fn laws(&self) -> Vec<Law> {
        vec![
            law("isotropic").amplitude("compliance_rad_per_nmm", "rad/(N mm)", [0.0, 0.2], 0.005),
            law("two-axis").amplitude("compliance_y_rad_per_nmm", "rad/(N mm)", [0.0, 0.2], 0.005).amplitude(
                "compliance_z_rad_per_nmm",
                "rad/(N mm)",
                [0.0, 0.2],
                0.01,
            ),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The root turns under the moment before the wire bends."
    }
    fn source(&self) -> &'static str {
        "potting or mount that gives way"
    }
}

impl WhiskerEffect for BaseCompliance {
    fn mechanics(&self, law: usize, values: &[f64], mechanics: &mut Mechanics) {
        let second = if law == 0 { values[0] } else { values[1] };
        mechanics.compliance_rad_per_nmm[0] += values[0];
        mechanics.compliance_rad_per_nmm[1] += second;
    }
}
