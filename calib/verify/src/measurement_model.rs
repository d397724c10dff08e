//! The measurement model that the statistics work on: measured values, a design whose coefficients
//! are free, effects, noise.
//!
//! ```text
//! Y = D(terms) B + noise          Y: readings x channels, D: design under the effects' values, B: coefficients, one column a channel
//! z = g(terms) + noise            z: a second witness, its covariance known, nothing in it free but the effects
//! ```
//!
//! [`crate::verify::SessionModel`] adds what the procedure asks of a kind of session: words,
//! predictions, folds, checks.

use crate::effect::{Effect, EffectTerm};
use crate::method::hypothesis::{Hypothesis, NotIdentified};
use crate::method::noise::{NoiseInputs, Weights};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// `values` as they are; none where one is not finite, which ends the candidate whose design needs
/// them.
pub(crate) fn finite<V: AsRef<[f64]>>(values: V) -> Option<V> {
    values
        .as_ref()
        .iter()
        .all(|v| v.is_finite())
        .then_some(values)
}

/// Design of `columns`, one value a reading each; none where one is not finite.
pub(crate) fn design_of(columns: &[Vec<f64>]) -> Option<DMatrix<f64>> {
    columns.iter().try_for_each(|c| finite(c).map(|_| ()))?;
    Some(DMatrix::from_fn(
        columns.first()?.len(),
        columns.len(),
        |i, j| columns[j][i],
    ))
}

/// A test of a part of the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DesignTest {
    /// Its level.
    pub level: f64,
    /// Length of a signature in that part.
    pub norm: f64,
    /// Degrees of freedom of what remains there.
    pub dof: f64,
}

/// A session seen through a declared model and a catalogue: what the loop works on.
///
/// The prediction is `design(terms) * B` with free coefficients B, one column a channel.
pub trait MeasurementModel: Sync {
    /// Measured values, readings x channels.
    fn measured(&self) -> &DMatrix<f64>;
    /// From the channels of [`MeasurementModel::measured`], whose noise is uncorrelated and of one
    /// variance, to those of the sensor: `sensor = measured * this`.
    fn channels_pm(&self) -> DMatrix<f64> {
        DMatrix::identity(self.measured().ncols(), self.measured().ncols())
    }
    /// From the noise in those channels to that of a value of the sensor: mean of the channels.
    fn noise_factor(&self) -> f64 {
        (self.channels_pm().norm_squared() / self.measured().ncols() as f64).sqrt()
    }
    /// Design matrix, readings x coefficients; none where the model has no solution at these
    /// values.
    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>>;
    /// The catalogue.
    fn catalogue(&self) -> &[Effect];
    /// Catalogue entry of single readings far outside the noise.
    fn outliers(&self) -> Option<usize> {
        self.catalogue().iter().position(|e| e.is_outlier_process)
    }
    /// Columns that make a smooth curve of the declared model, whatever bends it: what single
    /// readings are judged by before anything has a name.
    fn smooth_columns(&self) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// What a second witness leaves under `terms`: measured less predicted of observations whose
    /// covariance is known and that have no free coefficients (what cameras saw, beside the
    /// wavelengths), whitened to [`MeasurementModel::witness_variance`]. Values of readings that do
    /// not count are zero; empty where there is no second witness, none where the model has no
    /// solution.
    fn auxiliary_residual(
        &self,
        _terms: &[EffectTerm],
        _weights: &Weights,
    ) -> Option<DVector<f64>> {
        Some(DVector::zeros(0))
    }
    /// Reading to which each value of the second witness belongs.
    fn auxiliary_readings(&self) -> Arc<Vec<usize>> {
        Arc::default()
    }
    /// Variance of the second witness's whitened values: that of a typical reading, so that both
    /// are weighed alike.
    fn auxiliary_variance(&self) -> f64 {
        1.0
    }
    /// Its groups are repetitions of one task, so that what is omitted in turn judges each effect
    /// and what remains.
    fn cross_validates_terms(&self) -> bool {
        false
    }
    /// Standard deviation of what all readings share of a parameter and none of them shows (how two
    /// clocks are aligned), in its unit.
    fn systematic_sd(&self, _effect: usize, _parameter: &str) -> f64 {
        0.0
    }
    /// Why an effect cannot be seen in this session; none where it can.
    fn not_observable(&self, effect: usize) -> Option<String>;
    /// An effect of an explanation that cannot be distinguished from the design of the experiment
    /// itself: where readings repeat with the protocol, what repeats with them is no law of the
    /// clock, and a few places, or a single one, are no law of the stimulus.
    fn not_identified(&self, _h: &Hypothesis) -> Option<NotIdentified> {
        None
    }
    /// What the design of the experiment asks of a name beside the search: one of these tests of
    /// its `signature`, off what `h` takes up, must reject.
    fn design_tests(
        &self,
        _h: &Hypothesis,
        _term: &EffectTerm,
        _signature: &DVector<f64>,
    ) -> Vec<DesignTest> {
        Vec::new()
    }
    /// Names among [`MeasurementModel::covariates`] of which nothing is known: they are tried in
    /// every shape.
    fn further_columns(&self) -> &[String] {
        &[]
    }
    /// Group of each reading (trajectory, cycle); resampling keeps groups whole.
    fn groups(&self) -> &[u32];
    /// Covariates for finding what drives an unexplained residual: name and one value a reading.
    fn covariates(&self) -> Vec<(String, Vec<f64>)>;
    /// What the noise of the readings can depend on.
    fn noise_inputs(&self) -> NoiseInputs {
        NoiseInputs::none(self.measured().nrows())
    }
}
