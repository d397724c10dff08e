//! The law of the spread: how the standard deviation of single readings follows a covariate.
//!
//! ```text
//! h(v) = exp(b (v - v0)),   v0: the covariate at a typical loaded reading        (Harvey, Econometrica 44, 1976: multiplicative)
//! ```

use super::inputs::NoiseInputs;
use super::likelihood::{MeanModel, restricted_likelihood, studentised_by_channel};
use super::spread::{Spread, heteroscedasticity_test, relative_sd};
use super::whitening::Weights;
use crate::levels::SPREAD;
use wcal_core::order_statistics::median;

/// Permutations of the test of the spread.
const PERMUTATIONS: usize = 3999;

/// How the spread of single readings follows a covariate: `h = exp(b (v - typical))`.
#[derive(Debug, Clone)]
pub struct SpreadModel {
    /// Covariate, by its name in [`NoiseInputs::spread`].
    pub follows: String,
    /// Test and exponent b.
    pub spread: Spread,
    /// The covariate at a typical loaded reading.
    pub typical: f64,
}

impl SpreadModel {
    /// Relative standard deviations of readings.
    pub(crate) fn relative_sd(&self, inputs: &NoiseInputs) -> Vec<f64> {
        let values = inputs
            .spread
            .iter()
            .find(|(name, _)| *name == self.follows)
            .map(|(_, v)| v);
        let of = |v: &f64| relative_sd(self.spread.exponent, v - self.typical);
        values.map_or_else(
            || vec![1.0; inputs.settings.len()],
            |v| v.iter().map(of).collect(),
        )
    }
}

/// The covariate that the spread follows, where it follows one beyond chance.
pub(super) fn fit_variance_function(
    model: &MeanModel,
    inputs: &NoiseInputs,
    weights: &Weights,
    seed: u64,
) -> Option<SpreadModel> {
    if inputs.spread.is_empty() {
        return None;
    }
    let rows = studentised_by_channel(model, weights, 1.0);
    let channels = model.residual.ncols();
    let mut best: Option<(f64, SpreadModel)> = None;
    for (name, values) in &inputs.spread {
        let u: Vec<f64> = rows
            .iter()
            .flat_map(|(i, _)| vec![values[*i]; channels])
            .collect();
        let z: Vec<f64> = rows.iter().flat_map(|(_, z)| z.clone()).collect();
        // The power law needs its own stimulus: here the spread is exponential in the covariate.
        let Some(spread) = heteroscedasticity_test(&z, None, &u, PERMUTATIONS, seed) else {
            continue;
        };
        // Bonferroni over the covariates.
        if spread.p_value > SPREAD / inputs.spread.len() as f64 {
            continue;
        }
        // 1 for a typical loaded reading.
        let loaded = (0..values.len())
            .filter(|&i| inputs.posed[i])
            .map(|i| values[i]);
        let typical = median(loaded).unwrap_or(0.0);
        let law = SpreadModel {
            follows: name.clone(),
            spread,
            typical,
        };
        let own = law.relative_sd(inputs);
        let relative = (0..values.len()).map(|i| {
            if weights.counts(i) {
                weights.of(i) / own[i]
            } else {
                0.0
            }
        });
        let cost =
            restricted_likelihood(model, &Weights::independent(relative.collect()))?.restricted;
        if best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, law));
        }
    }
    best.map(|(_, law)| law)
}
