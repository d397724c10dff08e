//! A T-series stage: binary protocol, six bytes a message (firmware-notes/zaber-binary.md).

use super::units::Microsteps;
use super::wire::{Connect, Port, Wire, not_opened};
use crate::link::CONNECT;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{Clocks, DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading};
use zproto::binary::command::untyped as command;
use zproto::binary::{Message, Port as BinaryPort};
use zproto::error::BinaryError;

/// Microsteps per second of one unit of speed data.
const SPEED_STEPS: f64 = 9.375;
const REPLY: Duration = Duration::from_millis(400);
const ATTEMPTS: u32 = 4;
const HALT: Duration = Duration::from_secs(3);
/// Pause between polls while it comes to rest.
const POLL: Duration = Duration::from_millis(5);
/// Quiet time after which a disturbed line is empty.
const QUIET: Duration = Duration::from_millis(20);
/// Error of a unit that does not know a command.
const UNKNOWN: i32 = 64;
/// Error of a unit that did not find its home switch.
const CANNOT_HOME: i32 = 1;
/// Their replies come when the motion has ended, or not at all on a disturbed line: status and position say the same.
const MOTIONS: [u8; 4] = [command::HOME, command::MOVE_ABSOLUTE, command::MOVE_RELATIVE, command::STOP];
/// Firmware, times 100, from which on the home status is a setting of its own; before, it is a bit of the device mode.
const OWN_HOME_STATUS: i32 = 600;
const MODE_HOMED: i32 = 1 << 7;

/// One open port with one unit on it. Dropped, it leaves the unit with the speed that it found.
pub struct BinaryLine {
    /// `None` while a lost link is opened again.
    port: Option<BinaryPort<'static, Wire>>,
    place: Port,
    connect: Connect,
    name: String,
    number: u8,
    interrupt: Interrupt,
    /// The last question was given up: its reply may still come.
    owed: bool,
    /// Data of the last echo.
    echo: i32,
    repeats: u64,
    /// Speed data as found, and whether it was changed since.
    speed: Option<(i32, bool)>,
    failed: bool,
}

impl std::fmt::Debug for BinaryLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BinaryLine").field("name", &self.name).finish_non_exhaustive()
    }
}

impl Drop for BinaryLine {
    fn drop(&mut self) {
        if let (Some((data, true)), false) = (self.speed, self.failed) {
            let deadline = Deadline::whatever_happens(REPLY);
            // Nobody is left to tell; a unit that does not hear it keeps the sweep's speed.
            let _ = self.once(command::SET_TARGET_SPEED, data, command::SET_TARGET_SPEED, &deadline);
        }
    }
}

/// Messages that were passed over: of other units, and of this one.
#[derive(Debug, Default)]
struct SkippedMessages {
    others: u32,
    own: u32,
}

impl BinaryLine {
    /// Opens the port (9600 baud is the factory's) of unit `number`.
    ///
    /// # Errors
    /// `Disconnected` or `Timeout`.
    pub fn open(
        place: &Port,
        number: u8,
        interrupt: &Interrupt,
        connect: &Connect,
    ) -> Result<Self, DeviceError> {
        let mut line = Self {
            port: None,
            place: place.clone(),
            connect: connect.clone(),
            name: format!("stage {place}"),
            number,
            interrupt: interrupt.clone(),
            owed: false,
            echo: 0,
            repeats: 0,
            speed: None,
            failed: false,
        };
        line.reopen()?;
        Ok(line)
    }

