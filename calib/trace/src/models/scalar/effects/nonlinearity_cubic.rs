//! Nonlinearity of the response: a term in the cube of the stimulus, about the middle of the range, or about zero (an odd response).
//!
//! ```text
//! (u - u0)^3 = u^3 - 3 u0 u^2 + ...      u0: stimulus zero; about the middle the square has a coefficient of its own
//! ```

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// Law of an odd response.
const ABOUT_ZERO: &str = "power-3-about-zero";
/// Within this share of the half range zero is inside: the cubic's own part is a third of it and more.
const TWO_SIDED: f64 = 0.5;
/// Further out than this from the middle, zero is no part of what was measured.
const FAR: f64 = 1.2;

/// See the module.
pub struct NonlinearityCubic;

impl Effect for NonlinearityCubic {
    fn id(&self) -> &'static str {
        "nonlinearity-cubic"
    }
    fn laws(&self) -> Vec<EffectModel> {
        let coefficient = [("coefficient", "response/half-range^3")];
        vec![
            law("power-3", Vec::new(), &coefficient),
            law(ABOUT_ZERO, Vec::new(), &coefficient).needing(&[LawRequirement::Slope]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "Cubic nonlinearity: the response has a term in the cube of the stimulus."
    }
    fn source(&self) -> &'static str {
        "NIST/SEMATECH e-Handbook 4.6.1 (load cell)"
    }
}

impl ScalarEffect for NonlinearityCubic {
    fn degree(&self) -> Option<usize> {
        Some(3)
    }
    fn looks_like(&self, law: &EffectModel, frame: &Frame) -> Option<&'static str> {
        (law.name == ABOUT_ZERO && frame.zero_u.abs() > TWO_SIDED).then_some("nonlinearity-quadratic")
    }
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        let centre = if values.law() == ABOUT_ZERO { frame.zero_u } else { 0.0 };
        // About the middle of the range both laws are one; far outside it nothing says that zero is the centre.
        if values.law() == ABOUT_ZERO && !frame.new_rows && !(1e-3..FAR).contains(&centre.abs()) {
            return false;
        }
        out.push(frame.u.iter().map(|u| (u - centre).powi(3)).collect());
        true
    }
}
