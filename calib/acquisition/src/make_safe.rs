//! The end of a sweep that stopped: the stage stands, the cause is recorded, and the stage leaves
//! the wire where that is safe.

use crate::message::SweepEvent;
use crate::recorder::Level;
use crate::steps::{Fault, POLL_MOVING, Sweep};
use crate::sweep::StageEnd;
use std::time::Duration;
use wcal_core::deadline::{Deadline, move_allowance};
use wcal_core::device::{DeviceError, DeviceErrorKind, Stage};

/// Attempts to reach a lost stage again to stop it, and the longest time for them.
const REACH: u32 = 5;
const SAFE: Duration = Duration::from_secs(5);
/// Pause before each.
const REOPEN: Duration = Duration::from_millis(100);

impl Sweep<'_, '_, '_> {
    /// Stops the stage whatever happened, names the cause in the recording, and retracts where that
    /// is safe. A second interrupt ends the retract, not the stop.
    pub(crate) fn make_safe(&mut self, cause: &DeviceError) -> StageEnd {
        if !self.halt() {
            self.note_stop(cause);
            return StageEnd::Unknown;
        }
        self.note_stop(cause);
        // A stage that failed or is blocked is not moved again.
        if self.fault == Fault::Elsewhere && cause.kind != DeviceErrorKind::Stalled {
            return self.retract();
        }
        StageEnd::Stands
    }

    /// Stops the stage, over a new link where the old one is lost; whether it confirmed. No
    /// interrupt breaks this off: one that comes meanwhile is heard afterwards.
    fn halt(&mut self) -> bool {
        let interrupt = self.bench.interrupt.clone();
        let _held = interrupt.hold();
        let deadline = Deadline::uninterruptible(SAFE);
        let mut stopped = self.bench.stage.stop().is_ok();
        for _ in 0..REACH {
            if stopped || deadline.is_over() {
                break;
            }
            (self.bench.pause)(REOPEN);
            // A serial port is locked by whoever holds it open: the old link goes first.
            self.bench.stage.close();
            if let Ok(stage) = (self.bench.reopen)() {
                self.bench.stage = stage;
                stopped = self.bench.stage.stop().is_ok();
            }
        }
        // A link that was lost while the mount turned did not stop it.
        let mount_stopped = self.bench.mount.stop().is_ok();
        stopped && mount_stopped
    }

    fn note_stop(&mut self, cause: &DeviceError) {
        let host_s = self.last.clocks.host_s;
        // The cause is already an error on its way to the user, and the disk may be it.
        let _ = self
            .bench
            .recorder
            .text(host_s, Level::Error, &cause.to_string());
        let detail = format!("{}: {cause}", cause.kind.name());
        let event = SweepEvent {
            kind: "stopped".to_owned(),
            step: self.step as u32,
            detail,
            ..SweepEvent::default()
        };
        // The cause is already an error on its way to the user.
        let _ = self.bench.recorder.event(host_s, &event);
    }

    /// Back from the wire after a fault of another device.
    fn retract(&mut self) -> StageEnd {
        let (rig, at_mm) = (&self.rig.stage, self.last.measured_mm);
        let target_mm = rig.zero_mm + rig.retract_mm;
        let allowed = move_allowance(target_mm - at_mm, rig.speed_mm_s, self.rig.clock_scale);
        let deadline = Deadline::after(allowed, self.bench.interrupt);
        if self
            .bench
            .stage
            .start_move(target_mm, rig.speed_mm_s)
            .is_ok()
        {
            while let Ok(reading) = self.bench.stage.read()
                && !deadline.is_over()
            {
                // A disk that is full, perhaps why the sweep stopped, does not keep the wire
                // pressed.
                let _ = self.bench.recorder.stage(&reading);
                let moving = reading.moving;
                self.last = reading;
                if !moving {
                    return StageEnd::Retracted;
                }
                (self.bench.pause)(POLL_MOVING);
            }
        }
        // Refused, lost, or interrupted once more: it must not go on alone.
        match self.halt() {
            true => StageEnd::Stands,
            false => StageEnd::Unknown,
        }
    }
}

/// A panic on the way (in a progress view, a mount that a person turns, the sweep itself) leaves no
/// stage that moves.
impl Drop for Sweep<'_, '_, '_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.halt();
        }
    }
}
