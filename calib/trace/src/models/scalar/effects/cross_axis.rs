//! A further covariate acts on the response.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct CrossAxis {
    /// Further covariates of the table.
    pub count: usize,
}

impl Effect for CrossAxis {
    fn id(&self) -> &'static str {
        "cross-axis"
    }
    fn laws(&self) -> Vec<EffectModel> {
        // One law a covariate; the names stand in the session.
        (0..self.count.max(1))
            .map(|_| {
                law("covariate", Vec::new(), &[("slope", "response/covariate")])
                    .needing(&[LawRequirement::Covariate])
            })
            .collect()
    }
    fn column<'a>(&self, law: usize, columns: &'a [String]) -> Option<&'a str> {
        columns.get(law).map(String::as_str)
    }
    fn acts_severally(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "Cross-sensitivity: the response also depends on a second quantity of the table."
    }
    fn source(&self) -> &'static str {
        "linear cross-sensitivity"
    }
}

impl ScalarEffect for CrossAxis {
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        let Some(Some(column)) = frame.covariates.get(values.index()) else { return false };
        out.push(column.clone());
        true
    }
}
