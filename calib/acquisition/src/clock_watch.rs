//! The clock of a stream: one that steps or stands still, distinguished from a device or a computer
//! that is late; and the readings before, by which alone the clocks are aligned.
//!
//! ```text
//! x host time, y device time less x, n scans since the last good one, p time of a scan by the device's own clock
//! off by S:    device time rises by n p + S over the last good scan, |S| above the tolerance, and stays off for some scans
//! step back:   S < 0: no delay does that
//! step ahead:  S > 0, and some y > max of all y before + S / 2: readings would have come before they were made
//! stopped:     scans come for seconds of host time, and device time does not rise
//! ```
//!
//! A gap in the stream whose scans were not counted raises device and host time alike: y stays
//! below its earlier maximum. A single wrong stamp is off for its own scan only.

use crate::clocks::ClockPair;
use std::fmt;
use wcal_core::device::{DeviceError, DeviceErrorKind};
use wcal_core::order_statistics::median;

/// Smallest step that is named, s: what an alignment of clocks tolerates.
const STEP_S: f64 = 0.02;
/// A clock that does not go on for this long (wall time) stands still, and a jump ahead is settled
/// within it, s.
const SETTLED_S: f64 = 2.0;
/// Scans by which the time of a scan is known.
const LEARNED: usize = 50;
/// Scans that must be off until a step is one.
const CONFIRMED: u32 = 3;
/// Share by which each scan moves that time afterwards.
const FOLLOW: f64 = 1e-3;

/// What a clock did that no clock does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClockFault {
    /// It stepped.
    Step {
        /// By how much, s; negative: back.
        step_s: f64,
        /// Number of the first scan after it.
        serial: u64,
    },
    /// It stands still.
    Stopped {
        /// Its time, s.
        at_s: f64,
        /// Number of the scan at which it stopped.
        serial: u64,
    },
}

impl fmt::Display for ClockFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Step { step_s, serial } => {
                let way = if *step_s < 0.0 { "back" } else { "ahead" };
                write!(
                    f,
                    "a clock step: {:.3} s {way} at scan {serial}",
                    step_s.abs()
                )
            }
            Self::Stopped { at_s, serial } => {
                write!(
                    f,
                    "a stopped clock: it stands at {at_s:.3} s since scan {serial}"
                )
            }
        }
    }
}

impl ClockFault {
    /// As an error of the interrogator.
    pub fn error(&self) -> DeviceError {
        DeviceError::new(
            DeviceErrorKind::Clock,
            "interrogator",
            "read the stream",
            "a device clock that runs on",
            self.to_string(),
        )
    }
}

/// One reading's number and times, s.
#[derive(Debug, Clone, Copy)]
struct TimedReading {
    serial: u64,
    host_s: f64,
    device_s: f64,
}

/// Readings that are off: a step, a gap, or a wrong stamp.
#[derive(Debug, Clone, Copy)]
struct Doubt {
    /// The last good reading.
    before: TimedReading,
    /// The first that is off.
    at: TimedReading,
    /// By how much, s.
    step_s: f64,
    /// Readings that are off so far.
    count: u32,
    /// One of them seems to have come before it was made.
    too_early: bool,
}

/// Watches the clock of one stream.
#[derive(Debug, Default)]
pub struct ClockWatch {
    clock_scale: f64,
    last: Option<TimedReading>,
    /// The last reading at which device time rose.
    risen: Option<TimedReading>,
    /// Largest device less host time so far, s.
    earliest_s: f64,
    first_periods: Vec<f64>,
    period_s: Option<f64>,
    doubt: Option<Doubt>,
    /// Device time has not risen with the last reading.
    standing: bool,
    stopped: bool,
    /// Host and device time up to the first fault, single wrong stamps left out.
    pub(crate) pair: ClockPair,
    count: usize,
    /// Readings of which it is not certain yet whether they came after a fault: host and device
    /// time, s.
    held: Vec<(f64, f64)>,
    /// Number of the first reading from after a fault.
    pub(crate) broken: Option<usize>,
}

impl ClockWatch {
    /// Host times run `clock_scale` times as fast as real time.
    pub fn new(clock_scale: f64) -> Self {
        Self {
            clock_scale,
            earliest_s: f64::NEG_INFINITY,
            pair: ClockPair::new(clock_scale),
            ..Self::default()
        }
    }

    /// Takes the next reading in order of arrival; what its clock has done, once each time.
    pub fn take(&mut self, serial: u64, host_s: f64, device_s: f64) -> Option<ClockFault> {
        let fault = self.judge(TimedReading {
            serial,
            host_s,
            device_s,
        });
        if fault.is_some() {
            // A step is confirmed some scans after it happened: those that were held came after it.
            let first = self.count - self.held.len();
            self.broken.get_or_insert(first);
            self.held.clear();
        }
        self.count += 1;
        if self.broken.is_none() {
            self.held.push((host_s, device_s));
            if !self.is_unsure() {
                self.settle_held();
            }
        }
        fault
    }

