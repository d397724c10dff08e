//! Where an effect of a scalar session acts: on the stimulus, or as columns of the response.

use super::frame::Frame;
use crate::effect::{Effect, EffectModel, Values};

/// Where an effect of a scalar session acts; every hook does nothing by default and returns false where the law does not apply.
pub trait ScalarEffect: Effect {
    /// Why the effect cannot be seen in readings that have every column it needs; none where it can.
    fn not_observable(&self, _frame: &Frame) -> Option<String> {
        None
    }
    /// The power of the stimulus that it adds to a polynomial of one degree less.
    fn degree(&self) -> Option<usize> {
        None
    }
    /// The columns of a law are functions of the stimulus alone.
    fn of_stimulus(&self, _law: &EffectModel) -> bool {
        self.degree().is_some()
    }
    /// A plainer effect that a law of this one looks like on these readings: it is named only where that one is contradicted.
    fn looks_like(&self, _law: &EffectModel, _frame: &Frame) -> Option<&'static str> {
        None
    }
    /// Values of a law's only shape that are none of this effect: where one of them describes the readings better, the effect is not named.
    fn too_little_of_it(&self) -> &'static [f64] {
        &[]
    }
    /// Changes the effective stimulus of every reading, in half ranges.
    fn warp(&self, _values: &Values, _frame: &Frame, _u: &mut [f64]) -> bool {
        true
    }
    /// Appends columns (one value a reading) with free coefficients.
    fn columns(&self, _values: &Values, _frame: &Frame, _out: &mut Vec<Vec<f64>>) -> bool {
        true
    }
}
