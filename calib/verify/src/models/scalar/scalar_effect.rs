//! Where an effect of a scalar session acts: on the stimulus, or as columns of the response.

use super::frame::Frame;
use crate::effect::{Effect, EffectModel, Values};

/// An effect with where it acts.
#[derive(Clone)]
pub struct ScalarEffect {
    /// Name and laws.
    pub effect: Effect,
    /// Why the effect cannot be seen in readings that have every column it needs; none where it
    /// can.
    pub not_observable: fn(&Frame) -> Option<String>,
    /// A bend: a law of the stimulus alone that does not repeat along it. Bends compete for one
    /// shape.
    pub bend: bool,
    /// The power of the stimulus that it adds to a polynomial of one degree less.
    pub degree: Option<usize>,
    /// A single level says what it is: nothing else has its size.
    pub shows_on_one_level: bool,
    /// Laws whose columns are functions of the stimulus alone, although they are no bend.
    pub waves_of_stimulus: &'static [&'static str],
    /// A plainer effect that a law of this one looks like on these readings: it is named only where
    /// that one is contradicted.
    pub looks_like: fn(&EffectModel, &Frame) -> Option<&'static str>,
    /// Values of a law's only shape that are none of this effect: where one of them describes the
    /// readings better, the effect is not named.
    pub spans_too_few_periods: &'static [f64],
    /// Changes the effective stimulus of every reading, in half ranges; false where the law does
    /// not apply.
    pub warp: fn(&Values, &Frame, &mut [f64]) -> bool,
    /// Columns (one value a reading) with free coefficients; none where the law does not apply.
    pub columns: fn(&Values, &Frame) -> Option<Vec<Vec<f64>>>,
    /// Standard deviation of what no reading shows of a parameter, in its catalogue unit.
    pub systematic_sd: fn(&Values, &Frame, &str) -> f64,
}

impl ScalarEffect {
    /// Whether the columns of a law are functions of the stimulus alone.
    pub(crate) fn of_stimulus(&self, law: &EffectModel) -> bool {
        self.bend || self.degree.is_some() || self.waves_of_stimulus.contains(&law.name)
    }
}

impl ScalarEffect {
    /// An effect without memory that acts nowhere yet.
    pub fn new(id: &'static str, sentence: &'static str, laws: Vec<EffectModel>) -> Self {
        Effect::new(id, sentence, laws).into()
    }
}

impl From<Effect> for ScalarEffect {
    /// An effect that acts nowhere yet.
    fn from(effect: Effect) -> Self {
        Self {
            effect,
            not_observable: |_| None,
            bend: false,
            degree: None,
            shows_on_one_level: false,
            waves_of_stimulus: &[],
            looks_like: |_, _| None,
            spans_too_few_periods: &[],
            warp: |_, _, _| true,
            columns: |_, _| Some(Vec::new()),
            systematic_sd: |_, _, _| 0.0,
        }
    }
}

/// Equal steps above `low`.
pub(super) const fn steps_above<const N: usize>(low: f64, step: f64) -> [f64; N] {
    let mut grid = [0.0; N];
    let mut k = 0;
    while k < N {
        grid[k] = low + step * (k as f64 + 1.0);
        k += 1;
    }
    grid
}