    /// What was held is good, but for single wrong stamps: those that seem to have come before they
    /// were made.
    pub(crate) fn settle_held(&mut self) {
        for (host_s, device_s) in self.held.drain(..) {
            if device_s - host_s <= self.earliest_s + STEP_S {
                self.pair.add(host_s, device_s);
            }
        }
    }

    fn judge(&mut self, now: TimedReading) -> Option<ClockFault> {
        let Some(last) = self.last.replace(now) else {
            self.begin_anew(now);
            return None;
        };
        let step = match self.doubt {
            Some(doubt) => self.settle(doubt, now),
            None => self.compare(last, now),
        };
        if step.is_some() {
            self.begin_anew(now);
            return step;
        }
        let stopped = self.stands_still(now);
        // A reading in doubt does not move the limit that it is tested against.
        if self.doubt.is_none() {
            self.earliest_s = self.earliest_s.max(now.device_s - now.host_s);
        }
        stopped
    }

    /// Whether the last readings may turn out to have come after a step, or from a clock that
    /// stands still.
    pub fn is_unsure(&self) -> bool {
        self.doubt.is_some() || self.standing
    }

    /// After a step nothing known before holds but the rate.
    fn begin_anew(&mut self, now: TimedReading) {
        (self.risen, self.earliest_s, self.doubt) = (Some(now), now.device_s - now.host_s, None);
        (self.standing, self.stopped) = (false, false);
    }

    /// How far device time is off its course since a good reading, s.
    fn off_s(&self, before: TimedReading, now: TimedReading) -> f64 {
        let scans = now.serial.saturating_sub(before.serial) as f64;
        now.device_s - before.device_s - scans * self.period_s.unwrap_or(0.0)
    }

    /// Learns the time of a scan, and notes where a reading is off.
    fn compare(&mut self, last: TimedReading, now: TimedReading) -> Option<ClockFault> {
        let scans = now.serial.saturating_sub(last.serial) as f64;
        let (off_s, rise_s) = (self.off_s(last, now), now.device_s - last.device_s);
        // A jump ahead is one only where scans were counted and their time is known.
        let ahead = off_s > STEP_S && scans > 0.0 && self.period_s.is_some();
        if rise_s < -STEP_S || ahead {
            let doubt = Doubt {
                before: last,
                at: now,
                step_s: off_s,
                count: 0,
                too_early: false,
            };
            return self.settle(doubt, now);
        }
        match self.period_s {
            _ if scans == 0.0 => {}
            Some(period_s) => self.period_s = Some(period_s + FOLLOW * (rise_s / scans - period_s)),
            None => {
                self.first_periods.push(rise_s / scans);
                // The median: a wrong stamp among the first scans does not count.
                if self.first_periods.len() == LEARNED {
                    self.period_s = median(self.first_periods.iter().copied());
                }
            }
        }
        None
    }

    /// A reading while one before it is in doubt.
    fn settle(&mut self, doubt: Doubt, now: TimedReading) -> Option<ClockFault> {
        let half_s = doubt.step_s / 2.0;
        let back_on_course = self.off_s(doubt.before, now) * half_s.signum() < half_s.abs();
        let settled = now.host_s - doubt.at.host_s > SETTLED_S * self.clock_scale;
        let count = doubt.count + 1;
        let too_early = doubt.too_early || now.device_s - now.host_s > self.earliest_s + half_s;
        let is_step = count > CONFIRMED && (half_s < 0.0 || too_early);
        // A wrong stamp is over with its scan, a gap in the stream when no reading comes too early.
        self.doubt = (!back_on_course && !settled).then_some(Doubt {
            count,
            too_early,
            ..doubt
        });
        (is_step && !back_on_course).then_some(ClockFault::Step {
            step_s: doubt.step_s,
            serial: doubt.at.serial,
        })
    }

