//! Nonlinearity of the response: a term in the square of the stimulus, about the middle of the range.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct NonlinearityQuadratic;

impl Effect for NonlinearityQuadratic {
    fn id(&self) -> &'static str {
        "nonlinearity-quadratic"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("power-2", Vec::new(), &[("coefficient", "response/half-range^2")])]
    }
    fn sentence(&self) -> &'static str {
        "Quadratic nonlinearity: the response has a term in the square of the stimulus."
    }
    fn source(&self) -> &'static str {
        "NIST/SEMATECH e-Handbook 4.6.1 (load cell)"
    }
}

impl ScalarEffect for NonlinearityQuadratic {
    fn degree(&self) -> Option<usize> {
        Some(2)
    }
    fn columns(&self, _values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        out.push(frame.u.iter().map(|u| u.powi(2)).collect());
        true
    }
}
