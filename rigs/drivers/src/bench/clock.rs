//! Time of the virtual bench: wall time, a multiple of it, or as it is let pass.

use super::lock::guard;
use std::sync::Mutex;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use wcal_core::shared_time::now_ns;

/// What makes the time pass.
#[derive(Debug)]
enum Pace {
    /// The wall's clock while all parts of the bench run, from this time on, ns.
    Wall(u64),
    /// Whoever lets it pass: bench time, s.
    Let(Mutex<f64>),
}

/// Bench time in seconds since the bench started.
#[derive(Debug)]
pub struct BenchClock {
    pace: Pace,
    start_epoch_s: f64,
    speed: f64,
}

fn epoch_s() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
        .as_secs_f64()
}

impl BenchClock {
    /// Starts now and runs `speed` times as fast as wall time.
    pub fn start(speed: f64) -> Self {
        Self {
            pace: Pace::Wall(now_ns()),
            start_epoch_s: epoch_s(),
            speed,
        }
    }

    /// Stands until its time is let pass.
    pub fn standing() -> Self {
        Self {
            pace: Pace::Let(Mutex::new(0.0)),
            start_epoch_s: epoch_s(),
            speed: 1.0,
        }
    }

    /// Lets time pass, s; nothing where the wall's clock does.
    pub fn pass(&self, seconds: f64) {
        if let Pace::Let(now_s) = &self.pace {
            *guard(now_s) += seconds;
        }
    }

    /// Bench time, s.
    pub fn now_s(&self) -> f64 {
        match &self.pace {
            Pace::Wall(start_ns) => (now_ns() - start_ns) as f64 * 1e-9 * self.speed,
            Pace::Let(now_s) => *guard(now_s),
        }
    }

    /// Bench time as seconds since the Unix epoch at which the bench started.
    pub fn epoch_s(&self, t_s: f64) -> f64 {
        self.start_epoch_s + t_s
    }

    /// Wall time that `bench_s` seconds of bench time take.
    pub fn wall(&self, bench_s: f64) -> Duration {
        Duration::from_secs_f64((bench_s / self.speed).max(0.0))
    }

    /// Bench seconds per wall second.
    pub fn speed(&self) -> f64 {
        self.speed
    }
}
