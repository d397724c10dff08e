//! Time that a virtual bench shares with the programs at it: it stands while a part of the bench
//! cannot run, on a busy computer.
//!
//! Without a virtual bench it is the computer's: a real device does not wait.
//!
//! ```text
//! w time of the computer, h for how long the bench's time stood, b oldest sign of life of its parts
//! granted: g = b + ALIVE - h        now = max(min(w - h, g), w - h - GONE)
//! ```

use crate::standstill::now_ns as computer_ns;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A part is waited for when its last sign of life is this old, ns: more than a busy computer
/// delays a thread.
const ALIVE_NS: u64 = 250_000_000;
/// A part that has been waited for this long has gone.
pub const GONE: Duration = Duration::from_secs(20);
const GONE_NS: u64 = GONE.as_nanos() as u64;
/// Between two signs of life of a part that pauses.
const SIGN: Duration = Duration::from_millis(5);

/// When a part last gave a sign of life, ns.
type Part = Arc<AtomicU64>;

/// What of the computer's time has passed for the bench.
struct Time {
    stood_ns: u64,
    granted_ns: u64,
    /// It never goes back.
    latest_ns: u64,
    parts: Vec<Part>,
}

impl Time {
    const REAL: Self = Self {
        stood_ns: 0,
        granted_ns: u64::MAX,
        latest_ns: 0,
        parts: Vec::new(),
    };

    fn now_ns(&mut self, computer_ns: u64) -> u64 {
        let running_ns = computer_ns.saturating_sub(self.stood_ns);
        let now_ns = running_ns
            .min(self.granted_ns)
            .max(running_ns.saturating_sub(GONE_NS));
        self.latest_ns = self.latest_ns.max(now_ns);
        self.latest_ns
    }

    /// A part that lived until then, or that ends; what it has held up stays lost.
    fn sign(&mut self, computer_ns: u64, part: &Part, until_ns: Option<u64>) {
        let now_ns = self.now_ns(computer_ns);
        self.stood_ns = computer_ns.saturating_sub(now_ns);
        self.parts.retain(|other| !Arc::ptr_eq(other, part));
        if let Some(until_ns) = until_ns {
            part.store(until_ns, Ordering::SeqCst);
            self.parts.push(Arc::clone(part));
        }
        let last_ns = self.parts.iter().map(|part| part.load(Ordering::SeqCst));
        let oldest_ns = last_ns
            .filter(|last_ns| computer_ns.saturating_sub(*last_ns) < GONE_NS)
            .min();
        self.granted_ns = oldest_ns.map_or(u64::MAX, |last_ns| {
            (last_ns + ALIVE_NS).saturating_sub(self.stood_ns)
        });
    }
}

static TIME: Mutex<Time> = Mutex::new(Time::REAL);

fn time() -> MutexGuard<'static, Time> {
    TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A thread of the bench, until it ends.
#[derive(Default)]
struct OwnPart(Part);

impl Drop for OwnPart {
    fn drop(&mut self) {
        time().sign(computer_ns(), &self.0, None);
    }
}

thread_local! {
    static OWN: OwnPart = OwnPart::default();
}

/// This thread is a part of a virtual bench, runs, and is `behind` with its work. It must say so
/// again soon, until it ends.
pub fn lives(behind: Duration) {
    OWN.with(|own| {
        // In this order: a clock that was read before waiting for the others is behind theirs.
        let mut time = time();
        let computer_ns = computer_ns();
        let until_ns = computer_ns.saturating_sub(behind.as_nanos() as u64);
        time.sign(computer_ns, &own.0, Some(until_ns));
    });
}

/// A part of the bench pauses.
pub fn pause(pause: Duration) {
    let end_ns = now_ns() + pause.as_nanos() as u64;
    while now_ns() < end_ns {
        lives(Duration::ZERO);
        std::thread::sleep(SIGN);
    }
}

/// Now, ns since the computer started.
pub fn now_ns() -> u64 {
    time().now_ns(computer_ns())
}

/// For how long it has stood.
pub fn stood() -> Duration {
    Duration::from_nanos(time().stood_ns)
}

/// For another program on this computer: how long the time stood, and up to where it may run, ns.
pub fn state_ns() -> [u64; 2] {
    let time = time();
    [time.stood_ns, time.granted_ns]
}

/// Goes by the time of a bench that another program serves, or by the computer's again.
pub fn follow(state_ns: Option<[u64; 2]>) {
    let mut time = time();
    time.granted_ns = state_ns.map_or(u64::MAX, |[_, granted_ns]| granted_ns);
    time.stood_ns = state_ns.map_or(time.stood_ns, |[stood_ns, _]| stood_ns);
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn time_stands_while_a_part_does_not_run_and_never_goes_back() {
        let mut real = Time::REAL;
        assert_eq!(
            real.now_ns(77_000 * MS),
            77_000 * MS,
            "control: without a bench"
        );
        let mut time = Time::REAL;
        let (scanner, server) = (Part::default(), Part::default());
        let run = |time: &mut Time, from: u64, to: u64, parts: &[&Part]| {
            for ms in (from..to).step_by(20) {
                parts
                    .iter()
                    .for_each(|part| time.sign(ms * MS, part, Some(ms * MS)));
            }
        };
        run(&mut time, 0, 1000, &[&scanner, &server]);
        assert_eq!(
            (time.now_ns(1000 * MS), time.stood_ns),
            (1000 * MS, 0),
            "control: both run"
        );
        // The scanner stands from 1 s to 4 s: time does, too, and both go on from there.
        run(&mut time, 1000, 4000, &[&server]);
        let stands = time.now_ns(4000 * MS);
        assert_eq!(stands, (980 + 250) * MS);
        run(&mut time, 4000, 5000, &[&scanner, &server]);
        assert_eq!(time.now_ns(5000 * MS), stands + 1000 * MS);
        // Further and further behind with its work: it never goes back.
        let mut last = time.now_ns(5000 * MS);
        for ms in (5000..6000).step_by(20) {
            time.sign(ms * MS, &server, Some(ms * MS));
            time.sign(ms * MS, &scanner, Some((ms - (ms - 5000) / 2 * 3) * MS));
            let now = time.now_ns(ms * MS);
            assert!(now >= last, "{now} after {last}");
            last = now;
        }
        assert!(last < stands + 1300 * MS, "{last}");
        // Who never comes back is not waited for, whether others ask or nobody does; nor is one
        // that has ended.
        run(&mut time, 6000, 40_000, &[&server]);
        let waited = time.now_ns(40_000 * MS);
        assert!(waited > last + 10_000 * MS);
        assert!(time.now_ns(90_000 * MS) > waited + 20_000 * MS);
        time.sign(90_000 * MS, &server, None);
        let last = time.now_ns(90_000 * MS);
        assert_eq!(time.now_ns(91_000 * MS), last + 1000 * MS);
    }
}
