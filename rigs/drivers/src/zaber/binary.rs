//! A T-series stage: binary protocol, six bytes a message (firmware-notes/zaber-binary.md).

mod line;

pub use line::BinaryLine;

use super::units::Microsteps;
use super::wire::{Connect, Port};
use line::{QUIET, REPLY};
use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{
    Clocks, DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading,
};
use zproto::binary::command::untyped as command;

/// Microsteps per second of one unit of speed data.
const SPEED_STEPS: f64 = 9.375;
const HALT: Duration = Duration::from_secs(3);
/// Pause between polls while it comes to rest.
const POLL: Duration = Duration::from_millis(5);
/// Firmware, times 100, from which on the home status is a separate setting; before, it is a bit of
/// the device mode.
const OWN_HOME_STATUS: i32 = 600;
const MODE_HOMED: i32 = 1 << 7;

/// One unit on a binary chain.
#[derive(Debug)]
pub struct ZaberBinary {
    line: Rc<RefCell<BinaryLine>>,
    unit: Microsteps,
    limit_steps: i32,
    /// Firmware, times 100.
    firmware: i32,
    clock: HostClock,
    commanded_mm: Option<f64>,
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
        let (limit_steps, firmware) = {
            let mut line = line.borrow_mut();
            let limit_steps = line.setting(command::SET_MAXIMUM_POSITION)?;
            line.remember_speed()?;
            let version = command::RETURN_FIRMWARE_VERSION;
            (limit_steps, line.ask(version, 0, version)?)
        };
        let mut stage = Self {
            line,
            unit,
            limit_steps,
            firmware,
            clock,
            commanded_mm: None,
            homed: false,
            homing: false,
            target_steps: None,
        };
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
        self.line.borrow().fail(kind, action, expected, found)
    }

    fn ask(&mut self, code: u8, data: i32) -> Result<i32, DeviceError> {
        self.line.borrow_mut().ask(code, data, code)
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
}

impl Stage for ZaberBinary {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let model = self.ask(command::RETURN_DEVICE_ID, 0)?.to_string();
        let serial = self.ask(command::RETURN_SERIAL_NUMBER, 0)?.to_string();
        let settings = vec![
            ("limit.max".to_owned(), self.limit_steps.to_string()),
            ("microstep_um".to_owned(), self.unit.size_um.to_string()),
        ];
        Ok(DeviceIdentity {
            driver: "zaber-binary".to_owned(),
            model,
            serial,
            firmware: format!("{:.2}", f64::from(self.firmware) / 100.0),
            settings,
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        Ok([0.0, self.unit.to_mm(f64::from(self.limit_steps))])
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        (self.homing, self.target_steps) = (true, None);
        self.commanded_mm = Some(0.0);
        self.line.borrow_mut().start(command::HOME, 0)
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let action = format!("move to {target_mm:.4} mm");
        let steps = self.unit.from_mm(target_mm);
        if !(0..=i64::from(self.limit_steps)).contains(&steps) || !target_mm.is_finite() {
            let expected = format!("a target in 0..{} microsteps", self.limit_steps);
            return Err(self.fail(
                DeviceErrorKind::OutOfRange,
                &action,
                &expected,
                &steps.to_string(),
            ));
        }
        // A unit that was switched off since has lost it.
        self.homed = self.is_homed()?;
        if !self.homed {
            return Err(self.not_homed(&action));
        }
        let speed = (speed_mm_s * 1000.0 / self.unit.size_um / SPEED_STEPS)
            .round()
            .max(1.0) as i32;
        self.line.borrow_mut().set_speed(speed)?;
        self.commanded_mm = Some(self.unit.to_mm(steps as f64));
        self.target_steps = Some(steps);
        self.line
            .borrow_mut()
            .start(command::MOVE_ABSOLUTE, steps as i32)
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        // Status first: a motion that ends between the two questions must not leave a position from
        // before its end.
        let moving = self.ask(command::RETURN_STATUS, 0)? != 0;
        let steps = self.ask(command::RETURN_CURRENT_POSITION, 0)?;
        let host_s = self.clock.now_s();
        if !moving {
            let searched = std::mem::take(&mut self.homing);
            if searched {
                self.homed = self.is_homed()?;
            }
            // This protocol has no stall flag: a motion that ends elsewhere did not get there.
            if searched && !self.homed
                || self
                    .target_steps
                    .is_some_and(|target| target != i64::from(steps))
            {
                let found = format!("standing at {steps} microsteps");
                return Err(self.fail(
                    DeviceErrorKind::Stalled,
                    "read position",
                    "the target",
                    &found,
                ));
            }
        }
        if !self.homed && !self.homing {
            return Err(self.not_homed("read position"));
        }
        Ok(StageReading {
            commanded_mm: self.commanded_mm,
            measured_mm: self.unit.to_mm(f64::from(steps)),
            moving,
            flags: Vec::new(),
            clocks: Clocks {
                host_s,
                device_s: None,
            },
        })
    }

    /// The protocol keeps no flag of a stall: whether one was before is not known, and the
    /// reference is searched anew.
    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        self.target_steps = None;
        Ok(vec!["a stall is not reported".to_owned()])
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.homing = false;
        (self.commanded_mm, self.target_steps) = (None, None);
        let mut line = self.line.borrow_mut();
        line.send(command::STOP, 0, &Deadline::uninterruptible(REPLY))?;
        let deadline = Deadline::uninterruptible(HALT);
        let status = command::RETURN_STATUS;
        while line.repeatedly(status, 0, status, &Interrupt::default())? != 0 {
            if deadline.is_over() {
                return Err(deadline.error(&line.name, "stop", "standstill", "still moving"));
            }
            if let Some(port) = &mut line.port {
                port.backend_mut().pause(POLL, &deadline);
            }
        }
        Ok(())
    }
}

/// Whether a unit of this number answers in the binary protocol: an echo moves nothing and changes
/// nothing.
pub(crate) fn answers(place: &Port, number: u8, interrupt: &Interrupt, connect: &Connect) -> bool {
    BinaryLine::open(place, number, interrupt, connect).is_ok_and(|mut line| {
        let deadline = Deadline::after(REPLY, interrupt);
        if let Some(port) = &mut line.port {
            // A unit forgets a message that stops for 10 ms: what it was asked in another protocol
            // is gone.
            port.backend_mut().drain(QUIET);
        }
        line.catch_up(&deadline).is_ok()
    })
}
