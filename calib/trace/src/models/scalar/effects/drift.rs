//! Drift of the zero, in proportion to time, or to the order where there is no time.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct Drift;

impl Effect for Drift {
    fn id(&self) -> &'static str {
        "drift"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("linear", Vec::new(), &[("rate", "response/duration")]).needing(&[LawRequirement::Clock])]
    }
    fn sentence(&self) -> &'static str {
        "The zero drifts during the session."
    }
    fn source(&self) -> &'static str {
        "linear in time; in the order of the readings where the table has no times"
    }
}

impl ScalarEffect for Drift {
    fn columns(&self, _values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        out.push(frame.clock().to_vec());
        true
    }
}
