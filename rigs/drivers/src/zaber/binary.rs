//! A T-series stage: binary protocol, six bytes a message (firmware-notes/zaber-binary.md).

use super::units::Microsteps;
use super::wire::{Port, Wire};
use crate::host::{io_error, is_timeout};
use crate::link::CONNECT;
use std::io::{Read, Write};
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{Clocks, DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading};

/// Microsteps per second of one unit of speed data.
const SPEED_STEPS: f64 = 9.375;
const REPLY: Duration = Duration::from_millis(400);
const ATTEMPTS: u32 = 4;
const HALT: Duration = Duration::from_secs(3);
/// Quiet time after which a disturbed line is empty.
const QUIET: Duration = Duration::from_millis(20);
const ERROR: u8 = 255;
/// Answered with its own data.
const ECHO: u8 = 55;
/// Error of a unit that does not know a command.
const UNKNOWN: i32 = 64;
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
    interrupt: Interrupt,
    /// The last question was given up: its reply may still come.
    owed: bool,
    /// Data of the last echo.
    echo: i32,
}

/// Messages that were passed over: of other units, and of this one.
#[derive(Debug, Default)]
struct SkippedMessages {
    others: u32,
    own: u32,
}

impl ZaberBinary {
    /// Opens the port (9600 baud is the factory's) and reads the travel.
    ///
    /// # Errors
    /// `Disconnected` or `Timeout`.
    pub fn open(
        port: &Port,
        number: u8,
        unit: Microsteps,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let name = format!("stage {port}");
        let deadline = Deadline::after(CONNECT, interrupt);
        let wire = Wire::open(port, &deadline).map_err(|e| match is_timeout(&e) {
            true => deadline.error(&name, "open", "a connection", "no answer from this address"),
            false => io_error(&name, "open", &e),
        })?;
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
            interrupt: interrupt.clone(),
            owed: false,
            echo: 0,
        };
        stage.limit_steps = stage.ask(53, 44, 44)?;
        Ok(stage)
    }

    fn fail(&self, kind: DeviceErrorKind, action: &str, expected: &str, found: &str) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }

    fn send(&mut self, command: u8, data: i32, deadline: &Deadline) -> Result<(), DeviceError> {
        let (action, d) = (format!("command {command}"), data.to_le_bytes());
        self.wire.until(deadline.clone());
        let sent = self.wire.write_all(&[self.number, command, d[0], d[1], d[2], d[3]]);
        sent.map_err(|e| match is_timeout(&e) {
            true => deadline.error(&self.name, &action, "a line that takes it", "one that does not"),
            false => io_error(&self.name, &action, &e),
        })
    }

    /// Starts a motion; its reply comes when it has ended.
    fn start(&mut self, command: u8, data: i32) -> Result<(), DeviceError> {
        let deadline = Deadline::after(REPLY, &self.interrupt);
        self.send(command, data, &deadline)
    }

    fn ask(&mut self, command: u8, data: i32, answer: u8) -> Result<i32, DeviceError> {
        self.repeatedly(command, data, answer, &self.interrupt.clone())
    }

    /// Repeats the request until the reply with command number `answer` arrives.
    fn repeatedly(
        &mut self,
        command: u8,
        data: i32,
        answer: u8,
        interrupt: &Interrupt,
    ) -> Result<i32, DeviceError> {
        let mut last = None;
        for _ in 0..ATTEMPTS {
            let deadline = Deadline::after(REPLY, interrupt);
            match self.once(command, data, answer, &deadline) {
                Err(e) if e.kind == DeviceErrorKind::Timeout => {
                    self.wire.drain(QUIET);
                    last = Some(e);
                }
                done => return done,
            }
        }
        let none = || self.fail(DeviceErrorKind::Timeout, &format!("command {command}"), "a reply", "none");
        Err(last.unwrap_or_else(none))
    }

    fn once(&mut self, command: u8, data: i32, answer: u8, deadline: &Deadline) -> Result<i32, DeviceError> {
        // Replies carry no number: one that is late would answer the next question of its kind, and every one after that.
        if self.owed {
            self.catch_up(deadline)?;
        }
        let action = format!("command {command}");
        self.send(command, data, deadline)?;
        self.owed = true;
        let mut passed = SkippedMessages::default();
        loop {
            match self.next(&action, deadline, &mut passed)? {
                (code, value) if code == answer => {
                    self.owed = false;
                    return Ok(value);
                }
                (ERROR, value) => {
                    self.owed = false;
                    let found = format!("error {value}");
                    return Err(self.fail(DeviceErrorKind::Rejected, &action, "a reply", &found));
                }
                _ => passed.own += 1,
            }
        }
    }

    /// Passes over the replies that are still under way: a unit answers in order, so that none follows the echo.
    fn catch_up(&mut self, deadline: &Deadline) -> Result<(), DeviceError> {
        self.echo = self.echo.wrapping_add(1) & 0xffff;
        self.send(ECHO, self.echo, deadline)?;
        let mut passed = SkippedMessages::default();
        loop {
            match self.next("echo", deadline, &mut passed)? {
                (ECHO, data) if data == self.echo => break,
                // Old firmware does not know the command, but answers in order as well.
                (ERROR, UNKNOWN) => break,
                _ => passed.own += 1,
            }
        }
        self.owed = false;
        Ok(())
    }

    /// The next message of this unit that does not end a motion: command number and data.
    fn next(
        &mut self,
        action: &str,
        deadline: &Deadline,
        passed: &mut SkippedMessages,
    ) -> Result<(u8, i32), DeviceError> {
        loop {
            let mut six = [0_u8; 6];
            self.wire.read_exact(&mut six).map_err(|e| match is_timeout(&e) {
                true => {
                    let SkippedMessages { others, own } = passed;
                    let among = format!("none among {others} messages of other units and {own} of its own");
                    let found = if *others + *own == 0 { "none" } else { &among };
                    deadline.error(&self.name, action, "a reply", found)
                }
                false => io_error(&self.name, action, &e),
            })?;
            let value = i32::from_le_bytes([six[2], six[3], six[4], six[5]]);
            match six[1] {
                _ if six[0] != self.number => passed.others += 1,
                ERROR if self.homing && value == 1 => self.stalled = true,
                motion if MOTIONS.contains(&motion) => self.motion_ended(motion, value),
                code => return Ok((code, value)),
            }
        }
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
        self.start(1, 0)
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
        self.start(20, steps as i32)
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
        self.send(23, 0, &Deadline::whatever_happens(REPLY))?;
        let deadline = Deadline::whatever_happens(HALT);
        while self.repeatedly(54, 0, 54, &Interrupt::default())? != 0 {
            if deadline.is_over() {
                return Err(deadline.error(&self.name, "stop", "standstill", "still moving"));
            }
            deadline.pause(Duration::from_millis(5));
        }
        Ok(())
    }
}
