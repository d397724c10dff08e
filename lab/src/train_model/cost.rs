//! What a training takes: wall and processor time.

use crate::dataset::process_s;
use crate::train::settings::Pass;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Add;
use std::time::Instant;

/// Time of a piece of work.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Seconds {
    /// By the clock, s.
    pub wall_s: f64,
    /// Of the processor, all threads together, s.
    pub cpu_s: f64,
}

impl Add for Seconds {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            wall_s: self.wall_s + other.wall_s,
            cpu_s: self.cpu_s + other.cpu_s,
        }
    }
}

/// What a model took to make.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrainingCost {
    /// The sweeps, where the same command made them: processor time of all shards, wall time of the
    /// run that made the last of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweeps: Option<Seconds>,
    /// The training with the calibration of its regions; passes of earlier runs included.
    pub training: Seconds,
    /// Threads.
    pub cores: usize,
}

/// Time since a beginning.
pub(super) struct Stopwatch {
    begin: Instant,
    begin_cpu_s: f64,
}

impl Stopwatch {
    pub(crate) fn start() -> Self {
        Self {
            begin: Instant::now(),
            begin_cpu_s: process_s(),
        }
    }

    pub(crate) fn elapsed(&self) -> Seconds {
        Seconds {
            wall_s: self.begin.elapsed().as_secs_f64(),
            cpu_s: process_s() - self.begin_cpu_s,
        }
    }
}

/// Time of the passes, all runs together.
pub(super) fn of_passes(passes: &[Pass]) -> Seconds {
    passes.last().map_or_else(Seconds::default, |p| Seconds {
        wall_s: p.seconds,
        cpu_s: p.cpu_s.unwrap_or(0.0),
    })
}
