//! What a bench adds to the moments of a simulated course: white noise, an error of each gain, a drift of each zero.

use super::TrainSettings;
use crate::Course;
use crate::bayes::Filters;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Share of courses without noise and drift.
const CLEAN: f64 = 0.4;
/// Time after which the filter is told how far the zero went, s.
const DRIFTED_S: f64 = 10.0;

/// Evenly between two bounds.
pub(crate) fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// A bench.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bench {
    noise_nmm: f64,
    gain: [f64; 2],
    drift_nmm_s: [f64; 2],
}

impl Bench {
    /// Draws one: some leave a course as the twin made it, but for the gains; of the others small noise is drawn more often.
    pub fn draw(settings: &TrainSettings, rng: &mut ChaCha8Rng) -> Self {
        let clean = between(rng, 0.0, 1.0) < CLEAN;
        let noise_nmm = if clean { 0.0 } else { settings.noise_nmm * between(rng, 0.0, 1.0).powi(2) };
        let gain = std::array::from_fn(|_| 1.0 + settings.gain * between(rng, -1.0, 1.0));
        let drift = std::array::from_fn(|_| settings.drift_nmm_s * between(rng, -1.0, 1.0));
        Self { noise_nmm, gain, drift_nmm_s: if clean { [0.0; 2] } else { drift } }
    }

    /// Filters told of it.
    pub fn told(&self, filters: Filters) -> Filters {
        let [y, z] = self.drift_nmm_s;
        filters.told(self.noise_nmm, y.hypot(z) * DRIFTED_S)
    }

    /// A moment (N mm) as the bench gives it.
    pub fn felt(&self, moment_nmm: [f64; 2], t_s: f64, rng: &mut ChaCha8Rng) -> [f64; 2] {
        // As wide as noise of that standard deviation.
        let mut noise = || self.noise_nmm * 3.0_f64.sqrt() * between(rng, -1.0, 1.0);
        [0, 1].map(|i| moment_nmm[i] * self.gain[i] + self.drift_nmm_s[i] * t_s + noise())
    }

    /// A course as the bench gives it.
    pub fn course(&self, course: &Course, rng: &mut ChaCha8Rng) -> Course {
        let mut felt = course.clone();
        for i in &mut felt.instants {
            i.moment_nmm = self.felt(i.moment_nmm, i.t_s, rng);
        }
        felt
    }
}
