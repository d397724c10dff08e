//! The noise of a session in parts, and what it can depend on.
//!
//! ```text
//! n_i = s (h_i e_i + rho_c c(t_i) + rho_p g_i p_k(i))        (symbols: `whitening`)
//! h_i^2 = law_i^2 (c^2 + a_i) / (c^2 + 1)                    a_i: variance of the reading's own average, c: what averaging does not lower
//! var(reading at a repeated pose, another time) = s^2 (h^2 + rho_c^2 + rho_p^2)
//! ```

use super::inputs::NoiseInputs;
use super::spread_model::SpreadModel;
use super::tails::Tails;
use super::whitening::Weights;
use wcal_core::verify_document::NoisePart;

/// The noise of a model's residuals.
#[derive(Debug, Clone)]
pub struct Noise {
    /// Rows that count, their spread and what they share.
    pub weights: Weights,
    /// Repeat noise `s`: standard deviation of a typical loaded reading by itself, in the unit of
    /// the measured values.
    pub repeat: NoisePart,
    /// What setting a pose adds; none where nothing tells it from repeat noise.
    pub pose: Option<NoisePart>,
    /// Part correlated in time, and its time constant in units of the clock; none where the order
    /// in time is not known or none was found.
    pub correlated: Option<(NoisePart, f64)>,
    /// The spread's law.
    pub law: Option<SpreadModel>,
    /// Variance that averaging does not lower, beside 1 of a typical reading's average; 0 where all
    /// readings are averaged alike.
    pub common: f64,
    /// Tails of the standardised residuals.
    pub tails: Option<Tails>,
    /// Steps of the recorded values.
    pub step: Vec<Option<f64>>,
}

impl Noise {
    /// No noise at all, on `n` readings.
    pub fn none(n: usize) -> Self {
        let nothing = NoisePart {
            value: 0.0,
            interval95: [0.0; 2],
        };
        Self {
            weights: Weights::equal(n),
            repeat: nothing,
            pose: None,
            correlated: None,
            law: None,
            common: 0.0,
            tails: None,
            step: Vec::new(),
        }
    }

    /// The same noise with its shared parts at the upper ends of their intervals.
    pub(crate) fn at_upper_ends(&self) -> Self {
        let upper = |e: NoisePart| NoisePart {
            value: e.interval95[1].max(e.value),
            ..e
        };
        let pose = self.pose.filter(|p| p.value > 0.0).map(upper);
        Self {
            pose,
            correlated: self.correlated.map(|(e, tau)| (upper(e), tau)),
            ..self.clone()
        }
    }

    /// The same noise `times` as large.
    pub fn scaled(&self, times: f64) -> Self {
        let part = |e: NoisePart| NoisePart {
            value: e.value * times,
            interval95: e.interval95.map(|v| v * times),
        };
        let correlated = self.correlated.map(|(e, tau)| (part(e), tau));
        Self {
            repeat: part(self.repeat),
            pose: self.pose.map(part),
            correlated,
            ..self.clone()
        }
    }

    /// Weights of other readings of the same session (sealed ones among them) under this noise.
    pub(crate) fn weights_of(&self, inputs: &NoiseInputs) -> Weights {
        let own = self.law.as_ref().map_or_else(
            || vec![1.0; inputs.settings.len()],
            |l| l.relative_sd(inputs),
        );
        let relative = own
            .iter()
            .zip(inputs.own(self.common))
            .map(|(sd, known)| known / sd)
            .collect();
        // Whitening works in units of the repeat noise.
        let size = |e: &NoisePart| e.value / self.repeat.value;
        let correlated = self.correlated.as_ref().map(|(e, tau)| [size(e), *tau]);
        let pose = self
            .pose
            .as_ref()
            .filter(|p| p.value > 0.0)
            .map_or(0.0, size);
        Weights::sharing(relative, inputs.shared(correlated, pose))
    }

    /// Variance of what readings share, in units of the repeat noise's.
    pub(crate) fn shared_variance(&self) -> f64 {
        // Independent parts add in squares.
        let of = |e: &NoisePart| (e.value / self.repeat.value).powi(2);
        self.correlated.as_ref().map_or(0.0, |(e, _)| of(e)) + self.pose.as_ref().map_or(0.0, of)
    }

    /// Standard deviation of each of those readings at a repeated pose and at another time, in the
    /// unit of the measured values.
    pub fn reading_sd(&self, inputs: &NoiseInputs) -> Vec<f64> {
        let weights = self.weights_of(inputs);
        (0..inputs.settings.len())
            .map(|i| self.repeat.value * weights.total_sd(i))
            .collect()
    }
}
