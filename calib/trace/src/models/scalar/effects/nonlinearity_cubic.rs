//! Nonlinearity of the response: a term in the cube of the stimulus, about the middle of the range.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct NonlinearityCubic;

impl Effect for NonlinearityCubic {
    fn id(&self) -> &'static str {
        "nonlinearity-cubic"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("power-3", Vec::new(), &[("coefficient", "response/half-range^3")])]
    }
    fn sentence(&self) -> &'static str {
        "The response bends: it has a term in the cube of the stimulus."
    }
    fn source(&self) -> &'static str {
        "NIST/SEMATECH e-Handbook 4.6.1 (load cell)"
    }
}

impl ScalarEffect for NonlinearityCubic {
    fn degree(&self) -> Option<usize> {
        Some(3)
    }
    fn columns(&self, _values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        out.push(frame.u.iter().map(|u| u.powi(3)).collect());
        true
    }
}
