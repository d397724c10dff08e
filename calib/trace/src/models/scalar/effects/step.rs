//! Step: from some reading on, every response is shifted.

use super::{law, shape};
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct Step;

/// Every hundredth of the session.
const GRID: [f64; 99] = {
    let mut grid = [0.0; 99];
    let mut k = 0;
    while k < 99 {
        grid[k] = 0.01 * (k as f64 + 1.0);
        k += 1;
    }
    grid
};

/// A shift of fewer readings than this at either end is not a step but a matter of single readings.
const MIN_EACH_SIDE: usize = 3;

impl Effect for Step {
    fn id(&self) -> &'static str {
        "step"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("once", vec![shape("place", "clock", [0.0, 1.0], &GRID)], &[("height", "response")])
                .needing(&[LawRequirement::Clock]),
        ]
    }
    fn acts_severally(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "The zero steps: from one reading on, all responses are shifted by a constant."
    }
    fn source(&self) -> &'static str {
        "change point in time, or in the order of the readings where the table has no times"
    }
}

impl ScalarEffect for Step {
    fn columns(&self, values: &Values, frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        let place = values.of("place");
        let column: Vec<f64> = frame.clock().iter().map(|o| f64::from(u8::from(*o >= place))).collect();
        let after = column.iter().filter(|v| **v > 0.0).count();
        let few = after < MIN_EACH_SIDE || column.len() - after < MIN_EACH_SIDE;
        if few && !frame.new_rows {
            return false;
        }
        out.push(column);
        true
    }
}
