//! Single readings with the wire out of the vertex.

use super::law;
use crate::effect::{Effect, EffectModel};

use crate::whisker::WhiskerEffect;

/// See the module.
pub struct SlipOutliers;

impl Effect for SlipOutliers {
    fn id(&self) -> &'static str {
        "slip-outliers"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("single-readings")]
    }
    fn in_single_readings(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "Outlying readings were excluded: the wire possibly left the vertex of the groove."
    }
    fn source(&self) -> &'static str {
        "found reading by reading (engine: outliers), not by a law"
    }
}

impl WhiskerEffect for SlipOutliers {}
