//! Host time of readings, and from when on one is late.

use crate::shared_time::now_ns;
use std::time::{SystemTime, UNIX_EPOCH};

/// A reading that arrives this much later than others did (wall time) says that the bench, or this
/// computer, falls behind, s.
const LATE_WALL_S: f64 = 2.0;
/// On a bench faster than real time also one that is this late by the bench's own time: a virtual
/// bench remembers a minute of where its stage was, s.
const LATE_BENCH_S: f64 = 50.0;

/// Host clock: seconds since the Unix epoch, monotonic, and it goes on while the computer sleeps,
/// as the devices' clocks do; runs `scale` times as fast with an accelerated virtual bench.
#[derive(Debug, Clone, Copy)]
pub struct HostClock {
    start_ns: u64,
    start_epoch_s: f64,
    scale: f64,
}

impl HostClock {
    /// Starts at the system time.
    pub fn start(scale: f64) -> Self {
        let epoch = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        Self {
            start_ns: now_ns(),
            start_epoch_s: epoch.as_secs_f64(),
            scale,
        }
    }

    /// Now, s.
    pub fn now_s(&self) -> f64 {
        self.start_epoch_s + (now_ns() - self.start_ns) as f64 * 1e-9 * self.scale
    }

    /// Host seconds per wall second; 1 on a real bench.
    pub fn scale(&self) -> f64 {
        self.scale
    }
}

/// Lateness (bench time, s) from which on a reading is called late, on a bench that runs
/// `clock_scale` times as fast as real time.
pub fn late_s(clock_scale: f64) -> f64 {
    (LATE_WALL_S * clock_scale).min(LATE_BENCH_S)
}
