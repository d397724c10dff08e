//! A T-series stage: binary protocol, six bytes a message (firmware-notes/zaber-binary.md).

use super::units::Microsteps;
use super::wire::{Port, Wire};
use crate::host::io_error;
use std::io::{Read, Write};
use std::time::{Duration, Instant};
use wcal_core::clock::HostClock;
use wcal_core::device::{Clocks, DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading};

/// Microsteps per second of one unit of speed data.
const SPEED_STEPS: f64 = 9.375;
const REPLY: Duration = Duration::from_millis(400);
const ATTEMPTS: u32 = 4;
const HALT: Duration = Duration::from_secs(3);
const ERROR: u8 = 255;
const MOTIONS: [u8; 4] = [1, 20, 21, 23];

/// One unit on a binary chain.
#[derive(Debug)]
pub struct ZaberBinary {
    wire: Wire,
    name: String,
    number: u8,
    unit: Microsteps,
    limit_steps: i32,
    clock: HostClock,
    commanded_mm: Option<f64>,
    homed: bool,
    homing: bool,
    stalled: bool,
}

impl ZaberBinary {
    /// Opens the port (9600 baud is the factory's) and reads the travel.
    ///
    /// # Errors
    /// `Disconnected` or `Timeout`.
    pub fn open(port: &Port, number: u8, unit: Microsteps, clock: HostClock) -> Result<Self, DeviceError> {
        let name = format!("stage {port}");
        let wire = Wire::open(port, REPLY).map_err(|e| io_error(&name, "open", &e))?;
        let mut stage = Self {
            wire,
            name,
            number,
            unit,
            limit_steps: 0,
            clock,
            commanded_mm: None,
            homed: false,
            homing: false,
            stalled: false,
        };
        stage.limit_steps = stage.ask(53, 44, 44)?;
        Ok(stage)
    }

    fn fail(&self, kind: DeviceErrorKind, action: &str, expected: &str, found: &str) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }

    fn send(&mut self, command: u8, data: i32) -> Result<(), DeviceError> {
        let d = data.to_le_bytes();
        self.wire
            .write_all(&[self.number, command, d[0], d[1], d[2], d[3]])
            .map_err(|e| io_error(&self.name, &format!("command {command}"), &e))
    }

    /// Repeats the request until the reply with command number `answer` arrives; late replies of motions are accepted meanwhile.
    fn ask(&mut self, command: u8, data: i32, answer: u8) -> Result<i32, DeviceError> {
        let action = format!("command {command}");
        for _ in 0..ATTEMPTS {
            self.send(command, data)?;
            loop {
                let mut six = [0_u8; 6];
                match self.wire.read_exact(&mut six) {
                    Ok(()) => {}
                    Err(e) if e.kind() == std::io::ErrorKind::TimedOut => {
                        self.wire.drain(Duration::from_millis(20));
                        break;
                    }
                    Err(e) => return Err(io_error(&self.name, &action, &e)),
                }
                let value = i32::from_le_bytes([six[2], six[3], six[4], six[5]]);
                match six[1] {
                    _ if six[0] != self.number => {}
                    code if code == answer => return Ok(value),
                    ERROR if self.homing && value == 1 => self.stalled = true,
                    ERROR => {
                        let found = format!("error {value}");
                        return Err(self.fail(DeviceErrorKind::Rejected, &action, "a reply", &found));
                    }
                    motion if MOTIONS.contains(&motion) => self.motion_ended(motion, value),
                    _ => {}
                }
            }
        }
        Err(self.fail(DeviceErrorKind::Timeout, &action, "a reply", "none in time"))
    }

    fn motion_ended(&mut self, command: u8, steps: i32) {
        if command == 1 {
            self.homing = false;
            self.homed = true;
        } else if let Some(target) = self.commanded_mm {
            // This protocol has no stall flag: a move that ends elsewhere did not get there.
            self.stalled = command == 20 && i64::from(steps) != self.unit.from_mm(target);
        }
    }
}

impl Stage for ZaberBinary {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let model = self.ask(50, 0, 50)?.to_string();
        let firmware = f64::from(self.ask(51, 0, 51)?) / 100.0;
        let serial = self.ask(63, 0, 63)?.to_string();
        let settings = vec![
            ("limit.max".to_owned(), self.limit_steps.to_string()),
            ("microstep_um".to_owned(), self.unit.size_um.to_string()),
        ];
        Ok(DeviceIdentity {
            driver: "zaber-binary".to_owned(),
            model,
            serial,
            firmware: format!("{firmware:.2}"),
            settings,
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        Ok([0.0, self.unit.to_mm(f64::from(self.limit_steps))])
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        (self.homing, self.stalled) = (true, false);
        self.commanded_mm = Some(0.0);
        self.send(1, 0)
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let action = format!("move to {target_mm:.4} mm");
        let steps = self.unit.from_mm(target_mm);
        if !(0..=i64::from(self.limit_steps)).contains(&steps) {
            let expected = format!("a target in 0..{} microsteps", self.limit_steps);
            return Err(self.fail(DeviceErrorKind::OutOfRange, &action, &expected, &steps.to_string()));
        }
        if !self.homed {
            // The protocol does not report it; a unit that was not homed in this run counts as unreferenced.
            return Err(self.fail(DeviceErrorKind::NotHomed, &action, "a homed axis", "not homed"));
        }
        let speed = (speed_mm_s * 1000.0 / self.unit.size_um / SPEED_STEPS).round().max(1.0) as i32;
        self.ask(42, speed, 42)?;
        self.commanded_mm = Some(self.unit.to_mm(steps as f64));
        self.stalled = false;
        self.send(20, steps as i32)
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        // Status first: a motion that ends between the two questions must not leave a position from before its end.
        let moving = self.ask(54, 0, 54)? != 0;
        let steps = self.ask(60, 0, 60)?;
        let host_s = self.clock.now_s();
        if self.stalled && !moving {
            let found = format!("standing at {steps} microsteps");
            return Err(self.fail(DeviceErrorKind::Stalled, "read position", "the target", &found));
        }
        Ok(StageReading {
            commanded_mm: self.commanded_mm,
            measured_mm: self.unit.to_mm(f64::from(steps)),
            moving: moving || self.homing,
            flags: Vec::new(),
            clocks: Clocks { host_s, device_s: None },
        })
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.homing = false;
        self.commanded_mm = None;
        self.send(23, 0)?;
        let end = Instant::now() + HALT;
        while self.ask(54, 0, 54)? != 0 {
            if Instant::now() > end {
                return Err(self.fail(DeviceErrorKind::Timeout, "stop", "standstill", "still moving"));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }
}
