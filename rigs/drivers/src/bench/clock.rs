//! Time of the virtual bench: wall time, or a multiple of it.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Bench time in seconds since the bench started.
#[derive(Debug, Clone, Copy)]
pub struct BenchClock {
    start: Instant,
    start_epoch_s: f64,
    speed: f64,
}

impl BenchClock {
    /// Starts now and runs `speed` times as fast as wall time.
    #[must_use]
    pub fn start(speed: f64) -> Self {
        let epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { start: Instant::now(), start_epoch_s: epoch.as_secs_f64(), speed }
    }

    /// Bench time, s.
    #[must_use]
    pub fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64() * self.speed
    }

    /// Bench time as seconds since the Unix epoch at which the bench started.
    #[must_use]
    pub fn epoch_s(&self, t_s: f64) -> f64 {
        self.start_epoch_s + t_s
    }

    /// Wall time that `bench_s` seconds of bench time take.
    #[must_use]
    pub fn wall(&self, bench_s: f64) -> Duration {
        Duration::from_secs_f64((bench_s / self.speed).max(0.0))
    }

    /// Bench seconds per wall second.
    #[must_use]
    pub fn speed(&self) -> f64 {
        self.speed
    }
}
