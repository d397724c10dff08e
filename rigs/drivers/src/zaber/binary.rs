//! A T-series stage: binary protocol, six bytes a message (firmware-notes/zaber-binary.md).

use super::axis::Axis;
use super::binary_line::BinaryLine;
use super::units::Microsteps;
use super::wire::{Asks, REPLY};
use super::{HALT, POLL};
use std::cell::RefCell;
use std::rc::Rc;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading};
use zproto::binary::command::untyped as command;

/// Microsteps per second of one unit of speed data.
const SPEED_STEPS: f64 = 9.375;
/// Firmware, times 100, from which on the home status is a separate setting; before, it is a bit of
/// the device mode.
const OWN_HOME_STATUS: i32 = 600;
const MODE_HOMED: i32 = 1 << 7;

/// One unit on a binary chain.
pub struct ZaberBinary {
    line: Rc<RefCell<BinaryLine>>,
    axis: Axis,
    /// Firmware, times 100.
    firmware: i32,
    homed: bool,
    homing: bool,
    /// Where the last move is to end.
    target_steps: Option<i64>,
}

impl ZaberBinary {
    /// The unit of an open line; reads travel, speed and reference.
    ///
    /// # Errors
    /// `Disconnected` or `Timeout`.
    pub fn new(
        line: Rc<RefCell<BinaryLine>>,
        unit: Microsteps,
        clock: HostClock,
    ) -> Result<Self, DeviceError> {
        let limit_steps = line.borrow_mut().setting(command::SET_MAXIMUM_POSITION)?;
        line.borrow_mut().remember_speed()?;
        let mut stage = Self {
            line,
            axis: Axis {
                unit,
                limit_steps: limit_steps.into(),
                clock,
                commanded_mm: None,
            },
            firmware: 0,
            homed: false,
            homing: false,
            target_steps: None,
        };
        stage.firmware = stage.ask(command::RETURN_FIRMWARE_VERSION)?;
        stage.homed = stage.is_homed()?;
        Ok(stage)
    }

    fn fail(
        &self,
        kind: DeviceErrorKind,
        action: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        let mut line = self.line.borrow_mut();
        line.wire().error(kind, action, expected, found)
    }

    fn ask(&mut self, code: u8) -> Result<i32, DeviceError> {
        self.line.borrow_mut().ask(code, 0, code)
    }

    /// Whether the unit says that it has a reference.
    fn is_homed(&mut self) -> Result<bool, DeviceError> {
        let mut line = self.line.borrow_mut();
        if self.firmware >= OWN_HOME_STATUS {
            return Ok(line.setting(command::SET_HOME_STATUS)? != 0);
        }
        Ok(line.setting(command::SET_DEVICE_MODE)? & MODE_HOMED != 0)
    }

    fn not_homed(&self, action: &str) -> DeviceError {
        let found =
            "no reference (home status 0): `--home` searches it, and moves to the home switch";
        self.fail(DeviceErrorKind::NotHomed, action, "a homed axis", found)
    }

    /// Starts a motion; its reply comes when it has ended.
    fn start(&mut self, code: u8, data: i32) -> Result<(), DeviceError> {
        let mut line = self.line.borrow_mut();
        let deadline = Deadline::after(REPLY, &line.wire().interrupt);
        line.send(code, data, &deadline)
    }
}

impl Stage for ZaberBinary {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let Axis {
            unit, limit_steps, ..
        } = self.axis;
        Ok(DeviceIdentity {
            driver: "zaber-binary".to_owned(),
            model: self.ask(command::RETURN_DEVICE_ID)?.to_string(),
            serial: self.ask(command::RETURN_SERIAL_NUMBER)?.to_string(),
            firmware: format!("{:.2}", f64::from(self.firmware) / 100.0),
            settings: vec![
                ("limit.max".to_owned(), limit_steps.to_string()),
                ("microstep_um".to_owned(), unit.size_um.to_string()),
            ],
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        Ok(self.axis.travel_mm())
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        (self.homing, self.target_steps) = (true, None);
        self.axis.commanded_mm = Some(0.0);
        self.start(command::HOME, 0)
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let action = format!("move to {target_mm:.4} mm");
        let unit = self.axis.unit;
        let steps = self.axis.steps_to(target_mm).map_err(|expected| {
            let (kind, found) = (DeviceErrorKind::OutOfRange, target_mm.to_string());
            self.fail(kind, &action, &expected, &found)
        })?;
        // A unit that was switched off since has lost it.
        self.homed = self.is_homed()?;
        if !self.homed {
            return Err(self.not_homed(&action));
        }
        let speed = (speed_mm_s * 1000.0 / unit.size_um / SPEED_STEPS)
            .round()
            .max(1.0) as i32;
        self.line.borrow_mut().set_speed(speed)?;
        self.axis.commanded_mm = Some(unit.to_mm(steps as f64));
        self.target_steps = Some(steps);
        self.start(command::MOVE_ABSOLUTE, steps as i32)
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        // Status first: a motion that ends between the two questions must not leave a position from
        // before its end.
        let moving = self.ask(command::RETURN_STATUS)? != 0;
        let steps = self.ask(command::RETURN_CURRENT_POSITION)?;
        let host_s = self.axis.clock.now_s();
        if !moving {
            let searched = std::mem::take(&mut self.homing);
            if searched {
                self.homed = self.is_homed()?;
            }
            // This protocol has no stall flag: a motion that ends elsewhere did not get there.
            let elsewhere = self
                .target_steps
                .is_some_and(|target| target != i64::from(steps));
            if searched && !self.homed || elsewhere {
                let found = format!("standing at {steps} microsteps");
                let (kind, action) = (DeviceErrorKind::Stalled, "read position");
                return Err(self.fail(kind, action, "the target", &found));
            }
        }
        if !self.homed && !self.homing {
            return Err(self.not_homed("read position"));
        }
        Ok(self.axis.reading(host_s, steps.into(), moving, Vec::new()))
    }

    /// The protocol keeps no flag of a stall: whether one was before is not known, and the
    /// reference is searched anew.
    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        self.target_steps = None;
        Ok(vec!["a stall is not reported".to_owned()])
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.homing = false;
        (self.axis.commanded_mm, self.target_steps) = (None, None);
        let mut line = self.line.borrow_mut();
        // Its reply comes with the standstill and may be lost: the status is asked instead.
        line.send(command::STOP, 0, &Deadline::uninterruptible(REPLY))?;
        let deadline = Deadline::uninterruptible(HALT);
        let mut again = Some(Deadline::uninterruptible(HALT / 3));
        let status = command::RETURN_STATUS;
        // What must be tried although the user wants an end.
        let never = Interrupt::default();
        while line.repeatedly(&never, |line, end| line.once(status, 0, status, end))? != 0 {
            if deadline.is_over() {
                let name = &line.wire().name;
                return Err(deadline.error(name, "stop", "standstill", "still moving"));
            }
            // Still moving long after it would have stopped: the command was lost on the line.
            if again.take_if(|again| again.is_over()).is_some() {
                line.send(command::STOP, 0, &Deadline::uninterruptible(REPLY))?;
            }
            line.wire().pause(POLL, &deadline);
        }
        Ok(())
    }
}
