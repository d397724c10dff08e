//! What the noise of a session's readings can depend on.

use super::whitening::{SharedNoise, Weights};
use std::sync::Arc;

/// Variance of an average up to which it is as good as a typical one.
const TYPICAL: f64 = 2.0;

/// What the noise of a session's readings can depend on.
#[derive(Debug, Clone, Default)]
pub struct NoiseInputs {
    /// Clock of the readings, rising; none where their order in time is not known.
    pub clock: Option<Arc<Vec<f64>>>,
    /// The clock counts readings, not seconds.
    pub counts_readings: bool,
    /// Number of the pose setting of each reading.
    pub settings: Arc<Vec<usize>>,
    /// Whether a pose is set at all (not at rest).
    pub posed: Arc<Vec<bool>>,
    /// Covariates that the spread may follow: name and values.
    pub spread: Vec<(String, Vec<f64>)>,
    /// 1 / relative standard deviation that is known beforehand (few samples averaged).
    pub known: Vec<f64>,
    /// Variance that each reading's average has by its number of samples, 1 for a typical settled
    /// one; empty where all are alike.
    pub averaged: Vec<f64>,
    /// Step of the recorded values in each channel, in the unit of the measured values; none where
    /// they are not rounded coarsely.
    pub step: Vec<Option<f64>>,
}

impl NoiseInputs {
    /// Unit of the clock.
    pub(crate) fn clock_unit(&self) -> &'static str {
        if self.counts_readings || self.clock.is_none() {
            "readings"
        } else {
            "s"
        }
    }

    /// Readings of which nothing is known.
    pub fn none(n: usize) -> Self {
        Self {
            clock: None,
            counts_readings: false,
            settings: Arc::new((0..n).collect()),
            posed: Arc::new(vec![true; n]),
            spread: Vec::new(),
            known: vec![1.0; n],
            averaged: Vec::new(),
            step: Vec::new(),
        }
    }

    /// 1 / relative standard deviation of readings by themselves, where the part that averaging
    /// does not lower has the variance `common` beside 1 of a typical reading's average.
    pub fn own(&self, common: f64) -> Vec<f64> {
        if self.averaged.is_empty() {
            return self.known.clone();
        }
        // The variance of the module of parts: (c^2 + a) / (c^2 + 1).
        let of = |(known, a): (&f64, &f64)| known * ((common + 1.0) / (common + a)).sqrt();
        self.known.iter().zip(&self.averaged).map(of).collect()
    }

    /// Readings of typical averaging: what the floor is stated for.
    pub fn typical(&self, reading: usize) -> bool {
        self.averaged.get(reading).is_none_or(|a| *a <= TYPICAL)
    }

    pub(super) fn shared(&self, correlated: Option<[f64; 2]>, pose: f64) -> SharedNoise {
        let n = self.settings.len();
        let clock = self
            .clock
            .clone()
            .unwrap_or_else(|| Arc::new((0..n).map(|k| k as f64).collect()));
        SharedNoise {
            clock,
            settings: self.settings.clone(),
            posed: self.posed.clone(),
            correlated,
            pose,
        }
    }

    /// Readings beyond the first of each pose setting: what tells pose scatter from repeat noise.
    pub(crate) fn held_repeats(&self, weights: &Weights) -> usize {
        let mut last = None;
        let mut count = 0;
        for i in (0..self.settings.len()).filter(|&i| weights.counts(i) && self.posed[i]) {
            // A repeat is a reading without a movement since the one before.
            count += usize::from(last == Some(self.settings[i]));
            last = Some(self.settings[i]);
        }
        count
    }
}
