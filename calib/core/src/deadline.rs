//! The end of every wait on a device: a duration that is over, or a user who wants an end.
//!
//! ```text
//! t_move = L / v,   allowed = 1.5 t_move / s + margin                     L way, v speed, s host seconds per wall second
//! ```

use crate::device::{DeviceError, DeviceErrorKind};
use crate::{shared_time, standstill};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;

/// Longest time in one call of the system: an interrupt is heard within it.
const SLICE: Duration = Duration::from_millis(50);
/// Longest wait that is counted; anything above, and what is no number, is this.
const LONGEST: Duration = Duration::from_secs(30 * 24 * 3600);
/// A move may take this many times its own length: ramps, and a computer that is busy.
const MOVE_TIMES: f64 = 1.5;
/// What is allowed beyond that, wall time.
const MOVE_MARGIN: Duration = Duration::from_secs(5);

/// Who wants an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// The user at the terminal.
    CtrlC,
    /// SIGTERM: the system, or a supervisor.
    Terminate,
    /// SIGHUP: the terminal is gone.
    HangUp,
}

impl Signal {
    const ALL: [Self; 3] = [Self::CtrlC, Self::Terminate, Self::HangUp];

    /// As in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::CtrlC => "Ctrl-C",
            Self::Terminate => "SIGTERM",
            Self::HangUp => "SIGHUP",
        }
    }

    /// Exit code of a program that it ended, by the shell's custom: 128 and the signal's number.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::CtrlC => 130,
            Self::Terminate => 143,
            Self::HangUp => 129,
        }
    }

    /// The one that an error of [`Interrupt::check`] states.
    pub fn of(error: &DeviceError) -> Option<Self> {
        let stated = |signal: &Self| {
            error.kind == DeviceErrorKind::Interrupted && error.found == signal.name()
        };
        Self::ALL.into_iter().find(stated)
    }
}

/// Whether somebody wants an end; shared by all who wait.
#[derive(Debug, Clone, Default)]
pub struct Interrupt(Arc<AtomicU8>);

/// Set while requests are held back.
const HELD: u8 = 0x80;

/// Requests for an end are held back until this is dropped; one that came meanwhile is heard then.
#[derive(Debug)]
pub struct HeldInterrupt<'a>(&'a Interrupt);

impl Drop for HeldInterrupt<'_> {
    fn drop(&mut self) {
        self.0.0.fetch_and(!HELD, Ordering::SeqCst);
    }
}

impl Interrupt {
    /// Asks for an end.
    pub fn set(&self, signal: Signal) {
        // The flag stays as it is; the closure never declines.
        let _ = self
            .0
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |old| {
                Some(old & HELD | (signal as u8 + 1))
            });
    }

    /// Who asks for an end, if anybody does.
    pub fn signal(&self) -> Option<Signal> {
        let code = self.0.load(Ordering::SeqCst);
        // While they are held back nobody asks: the code with its flag is past the last signal.
        usize::from(code)
            .checked_sub(1)
            .and_then(|k| Signal::ALL.get(k).copied())
    }

    /// The request so far is being obeyed, and what comes now must not be broken off by another:
    /// stopping a stage, and reaching it again.
    #[must_use = "requests are held back until it is dropped"]
    pub fn hold(&self) -> HeldInterrupt<'_> {
        self.0.store(HELD, Ordering::SeqCst);
        HeldInterrupt(self)
    }

    /// [`DeviceErrorKind::Interrupted`] where somebody asks for an end.
    ///
    /// # Errors
    /// Who asks.
    pub fn check(&self, device: &str, action: &str) -> Result<(), DeviceError> {
        self.signal()
            .map_or(Ok(()), |signal| Err(interrupted(device, action, signal)))
    }
}

fn interrupted(device: &str, action: &str, signal: Signal) -> DeviceError {
    DeviceError::new(
        DeviceErrorKind::Interrupted,
        device,
        action,
        "no interruption",
        signal.name(),
    )
}

/// When a wait ends. Connecting, reading, writing and every loop that waits for a device take one:
/// what a device sends meanwhile does not prolong it.
#[derive(Debug, Clone)]
pub struct Deadline {
    /// In the time that a virtual bench shares.
    end: Duration,
    allowed: Duration,
    interrupt: Interrupt,
    /// How long the program had stood still when it began: time in which nobody could look is no
    /// part of the wait.
    still: Duration,
}

impl Deadline {
    /// From now on; an interrupt ends it earlier.
    pub fn after(allowed: Duration, interrupt: &Interrupt) -> Self {
        let allowed = allowed.min(LONGEST);
        let still = standstill::total();
        Self {
            end: now() + allowed,
            allowed,
            interrupt: interrupt.clone(),
            still,
        }
    }

    /// For what must be tried whatever the user wants: to stop a stage.
    pub fn uninterruptible(allowed: Duration) -> Self {
        Self::after(allowed, &Interrupt::default())
    }

    /// An earlier end: a part of this wait.
    pub fn within(&self, allowed: Duration) -> Self {
        let still = standstill::total();
        let end = (self.end + still.saturating_sub(self.still)).min(now() + allowed.min(LONGEST));
        Self {
            end,
            allowed: self.allowed.min(allowed),
            interrupt: self.interrupt.clone(),
            still,
        }
    }

