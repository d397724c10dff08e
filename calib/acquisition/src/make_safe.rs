//! The end of a sweep that stopped: the stage stands, the cause is recorded, and the wire is left where that is safe.

use crate::message::SweepEvent;
use crate::steps::{Fault, POLL_MOVING, Sweep};
use foxglove::messages::log::Level;
use std::time::Duration;
use wcal_core::deadline::{Deadline, move_allowance};
use wcal_core::device::{DeviceError, DeviceErrorKind};

/// Attempts to reach a lost stage again to stop it, and the longest time for them.
const REACH: u32 = 5;
const SAFE: Duration = Duration::from_secs(5);

impl Sweep<'_, '_, '_> {
    /// Stops the stage whatever happened, names the cause in the recording, and retracts where that is safe. A second interrupt ends the
    /// retract, not the stop.
    pub(crate) fn make_safe(&mut self, cause: &DeviceError) -> bool {
        let deadline = Deadline::whatever_happens(SAFE);
        let mut stopped = self.bench.stage.stop().is_ok();
        self.bench.interrupt.acknowledge();
        for _ in 0..REACH {
            if stopped || deadline.is_over() {
                break;
            }
            deadline.pause(Duration::from_millis(100));
            if let Ok(stage) = (self.bench.reopen)() {
                self.bench.stage = stage;
                stopped = self.bench.stage.stop().is_ok();
            }
        }
        // A link that was lost while the mount turned did not stop it.
        let mount_stopped = self.bench.mount.stop().is_ok();
        let host_s = self.last.clocks.host_s;
        self.bench.recorder.text(host_s, Level::Error, &cause.to_string());
        let detail = format!("{}: {cause}", cause.kind.name());
        let event = SweepEvent {
            kind: "stopped".to_owned(),
            step: self.step as u32,
            detail,
            ..SweepEvent::default()
        };
        // The cause is already an error on its way to the user.
        let _ = self.bench.recorder.event(host_s, &event);
        // A stage that failed or is blocked is not moved again.
        if stopped && self.fault == Fault::Elsewhere && cause.kind != DeviceErrorKind::Stalled {
            stopped = self.retract();
        }
        stopped && mount_stopped
    }

    /// Back from the wire after a fault of another device; whether the stage stands at the end.
    fn retract(&mut self) -> bool {
        let (rig, at_mm) = (&self.rig.stage, self.last.measured_mm);
        let target_mm = rig.zero_mm + rig.retract_mm;
        let allowed = move_allowance(target_mm - at_mm, rig.speed_mm_s, self.rig.clock_scale);
        let deadline = Deadline::after(allowed, self.bench.interrupt);
        if self.bench.stage.start_move(target_mm, rig.speed_mm_s).is_ok() {
            while let Ok(reading) = self.bench.stage.read()
                && !deadline.is_over()
            {
                let moving = reading.moving;
                let noted = self.note(reading);
                if !moving {
                    return true;
                }
                if noted.is_err() {
                    break;
                }
                deadline.pause(POLL_MOVING);
            }
        }
        // Refused, lost, or interrupted once more: it must not go on alone.
        self.bench.stage.stop().is_ok()
    }
}
