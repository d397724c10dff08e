//! A table of errors by place, and by direction: what ISO 230-2 calls the mean positional deviations at each target. No law of the place; it
//! stands where repeats show that the errors belong to the places and no law describes them.
//!
//! ```text
//! error(x) = sum_k h_k(x) (a_k + b_k [falling])        h_k: 1 at place k, 0 at its neighbours, straight between
//! ```

use super::{ERROR_TABLE, law};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct ErrorTable {
    /// Places in half ranges, rising; none where they are not repeated.
    pub places: Vec<f64>,
}

impl ErrorTable {
    /// Value at `u` of the function that is 1 at place `k`.
    fn hat(&self, k: usize, u: f64) -> f64 {
        let p = &self.places;
        let side = |other: Option<usize>| match other.and_then(|j| p.get(j)) {
            // Beyond the last place the error is the last one's.
            None => 1.0,
            Some(next) => 1.0 - ((u - p[k]) / (next - p[k])).clamp(0.0, 1.0),
        };
        if u < p[k] { side(k.checked_sub(1)) } else { side(Some(k + 1)) }
    }
}

impl Effect for ErrorTable {
    fn id(&self) -> &'static str {
        ERROR_TABLE
    }
    fn laws(&self) -> Vec<EffectModel> {
        // Any law of the place is one of these tables: they are no rivals of it, and are tried only where every law fails.
        Vec::new()
    }
    fn refinements(&self) -> Vec<EffectModel> {
        // At least two, so that the catalogue can be told without a session.
        let places = self.places.len().max(2);
        // The first place's deviation is the declared constant.
        let deviations = vec![("deviation", "response"); places.saturating_sub(1)];
        let both: Vec<_> =
            deviations.iter().copied().chain(vec![("reversal_value", "response"); places]).collect();
        vec![
            law("by-place", Vec::new(), &deviations),
            law("by-place-and-direction", Vec::new(), &both).needing(&[LawRequirement::BothDirections]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The errors depend on position and direction: a table describes them, no law does."
    }
    fn source(&self) -> &'static str {
        "mean positional deviations and reversal values at the targets, ISO 230-2"
    }
}

impl ScalarEffect for ErrorTable {
    fn not_observable(&self, _frame: &Frame) -> Option<String> {
        self.places.is_empty().then(|| "an axis whose places are all repeated shows it".to_owned())
    }
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        if self.places.len() < 2 {
            return false;
        }
        let hat = |k: usize| frame.u.iter().map(|u| self.hat(k, *u)).collect::<Vec<f64>>();
        out.extend((1..self.places.len()).map(hat));
        if values.law() == "by-place-and-direction" {
            let Some(direction) = &frame.direction else { return false };
            // Zero on the way up: the coefficient is the difference down less up.
            let falling = |k: usize| hat(k).iter().zip(direction).map(|(h, d)| 0.5 * (1.0 - d) * h).collect();
            out.extend((0..self.places.len()).map(falling));
        }
        true
    }
}