    /// Opens the same port again. The old link goes first: it holds the port's exclusive lock.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn reopen(&mut self) -> Result<(), DeviceError> {
        self.close();
        let deadline = Deadline::after(CONNECT, &self.interrupt);
        let link = (self.connect)(&self.place, &deadline)
            .map_err(|e| not_opened(&self.name, &self.place, &e, &deadline))?;
        let wire = Wire::over(link, self.name.clone(), deadline);
        (self.port, self.failed) = (Some(BinaryPort::open_general(wire)), false);
        Ok(())
    }

    /// Gives the port back to the system.
    pub fn close(&mut self) {
        self.port = None;
        self.failed = true;
    }

    /// Where the line hangs.
    pub fn place(&self) -> &Port {
        &self.place
    }

    /// Numbers of the units that answer an echo to all.
    ///
    /// # Errors
    /// `Disconnected` or `Interrupted`.
    pub fn units(&mut self) -> Result<Vec<u8>, DeviceError> {
        let deadline = Deadline::after(REPLY, &self.interrupt);
        let own = std::mem::replace(&mut self.number, 0);
        let sent = self.send(command::ECHO_DATA, 0, &deadline);
        self.number = own;
        sent?;
        let mut units = BTreeSet::new();
        loop {
            match self.open_port("echo")?.recv_any() {
                Ok(message) if message.command() == command::ECHO_DATA => {
                    units.insert(message.target());
                }
                Ok(_) | Err(BinaryError::CommandFailure(_)) => {}
                Err(_) => return Ok(units.into_iter().collect()),
            }
        }
    }

    /// Requests that had to be repeated.
    pub fn repeats(&self) -> u64 {
        self.repeats
    }

    fn fail(&self, kind: DeviceErrorKind, action: &str, expected: &str, found: &str) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }

    fn open_port(&mut self, action: &str) -> Result<&mut BinaryPort<'static, Wire>, DeviceError> {
        let error = || {
            let (kind, expected) = (DeviceErrorKind::Disconnected, "a link to the unit");
            DeviceError::new(kind, &self.name, action, expected, "a port that is closed")
        };
        self.port.as_mut().ok_or_else(error)
    }

    fn send(&mut self, code: u8, data: i32, deadline: &Deadline) -> Result<(), DeviceError> {
        let (action, number) = (action(code), self.number);
        let port = self.open_port(&action)?;
        port.backend_mut().until(deadline.clone());
        let sent = port.tx((number, code, data));
        sent.map(|_| ()).map_err(|e| match e.is_timeout() {
            true => deadline.error(&self.name, &action, "a line that takes it", "one that does not"),
            false => self.fail(DeviceErrorKind::Disconnected, &action, "a working link", &e.to_string()),
        })
    }

    /// Starts a motion; its reply comes when it has ended.
    fn start(&mut self, code: u8, data: i32) -> Result<(), DeviceError> {
        let deadline = Deadline::after(REPLY, &self.interrupt);
        self.send(code, data, &deadline)
    }

    fn ask(&mut self, code: u8, data: i32, answer: u8) -> Result<i32, DeviceError> {
        self.repeatedly(code, data, answer, &self.interrupt.clone())
    }

    /// A setting of the unit.
    fn setting(&mut self, setting: u8) -> Result<i32, DeviceError> {
        self.ask(command::RETURN_SETTING, setting.into(), setting)
    }

    /// Reads the speed, which is put back when the line is dropped.
    fn remember_speed(&mut self) -> Result<(), DeviceError> {
        // A line that was opened again remembers what it found the first time.
        if self.speed.is_none() {
            self.speed = Some((self.setting(command::SET_TARGET_SPEED)?, false));
        }
        Ok(())
    }

    fn set_speed(&mut self, data: i32) -> Result<(), DeviceError> {
        if let Some((found, changed)) = &mut self.speed {
            *changed |= *found != data;
        }
        self.ask(command::SET_TARGET_SPEED, data, command::SET_TARGET_SPEED).map(|_| ())
    }

    /// Repeats the request until the reply with command number `answer` arrives.
    fn repeatedly(
        &mut self,
        code: u8,
        data: i32,
        answer: u8,
        interrupt: &Interrupt,
    ) -> Result<i32, DeviceError> {
        let mut last = None;
        for attempt in 0..ATTEMPTS {
            self.repeats += u64::from(attempt > 0);
            let deadline = Deadline::after(REPLY, interrupt);
            let done = self.once(code, data, answer, &deadline);
            self.failed = done.as_ref().is_err_and(|e| e.kind != DeviceErrorKind::Rejected);
            match done {
                Err(e) if e.kind == DeviceErrorKind::Timeout => {
                    if let Some(port) = &mut self.port {
                        port.backend_mut().drain(QUIET);
                    }
                    last = Some(e);
                }
                done => return done,
            }
        }
        let none = || self.fail(DeviceErrorKind::Timeout, &action(code), "a reply", "none");
        Err(last.unwrap_or_else(none))
    }

    fn once(&mut self, code: u8, data: i32, answer: u8, deadline: &Deadline) -> Result<i32, DeviceError> {
        // Replies carry no number: one that is late would answer the next question of its kind, and every one after that.
        if self.owed {
            self.catch_up(deadline)?;
        }
        let action = action(code);
        self.send(code, data, deadline)?;
        self.owed = true;
        let mut passed = SkippedMessages::default();
        loop {
            match self.next(&action, deadline, &mut passed)? {
                (code, value) if code == answer => {
                    self.owed = false;
                    return Ok(value);
                }
                (command::ERROR, value) => {
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
        self.send(command::ECHO_DATA, self.echo, deadline)?;
        let mut passed = SkippedMessages::default();
        loop {
            match self.next("echo", deadline, &mut passed)? {
                (command::ECHO_DATA, data) if data == self.echo => break,
                // Old firmware does not know the command, but answers in order as well.
                (command::ERROR, UNKNOWN) => break,
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
            let message = match self.open_port(action)?.recv_any() {
                Ok(message) => message,
                Err(BinaryError::CommandFailure(failure)) => Message::from(failure),
                Err(e) if e.is_timeout() => {
                    let SkippedMessages { others, own } = passed;
                    let among = format!("none among {others} messages of other units and {own} of its own");
                    let found = if *others + *own == 0 { "none" } else { &among };
                    return Err(deadline.error(&self.name, action, "a reply", found));
                }
                Err(e) => {
                    let kind = DeviceErrorKind::Disconnected;
                    return Err(self.fail(kind, action, "a working link", &e.to_string()));
                }
            };
            let value = i32::from_le_bytes(message.raw_data());
            match message.command() {
                _ if message.target() != self.number => passed.others += 1,
                motion if MOTIONS.contains(&motion) => passed.own += 1,
                // The reply to a reference search that failed: the home status says so.
                command::ERROR if value == CANNOT_HOME => passed.own += 1,
                code => return Ok((code, value)),
            }
        }
    }
}

/// A command for people.
fn action(code: u8) -> String {
    let name = zproto::binary::command::name(code).map(str::to_lowercase);
    name.unwrap_or_else(|| format!("command {code}"))
}

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

    fn fail(&self, kind: DeviceErrorKind, action: &str, expected: &str, found: &str) -> DeviceError {
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
        let found = "no reference (home status 0): `--home` searches it, and moves to the home switch";
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
            return Err(self.fail(DeviceErrorKind::OutOfRange, &action, &expected, &steps.to_string()));
        }
        // A unit that was switched off since has lost it.
        self.homed = self.is_homed()?;
        if !self.homed {
            return Err(self.not_homed(&action));
        }
        let speed = (speed_mm_s * 1000.0 / self.unit.size_um / SPEED_STEPS).round().max(1.0) as i32;
        self.line.borrow_mut().set_speed(speed)?;
        self.commanded_mm = Some(self.unit.to_mm(steps as f64));
        self.target_steps = Some(steps);
        self.line.borrow_mut().start(command::MOVE_ABSOLUTE, steps as i32)
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        // Status first: a motion that ends between the two questions must not leave a position from before its end.
        let moving = self.ask(command::RETURN_STATUS, 0)? != 0;
        let steps = self.ask(command::RETURN_CURRENT_POSITION, 0)?;
        let host_s = self.clock.now_s();
        if !moving {
            let searched = std::mem::take(&mut self.homing);
            if searched {
                self.homed = self.is_homed()?;
            }
            // This protocol has no stall flag: a motion that ends elsewhere did not get there.
            if searched && !self.homed || self.target_steps.is_some_and(|target| target != i64::from(steps)) {
                let found = format!("standing at {steps} microsteps");
                return Err(self.fail(DeviceErrorKind::Stalled, "read position", "the target", &found));
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
            clocks: Clocks { host_s, device_s: None },
        })
    }

    /// The protocol keeps no flag of a stall: whether one was before is not known, and the reference is searched anew.
    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        self.target_steps = None;
        Ok(vec!["a stall is not reported".to_owned()])
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.homing = false;
        (self.commanded_mm, self.target_steps) = (None, None);
        let mut line = self.line.borrow_mut();
        line.send(command::STOP, 0, &Deadline::whatever_happens(REPLY))?;
        let deadline = Deadline::whatever_happens(HALT);
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

/// Whether a unit of this number answers in the binary protocol: an echo moves nothing and changes nothing.
pub(crate) fn answers(place: &Port, number: u8, interrupt: &Interrupt, connect: &Connect) -> bool {
    BinaryLine::open(place, number, interrupt, connect).is_ok_and(|mut line| {
        let deadline = Deadline::after(REPLY, interrupt);
        if let Some(port) = &mut line.port {
            // A unit forgets a message that stops for 10 ms: what it was asked in another protocol is gone.
            port.backend_mut().drain(QUIET);
        }
        line.catch_up(&deadline).is_ok()
    })
}
