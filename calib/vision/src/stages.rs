//! Processor time of the stages of `stereo-shape`: what a pair costs on one core, whatever else the machine does.

use rustix::time::{ClockId, clock_gettime};
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

/// A stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Files to grey values.
    Reading,
    /// Tags and their corners.
    Tags,
    /// The search for the wire.
    Search,
    /// The curve through the wire's pieces.
    Fit,
    /// What the folder's pairs share, uncertainties, groove.
    Joint,
}

/// Names in the order of [`Stage`].
const NAMES: [&str; 5] = ["reading", "tags", "search", "fit", "joint"];

/// Processor time by stage, summed over pairs and threads.
#[derive(Debug, Default)]
pub struct StageClock {
    nanoseconds: [AtomicU64; NAMES.len()],
}

fn now(clock: ClockId) -> u64 {
    let t = clock_gettime(clock);
    t.tv_sec.unsigned_abs() * 1_000_000_000 + t.tv_nsec.unsigned_abs()
}

impl StageClock {
    /// Work of the calling thread alone.
    pub fn time<T>(&self, stage: Stage, work: impl FnOnce() -> T) -> T {
        self.add(stage, ClockId::ThreadCPUTime, work)
    }

    /// Work that is spread over threads while nothing else runs.
    pub fn time_alone<T>(&self, stage: Stage, work: impl FnOnce() -> T) -> T {
        self.add(stage, ClockId::ProcessCPUTime, work)
    }

    fn add<T>(&self, stage: Stage, clock: ClockId, work: impl FnOnce() -> T) -> T {
        let start = now(clock);
        let done = work();
        self.nanoseconds[stage as usize].fetch_add(now(clock).saturating_sub(start), Ordering::Relaxed);
        done
    }

    /// Seconds by stage: name and time.
    #[must_use]
    pub fn seconds(&self) -> [(&'static str, f64); NAMES.len()] {
        std::array::from_fn(|k| (NAMES[k], self.nanoseconds[k].load(Ordering::Relaxed) as f64 * 1e-9))
    }
}

impl fmt::Display for StageClock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, (name, seconds)) in self.seconds().into_iter().enumerate() {
            write!(f, "{}{name} {seconds:.4} s", if k > 0 { ", " } else { "" })?;
        }
        Ok(())
    }
}
