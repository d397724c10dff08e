//! Carries out the steps of a plan on any stage and interrogator, recording everything.

use crate::monitor::{Monitor, StreamCounts, lock};
use crate::plan::{Plan, Step};
use crate::recorder::Recorder;
use crate::rig::Rig;
pub use crate::steps::Progress;
pub use crate::steps::SweepBench;
use crate::steps::{Fault, SILENCE, Sweep, disk};
use std::collections::BTreeSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use wcal_core::deadline::Deadline;
use wcal_core::device::{DeviceError, DeviceErrorKind, Interrogator, Permission, StageReading};
use wcal_core::standstill::blame;

/// Pause of those who record until the sweep has heard of an interrupt.
pub(crate) const INTERRUPTED: Duration = Duration::from_millis(10);

/// How a sweep ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Ending {
    /// All steps done.
    Finished,
    /// Stopped by a fault or the user.
    Stopped {
        /// Why.
        cause: DeviceError,
        /// What became of the stage.
        stage: StageEnd,
    },
}

/// What became of the stage of a sweep that stopped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StageEnd {
    /// It stands, retracted from the wire.
    Retracted,
    /// It stands where it was stopped.
    Stands,
    /// It did not confirm its stop.
    Unknown,
}

impl StageEnd {
    /// Whether it was confirmed to stand.
    pub fn stands(self) -> bool {
        self != Self::Unknown
    }
}

/// Result of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepReport {
    /// How it ended.
    pub ending: Ending,
    /// Steps done in this run.
    pub done: usize,
    /// Windows whose drift gate did not open in time.
    pub unsettled: usize,
    /// Counters of the stream.
    pub counts: StreamCounts,
}

impl SweepReport {
    /// Losses and faults in spite of which the sweep continued; each is a reason for exit code 3.
    pub fn warnings(&self) -> Vec<String> {
        let StreamCounts {
            lost,
            gaps,
            pairs_refused,
            ..
        } = self.counts;
        let all = [
            (lost > 0, format!("{lost} scans lost in {gaps} gaps")),
            (
                pairs_refused > 0,
                format!("{pairs_refused} camera pairs refused"),
            ),
        ];
        let all = all.into_iter().filter(|(on, _)| *on).map(|(_, text)| text);
        all.chain(self.signal_warnings()).collect()
    }

    /// The warnings that do not follow from the recording alone.
    pub(crate) fn signal_warnings(&self) -> Vec<String> {
        let (unsettled, unusable) = (self.unsettled, self.counts.unusable);
        let all = [
            (
                unsettled > 0,
                format!("{unsettled} windows whose signal did not settle"),
            ),
            (
                unusable > 0,
                format!("{unusable} scans with a lost or crossing peak"),
            ),
        ];
        all.into_iter()
            .filter(|(on, _)| *on)
            .map(|(_, text)| text)
            .collect()
    }
}

/// A thread that records: one that panics is a fault that is reported to those who would wait for
/// it.
pub struct Watched<F: Fn(DeviceError)>(pub F);

impl<F: Fn(DeviceError)> Drop for Watched<F> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let (kind, found) = (
                DeviceErrorKind::CriticalFault,
                "a panic of the thread that records it (see above)",
            );
            let error = DeviceError::new(
                kind,
                "program",
                "record the stream",
                "a thread that goes on",
                found,
            );
            (self.0)(error);
        }
    }
}

/// Reads the stream until `done`, into monitor and recorder. Runs in its own thread.
pub fn acquire(
    interrogator: &mut dyn Interrogator,
    monitor: &Mutex<Monitor>,
    recorder: &Recorder,
    done: &AtomicBool,
) {
    let _watched = Watched(|e| lock(monitor).fail_with(e));
    if let Err(e) = interrogator
        .start()
        .and_then(|()| stream(interrogator, monitor, recorder, done))
    {
        lock(monitor).fail_with(e);
    }
    // The recording is complete; a unit that does not confirm the end changes nothing.
    let _ = interrogator.stop();
}

fn stream(
    interrogator: &mut dyn Interrogator,
    monitor: &Mutex<Monitor>,
    recorder: &Recorder,
    done: &AtomicBool,
) -> Result<(), DeviceError> {
    // From scan to scan; time in which this program itself stood still is not the unit's.
    let mut heard = Deadline::uninterruptible(SILENCE);
    while !done.load(Ordering::SeqCst) {
        // Silence is what a look after its end finds, too.
        let over = heard.is_over();
        // Short reads: `done` is heard soon after the sweep's end.
        let readings = match interrogator.read(Duration::from_millis(100)) {
            Ok(readings) => readings,
            // The sweep hears of it by itself; its way to a safe state is recorded, too.
            Err(e) if e.kind == DeviceErrorKind::Interrupted => {
                std::thread::sleep(INTERRUPTED);
                continue;
            }
            Err(e) => return Err(e),
        };
        // Recorded before it is tested: the scan that ends a sweep is in its recording, too.
        let mut recorded = Vec::with_capacity(readings.len());
        for reading in readings {
            if recorder.scan(&reading).map_err(|e| disk(&e))? {
                recorded.push(reading);
            }
        }
        if !recorded.is_empty() {
            heard = Deadline::uninterruptible(SILENCE);
        } else if over {
            let (kind, found) = (
                DeviceErrorKind::Timeout,
                format!("silence for {} s", SILENCE.as_secs()),
            );
            return Err(DeviceError::new(
                kind,
                "interrogator",
                "read the stream",
                "scans",
                found,
            ));
        }
        // Locked only now: a slow disk must not keep the sweep from its looks at the monitor.
        let mut monitor = lock(monitor);
        recorded.iter().for_each(|r| monitor.take(r));
    }
    Ok(())
}

/// Carries out `steps`, leaving out those in `skip`; `allowed`: what the user allows before the
/// first move.
pub fn run(
    bench: SweepBench<'_>,
    rig: &Rig,
    plan: &Plan,
    steps: &[Step],
    skip: &BTreeSet<u32>,
    allowed: Permission,
    progress: &mut dyn FnMut(&Progress),
) -> SweepReport {
    let mut sweep = Sweep {
        bench,
        rig,
        plan,
        steps: steps.len(),
        step: 0,
        trajectory: None,
        last: StageReading::default(),
        stands_mm: None,
        unsettled: 0,
        fault: Fault::Elsewhere,
        progress,
    };
    let mut done = 0;
    let result = sweep
        .prepare(allowed)
        .and_then(|()| sweep.all_steps(steps, skip, &mut done));
    // Every failure, and a user who wants an end, comes by here: nothing leaves a stage that moves.
    let ending = match result {
        Ok(()) => Ending::Finished,
        Err(cause) => {
            let cause = blame(cause);
            let stage = sweep.make_safe(&cause);
            Ending::Stopped { cause, stage }
        }
    };
    let counts = lock(sweep.bench.monitor).counts();
    SweepReport {
        ending,
        done,
        unsettled: sweep.unsettled,
        counts,
    }
}
