//! Single readings with the wire out of the vertex.

use super::law;
use crate::candidate::{Candidate, Law};

use crate::whisker::WhiskerEffect;

/// See the module.
pub struct SlipOutliers;

impl Candidate for SlipOutliers {
    fn id(&self) -> &'static str {
        "slip-outliers"
    }
    fn laws(&self) -> Vec<Law> {
        vec![law("single-readings")]
    }
    fn sentence(&self) -> &'static str {
        "In single readings the wire was not in the vertex of the groove."
    }
    fn source(&self) -> &'static str {
        "found reading by reading (engine: outliers), not by a law"
    }
}

impl WhiskerEffect for SlipOutliers {
    // Found reading by reading: see the outlier stage.
}
