//! The noise of a session in parts, and what it can depend on.
//!
//! ```text
//! n_i = s (h_i e_i + rho_c c(t_i) + rho_p g_i p_k(i))        (symbols: `whitening`)
//! h_i^2 = law_i^2 (c^2 + a_i) / (c^2 + 1)                    a_i: variance of the reading's own average, c: what averaging does not lower
//! var(reading at a pose set anew, another time) = s^2 (h^2 + rho_c^2 + rho_p^2)
//! ```

use super::spread_model::SpreadModel;
use super::tails::Tails;
use super::whitening::{SharedNoise, Weights};
use std::sync::Arc;
use wcal_core::verify_document::NoisePart;

/// Variance of an average up to which it is as good as a typical one.
const TYPICAL: f64 = 2.0;

/// What the noise of a session's readings can depend on.
#[derive(Debug, Clone, Default)]
pub struct NoiseInputs {
    /// Clock of the readings, rising; none where their order in time is not known.
    pub clock: Option<Arc<Vec<f64>>>,
    /// Number of the pose setting of each reading.
    pub settings: Arc<Vec<usize>>,
    /// Whether a pose is set at all (not at rest).
    pub posed: Arc<Vec<bool>>,
    /// Covariates that the spread may follow: name and values.
    pub spread: Vec<(String, Vec<f64>)>,
    /// 1 / relative standard deviation that is known beforehand (few samples averaged).
    pub known: Vec<f64>,
    /// Variance that each reading's average has by its number of samples, 1 for a typical settled one; empty where all are alike.
    pub averaged: Vec<f64>,
    /// Step of the recorded values in each channel, in the unit of the measured values; none where they are not rounded coarsely.
    pub step: Vec<Option<f64>>,
}

impl NoiseInputs {
    /// Readings of which nothing is known.
    pub fn none(n: usize) -> Self {
        Self {
            clock: None,
            settings: Arc::new((0..n).collect()),
            posed: Arc::new(vec![true; n]),
            spread: Vec::new(),
            known: vec![1.0; n],
            averaged: Vec::new(),
            step: Vec::new(),
        }
    }

    /// 1 / relative standard deviation of readings by themselves, where the part that averaging does not lower has the variance `common`
    /// beside 1 of a typical reading's average.
    pub fn own(&self, common: f64) -> Vec<f64> {
        if self.averaged.is_empty() {
            return self.known.clone();
        }
        let of = |(known, a): (&f64, &f64)| known * ((common + 1.0) / (common + a)).sqrt();
        self.known.iter().zip(&self.averaged).map(of).collect()
    }

    /// Readings of typical averaging: what the floor is stated for.
    pub fn typical(&self, reading: usize) -> bool {
        self.averaged.get(reading).is_none_or(|a| *a <= TYPICAL)
    }

    pub(super) fn shared(&self, correlated: Option<[f64; 2]>, pose: f64) -> SharedNoise {
        let n = self.settings.len();
        let clock = self.clock.clone().unwrap_or_else(|| Arc::new((0..n).map(|k| k as f64).collect()));
        SharedNoise { clock, settings: self.settings.clone(), posed: self.posed.clone(), correlated, pose }
    }

    /// Readings beyond the first of each pose setting: what tells pose scatter from repeat noise.
    pub fn held_repeats(&self, weights: &Weights) -> usize {
        let mut last = None;
        let mut count = 0;
        for i in (0..self.settings.len()).filter(|&i| weights.counts(i) && self.posed[i]) {
            count += usize::from(last == Some(self.settings[i]));
            last = Some(self.settings[i]);
        }
        count
    }
}

/// The noise of a model's residuals.
#[derive(Debug, Clone)]
pub struct Noise {
    /// Rows that count, their spread and what they share.
    pub weights: Weights,
    /// Repeat noise `s`: standard deviation of a typical loaded reading by itself, in the unit of the measured values.
    pub repeat: NoisePart,
    /// What setting a pose adds; none where nothing tells it from repeat noise.
    pub pose: Option<NoisePart>,
    /// Part correlated in time, and its time constant in units of the clock; none where the order in time is not known or none was found.
    pub correlated: Option<(NoisePart, f64)>,
    /// The spread's law.
    pub law: Option<SpreadModel>,
    /// Variance that averaging does not lower, beside 1 of a typical reading's average; 0 where all readings are averaged alike.
    pub common: f64,
    /// Tails of the standardised residuals.
    pub tails: Option<Tails>,
    /// Steps of the recorded values.
    pub step: Vec<Option<f64>>,
}

impl Noise {
    /// No noise at all, on the readings of `other`.
    pub fn none(other: &Self) -> Self {
        let nothing = NoisePart { value: 0.0, interval95: [0.0; 2] };
        let weights = Weights::independent(vec![1.0; other.weights.relative().len()]);
        Self {
            weights,
            repeat: nothing,
            pose: None,
            correlated: None,
            law: None,
            common: 0.0,
            tails: None,
            step: Vec::new(),
        }
    }

    /// Weights of other readings of the same session (sealed ones among them) under this noise; `upper` takes the upper ends of the shared
    /// parts' intervals.
    pub fn weights_of(&self, inputs: &NoiseInputs, upper: bool) -> Weights {
        let own =
            self.law.as_ref().map_or_else(|| vec![1.0; inputs.settings.len()], |l| l.relative_sd(inputs));
        let relative = own.iter().zip(inputs.own(self.common)).map(|(sd, known)| known / sd).collect();
        let size =
            |e: &NoisePart| if upper { e.interval95[1].max(e.value) } else { e.value } / self.repeat.value;
        let correlated = self.correlated.as_ref().map(|(e, tau)| [size(e), *tau]);
        let pose = self.pose.as_ref().filter(|p| p.value > 0.0).map_or(0.0, size);
        Weights::sharing(relative, inputs.shared(correlated, pose))
    }

    /// Variance of what readings share, in units of the repeat noise's.
    pub fn shared_variance(&self) -> f64 {
        let of = |e: &NoisePart| (e.value / self.repeat.value).powi(2);
        self.correlated.as_ref().map_or(0.0, |(e, _)| of(e)) + self.pose.as_ref().map_or(0.0, of)
    }

    /// Standard deviation of each of those readings at a pose set anew and at another time, in the unit of the measured values.
    pub fn reading_sd(&self, inputs: &NoiseInputs) -> Vec<f64> {
        let weights = self.weights_of(inputs, false);
        (0..inputs.settings.len()).map(|i| self.repeat.value * weights.total_sd(i)).collect()
    }
}
