//! Temperature moves the zero or the sensitivity.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct Temperature;

impl Effect for Temperature {
    fn id(&self) -> &'static str {
        "temperature"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("zero", Vec::new(), &[("zero_shift", "response/degc")])
                .needing(&[LawRequirement::Temperature]),
            law("sensitivity", Vec::new(), &[("slope_shift", "response/half-range/degc")])
                .needing(&[LawRequirement::Temperature]),
        ]
    }
    fn acts_severally(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "The response moves with the temperature."
    }
    fn source(&self) -> &'static str {
        "linear thermal zero or sensitivity shift (OIML R 60)"
    }
}

impl ScalarEffect for Temperature {
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        let Some(rise) = &frame.temperature else { return false };
        let column = if values.law() == "zero" {
            rise.clone()
        } else {
            rise.iter().zip(&frame.u).map(|(t, u)| t * (u - frame.zero_u)).collect()
        };
        out.push(column);
        true
    }
}
