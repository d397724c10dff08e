//! What a sensor adds to the moments of a simulated series: white noise, an error of each gain, a
//! drift of each zero.
//!
//! `m'_i = (1 + g_i) m_i + d_i t + e`, g and d uniform within their bounds, e uniform with standard
//! deviation s, `s = s_max u^2`, u uniform; a fraction of the series has neither noise nor drift.

use super::settings::TrainSettings;
use crate::sweep_series::SweepSeries;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use wcal_network::filter::FilterBank;

/// Share of series without noise and drift.
const CLEAN_FRACTION: f64 = 0.4;
/// Age of the zero, s: the drift over it enters the filters' measurement noise.
const ZERO_AGE_S: f64 = 10.0;

/// Evenly between two bounds.
pub(crate) fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// Errors of the sensor of one bench.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SensorErrors {
    noise_nmm: f64,
    gain: [f64; 2],
    drift_nmm_s: [f64; 2],
}

impl SensorErrors {
    /// Draws one: some change the gains of a simulated series only; of the others small noise is
    /// drawn more often.
    pub(crate) fn draw(settings: &TrainSettings, rng: &mut ChaCha8Rng) -> Self {
        let clean = uniform(rng, 0.0, 1.0) < CLEAN_FRACTION;
        let noise_nmm = if clean {
            0.0
        } else {
            settings.noise_nmm * uniform(rng, 0.0, 1.0).powi(2)
        };
        let gain = std::array::from_fn(|_| 1.0 + settings.gain * uniform(rng, -1.0, 1.0));
        let drift = std::array::from_fn(|_| settings.drift_nmm_s * uniform(rng, -1.0, 1.0));
        Self {
            noise_nmm,
            gain,
            drift_nmm_s: if clean { [0.0; 2] } else { drift },
        }
    }

    /// Filters with this measurement noise.
    pub(crate) fn with_measurement_noise(&self, filters: FilterBank) -> FilterBank {
        let [y, z] = self.drift_nmm_s;
        filters.with_measurement_noise(self.noise_nmm, y.hypot(z) * ZERO_AGE_S)
    }

    /// A moment (N mm) as the sensor measures it.
    pub(crate) fn measured(
        &self,
        moment_nmm: [f64; 2],
        t_s: f64,
        rng: &mut ChaCha8Rng,
    ) -> [f64; 2] {
        // Uniform noise of this standard deviation has the half width sqrt(3) sd.
        let mut noise = || self.noise_nmm * 3.0_f64.sqrt() * uniform(rng, -1.0, 1.0);
        [0, 1].map(|i| moment_nmm[i] * self.gain[i] + self.drift_nmm_s[i] * t_s + noise())
    }

    /// A series as the sensor measures it.
    pub(crate) fn apply(&self, series: &SweepSeries, rng: &mut ChaCha8Rng) -> SweepSeries {
        let mut measured = series.clone();
        for i in &mut measured.samples {
            i.moment_nmm = self.measured(i.moment_nmm, i.t_s, rng);
        }
        measured
    }
}
