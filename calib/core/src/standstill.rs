//! Time in which this program stood still: stopped by a signal, starved, or with a computer that
//! slept. It is no device's silence, and no part of a wait for one.
//!
//! A thread looks at the clock ten times a second. A look that comes a second late says that nobody
//! in this program could look.

use crate::device::{DeviceError, DeviceErrorKind};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Time between two looks.
const LOOK: Duration = Duration::from_millis(100);
/// A gap between looks that a busy computer does not make, ns.
const STILL_NS: u64 = 1_000_000_000;

/// What fails this soon after a gap fails because of it, ns: buffers have run over, or the other
/// side has given up.
const AFTER_NS: u64 = 10_000_000_000;

/// Looks at the clock.
struct Watch {
    /// Time of the latest look, ns.
    looked_ns: AtomicU64,
    /// Sum of the gaps, ns.
    still_ns: AtomicU64,
    /// Length of the latest gap and its end, ns.
    latest_ns: [AtomicU64; 2],
}

impl Watch {
    fn new(now_ns: u64) -> Self {
        let zero = || AtomicU64::new(0);
        Self {
            looked_ns: AtomicU64::new(now_ns),
            still_ns: zero(),
            latest_ns: [zero(), zero()],
        }
    }

    /// The gap since the latest look, where it is one, ns.
    fn gap_ns(&self, now_ns: u64) -> u64 {
        let gap_ns = now_ns.saturating_sub(self.looked_ns.load(Ordering::SeqCst));
        if gap_ns > STILL_NS { gap_ns } else { 0 }
    }

    fn look(&self, now_ns: u64) {
        // In this order: for a moment a gap may count twice, and never not at all.
        let gap_ns = self.gap_ns(now_ns);
        if gap_ns > 0 {
            self.still_ns.fetch_add(gap_ns, Ordering::SeqCst);
            self.latest_ns[0].store(gap_ns, Ordering::SeqCst);
            self.latest_ns[1].store(now_ns, Ordering::SeqCst);
        }
        self.looked_ns.store(now_ns, Ordering::SeqCst);
    }

    /// Whoever asks first after a gap hears of it, whether the thread has looked or not.
    fn total_ns(&self, now_ns: u64) -> u64 {
        self.still_ns.load(Ordering::SeqCst) + self.gap_ns(now_ns)
    }

    /// Length of a gap that ended a moment ago, ns; 0 where there was none.
    fn just_now_ns(&self, now_ns: u64) -> u64 {
        let [length, end] = [0, 1].map(|k| self.latest_ns[k].load(Ordering::SeqCst));
        let recent = length > 0 && now_ns.saturating_sub(end) < AFTER_NS;
        self.gap_ns(now_ns).max(if recent { length } else { 0 })
    }
}

/// Time since the computer started, its sleep included, ns.
pub fn now_ns() -> u64 {
    #[cfg(target_os = "linux")]
    {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
        u64::try_from(now.tv_sec).unwrap_or(0) * 1_000_000_000
            + u64::try_from(now.tv_nsec).unwrap_or(0)
    }
    #[cfg(not(target_os = "linux"))]
    {
        static START: OnceLock<std::time::Instant> = OnceLock::new();
        START
            .get_or_init(std::time::Instant::now)
            .elapsed()
            .as_nanos() as u64
    }
}

/// The watch of this program; none where its thread cannot be started: then nothing is known, and
/// nothing is taken off a wait.
fn watch() -> Option<&'static Watch> {
    static WATCH: OnceLock<Watch> = OnceLock::new();
    static THREAD: OnceLock<bool> = OnceLock::new();
    let watch = WATCH.get_or_init(|| Watch::new(now_ns()));
    let looks = || {
        let looker = move || {
            loop {
                std::thread::sleep(LOOK);
                watch.look(now_ns());
            }
        };
        std::thread::Builder::new()
            .name("standstill".to_owned())
            .spawn(looker)
            .is_ok()
    };
    THREAD.get_or_init(looks).then_some(watch)
}

/// How long this program has stood still since the first call.
pub fn total() -> Duration {
    watch().map_or(Duration::ZERO, |watch| {
        Duration::from_nanos(watch.total_ns(now_ns()))
    })
}

/// What a device reports: where this program has just stood still, that is said first, and no
/// device is blamed.
pub fn blame(error: DeviceError) -> DeviceError {
    use DeviceErrorKind::{Clock, DataInvalid, Disconnected, Protocol, Timeout};
    let still_ns = watch().map_or(0, |watch| watch.just_now_ns(now_ns()));
    // A blocked carriage or a lost peak has other reasons.
    let by_silence = [Timeout, Disconnected, Protocol, DataInvalid, Clock];
    if still_ns == 0 || !by_silence.contains(&error.kind) {
        return error;
    }
    let found = format!(
        "{:.1} s in which it stood still (stopped by a signal, or the computer slept); then {error}",
        Duration::from_nanos(still_ns).as_secs_f64()
    );
    DeviceError::new(error.kind, "this program", "wait", "to run on", found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_counts_once_and_a_busy_second_does_not() {
        let watch = Watch::new(0);
        let second = 1_000_000_000;
        watch.look(second / 2);
        watch.look(second);
        assert_eq!(watch.total_ns(second + second / 2), 0, "negative control");
        assert_eq!(
            watch.total_ns(8 * second),
            7 * second,
            "before the thread has looked"
        );
        watch.look(8 * second);
        assert_eq!(watch.total_ns(8 * second), 7 * second, "and after");
        watch.look(8 * second + second / 10);
        assert_eq!(watch.total_ns(9 * second), 7 * second);
        // What fails soon afterwards is no device's fault, what fails later may be.
        assert_eq!(watch.just_now_ns(9 * second), 7 * second);
        (81..300).for_each(|k| watch.look(k * second / 10));
        assert_eq!(watch.just_now_ns(30 * second), 0);
    }
}
