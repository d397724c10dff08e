//! Compliance of the root: it turns by C m about the transverse axes.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;

/// See the module.
pub struct BaseCompliance;

impl Effect for BaseCompliance {
    fn id(&self) -> &'static str {
        "base-compliance"
    }
    fn laws(&self) -> Vec<EffectModel> {
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
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        let names = match values.law() {
            "isotropic" => ["compliance_rad_per_nmm"; 2],
            _ => ["compliance_y_rad_per_nmm", "compliance_z_rad_per_nmm"],
        };
        for (compliance, name) in rod.compliance_rad_per_nmm.iter_mut().zip(names) {
            *compliance += values.of(name);
        }
    }
}