    /// Time that remains; zero when it is over or interrupted.
    pub fn remaining(&self) -> Duration {
        match self.interrupt.signal() {
            Some(_) => Duration::ZERO,
            None => (self.end + self.stood_still()).saturating_sub(now()),
        }
    }

    /// How long this program stood still since the wait began.
    fn stood_still(&self) -> Duration {
        standstill::total().saturating_sub(self.still)
    }

    /// Whether no time remains.
    pub fn is_over(&self) -> bool {
        self.remaining().is_zero()
    }

    /// Time for one call of the system: short, so that an interrupt is heard, and never zero, which
    /// some calls take for no limit.
    pub fn slice(&self) -> Duration {
        self.remaining().clamp(Duration::from_millis(1), SLICE)
    }

    /// Sleeps, not beyond the end.
    pub fn pause(&self, pause: Duration) {
        let until = now() + pause.min(self.remaining());
        while !self.is_over() {
            let rest = until.saturating_sub(now());
            if rest.is_zero() {
                return;
            }
            std::thread::sleep(rest.min(SLICE));
        }
    }

    /// Why it is over: `Interrupted`, or `Timeout` with what was expected in the time allowed, and
    /// what was found instead.
    pub fn error(&self, device: &str, action: &str, expected: &str, found: &str) -> DeviceError {
        match self.interrupt.signal() {
            Some(signal) => interrupted(device, action, signal),
            None => {
                let expected = format!("{expected} within {:.1} s", self.allowed.as_secs_f64());
                DeviceError::new(DeviceErrorKind::Timeout, device, action, expected, found)
            }
        }
    }
}

fn now() -> Duration {
    Duration::from_nanos(shared_time::now_ns())
}

/// Longest time (wall) that a move of this way (mm) at this speed (mm/s) may take; `clock_scale`:
/// host seconds per wall second. A way or speed that is no number above 0 is allowed the margin
/// alone.
pub fn move_allowance(way_mm: f64, speed_mm_s: f64, clock_scale: f64) -> Duration {
    let own_s = way_mm.abs() / speed_mm_s.abs() / clock_scale.max(f64::MIN_POSITIVE);
    let own = if own_s.is_nan() {
        Duration::ZERO
    } else {
        Duration::try_from_secs_f64(MOVE_TIMES * own_s).unwrap_or(LONGEST)
    };
    own.saturating_add(MOVE_MARGIN).min(LONGEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deadline_is_over_by_time_or_by_an_interrupt_and_says_which() {
        let interrupt = Interrupt::default();
        let long = Deadline::after(Duration::from_secs(3600), &interrupt);
        assert!(!long.is_over() && long.slice() == SLICE, "control");
        let short = Deadline::after(Duration::ZERO, &interrupt);
        assert!(short.is_over() && !short.slice().is_zero());
        let error = short.error("stage", "poll", "a reply", "none");
        assert_eq!(
            error.to_string(),
            "stage: poll: expected a reply within 0.0 s, found none [timeout]"
        );
        let stop = Deadline::uninterruptible(Duration::from_secs(3600));
        interrupt.set(Signal::Terminate);
        assert!(long.is_over() && !stop.is_over());
        let error = long.error("stage", "poll", "a reply", "none");
        assert_eq!(error.to_string(), "stage: interrupted by SIGTERM");
        assert_eq!(
            interrupt.check("stage", "poll").unwrap_err().kind,
            DeviceErrorKind::Interrupted
        );
        // What was asked is being obeyed; a second request waits until the stage has been stopped.
        let held = interrupt.hold();
        assert!(!long.is_over() && interrupt.check("stage", "poll").is_ok());
        interrupt.set(Signal::CtrlC);
        assert!(!long.is_over() && interrupt.signal().is_none());
        drop(held);
        assert_eq!(interrupt.signal(), Some(Signal::CtrlC));
    }

    #[test]
    fn a_pause_ends_with_its_deadline() {
        let start = std::time::Instant::now();
        Deadline::after(Duration::from_millis(20), &Interrupt::default())
            .pause(Duration::from_secs(3600));
        assert!(start.elapsed() < Duration::from_secs(600));
    }

    #[test]
    fn a_move_is_allowed_its_own_length_and_a_margin_whatever_the_numbers_are() {
        let plain = |way: f64, speed: f64| move_allowance(way, speed, 1.0) - MOVE_MARGIN;
        assert_eq!(plain(10.0, 2.0), Duration::from_secs_f64(7.5));
        assert_eq!(plain(-10.0, 2.0), Duration::from_secs_f64(7.5));
        assert_eq!(
            move_allowance(10.0, 2.0, 5.0) - MOVE_MARGIN,
            Duration::from_secs_f64(1.5)
        );
        for [way, speed] in [[0.0, 0.0], [f64::NAN, 1.0], [1.0, f64::NAN]] {
            assert_eq!(plain(way, speed), Duration::ZERO, "{way} {speed}");
        }
        for [way, speed] in [
            [1.0, 0.0],
            [1.0, 1e-300],
            [f64::INFINITY, 1.0],
            [1e308, 1.0],
        ] {
            assert_eq!(move_allowance(way, speed, 1.0), LONGEST, "{way} {speed}");
        }
    }
}