    fn stands_still(&mut self, now: TimedReading) -> Option<ClockFault> {
        let risen = *self.risen.get_or_insert(now);
        // No number does not rise either.
        self.standing = !(now.device_s > risen.device_s);
        if !self.standing {
            if self.doubt.is_none() {
                (self.risen, self.stopped) = (Some(now), false);
            }
            return None;
        }
        // The scans have to go on: one scan repeated is another fault than a clock that stands.
        let still_s = now.host_s - risen.host_s;
        let still = still_s > SETTLED_S * self.clock_scale && now.serial != risen.serial;
        (still && !std::mem::replace(&mut self.stopped, true)).then_some(ClockFault::Stopped {
            at_s: risen.device_s,
            serial: risen.serial,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 100.0;

    /// What is said of `seconds` of scans whose device and host time are `at` their number and true
    /// time.
    fn said(
        seconds: u64,
        scale: f64,
        at: impl Fn(u64, f64) -> Option<(u64, f64, f64)>,
    ) -> Vec<ClockFault> {
        let mut watch = ClockWatch::new(scale);
        (0..seconds * RATE_HZ as u64)
            .filter_map(|k| at(k, k as f64 / RATE_HZ))
            .filter_map(|(serial, host_s, device_s)| watch.take(serial, host_s, device_s))
            .collect()
    }

    /// Irregular delays of up to 0.3 s.
    fn delay_s(k: u64) -> f64 {
        ((k * 7919) % 97) as f64 / 97.0 * 0.3
    }

    #[test]
    fn steps_of_either_sign_are_named_once_with_their_size() {
        for step_s in [-3600.0, -0.5, -0.05, 0.5, 3600.0] {
            let found = said(40, 1.0, |k, t| {
                Some((
                    k,
                    1e9 + t + delay_s(k),
                    t + if t > 20.0 { step_s } else { 0.0 },
                ))
            });
            let [
                ClockFault::Step {
                    step_s: own,
                    serial,
                },
            ] = found[..]
            else {
                panic!("{step_s}: {found:?}")
            };
            assert!(
                (own - step_s).abs() < 1e-6 && serial == 2001,
                "{step_s}: {found:?}"
            );
        }
    }

    #[test]
    fn a_stopped_clock_is_named_once_and_may_go_on() {
        let found = said(40, 1.0, |k, t| {
            Some((k, t + delay_s(k), if t > 20.0 { 20.0 } else { t }))
        });
        assert!(
            matches!(found[..], [ClockFault::Stopped { .. }]),
            "{found:?}"
        );
        // It goes on with the right time, or where it stopped: nothing steps.
        let found = said(60, 1.0, |k, t| {
            Some((k, t, if (20.0..30.0).contains(&t) { 20.0 } else { t }))
        });
        assert!(
            matches!(found[..], [ClockFault::Stopped { .. }]),
            "{found:?}"
        );
        let found = said(60, 1.0, |k, t| {
            Some((k, t, t.min(20.0) + (t - 30.0).max(0.0)))
        });
        assert!(
            matches!(found[..], [ClockFault::Stopped { .. }]),
            "{found:?}"
        );
    }

    /// Everything that a slow computer, a slow unit and a working clock do.
    #[test]
    fn delays_gaps_drifts_and_batches_are_no_faults_of_the_clock() {
        let quiet = |name: &str, at: &dyn Fn(u64, f64) -> Option<(u64, f64, f64)>| {
            let found = said(120, 1.0, at);
            assert!(found.is_empty(), "{name}: {found:?}");
        };
        quiet("delays", &|k, t| Some((k, t + delay_s(k), t)));
        quiet("a computer that stands still for 20 s", &|k, t| {
            Some((k, if (50.0..70.0).contains(&t) { 70.0 } else { t }, t))
        });
        quiet("a bench that falls behind more and more", &|k, t| {
            Some((k, 1.5 * t, t))
        });
        quiet("a delay that ends", &|k, t| {
            Some((k, t + if t < 60.0 { 5.0 } else { 0.0 }, t))
        });
        quiet("scans lost and counted", &|k, t| {
            (!(50.0..60.0).contains(&t)).then_some((k, t + delay_s(k), t))
        });
        quiet("scans lost and not counted", &|k, t| match t {
            ..50.0 => Some((k, t + delay_s(k), t)),
            50.0..60.0 => None,
            _ => Some((k - 1000, t + delay_s(k), t)),
        });
        quiet("a clock that drifts by 20,000 ppm", &|k, t| {
            Some((k, t + delay_s(k), t + (t - 30.0).max(0.0) * 0.02))
        });
        quiet("stamps of 10 ms", &|k, t| {
            Some((k, t, (t * 20.0).floor() / 20.0))
        });
        for wrong_s in [-5.0, -1.0, 1.0, 5.0] {
            quiet("single wrong stamps", &|k, t| {
                Some((
                    k,
                    t + delay_s(k),
                    t + if k % 1700 == 900 { wrong_s } else { 0.0 },
                ))
            });
        }
        quiet("a unit that counts anew", &|k, t| {
            Some((if t < 60.0 { k } else { k - 6000 }, t, t))
        });
        let fast = said(600, 20.0, |k, t| Some((k, t + 20.0 * delay_s(k), t)));
        assert!(fast.is_empty(), "{fast:?}");
    }
}
