//! The line of a T-series unit: questions, replies and what is passed over, opened anew where it is
//! lost.

use crate::zaber::wire::{Connect, Port, Wire, closed};
use std::collections::BTreeSet;
use std::time::Duration;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind};
use zproto::binary::command::untyped as command;
use zproto::binary::{Message, Port as BinaryPort};
use zproto::error::BinaryError;

pub(super) const REPLY: Duration = Duration::from_millis(400);
const ATTEMPTS: u32 = 4;
/// Quiet time after which a disturbed line is empty.
pub(super) const QUIET: Duration = Duration::from_millis(20);
/// Error of a unit that does not know a command.
const UNKNOWN: i32 = 64;
/// Error of a unit that did not find its home switch.
const CANNOT_HOME: i32 = 1;
/// Their replies come when the motion has ended, or not at all on a disturbed line: status and
/// position say the same.
const MOTIONS: [u8; 4] = [
    command::HOME,
    command::MOVE_ABSOLUTE,
    command::MOVE_RELATIVE,
    command::STOP,
];

/// One open port with one unit on it. Dropped, it leaves the unit with the speed that it found.
pub struct BinaryLine {
    /// `None` while a lost link is opened again.
    pub(super) port: Option<BinaryPort<'static, Wire>>,
    place: Port,
    connect: Connect,
    pub(super) name: String,
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
        f.debug_struct("BinaryLine")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

impl Drop for BinaryLine {
    fn drop(&mut self) {
        if let (Some((data, true)), false) = (self.speed, self.failed) {
            let deadline = Deadline::uninterruptible(REPLY);
            // Nobody remains to tell; a unit that does not hear it keeps the sweep's speed.
            let _ = self.once(
                command::SET_TARGET_SPEED,
                data,
                command::SET_TARGET_SPEED,
                &deadline,
            );
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
        let wire = Wire::open(&self.connect, &self.place, &self.name, &self.interrupt)?;
        (self.port, self.failed) = (Some(BinaryPort::open_general(wire)), false);
        Ok(())
    }

    /// Gives the port back to the system.
    pub fn close(&mut self) {
        self.port = None;
        self.failed = true;
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

    pub(super) fn fail(
        &self,
        kind: DeviceErrorKind,
        action: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }

    fn open_port(&mut self, action: &str) -> Result<&mut BinaryPort<'static, Wire>, DeviceError> {
        self.port.as_mut().ok_or_else(|| closed(&self.name, action))
    }

    pub(super) fn send(
        &mut self,
        code: u8,
        data: i32,
        deadline: &Deadline,
    ) -> Result<(), DeviceError> {
        let (action, number) = (action(code), self.number);
        let port = self.open_port(&action)?;
        port.backend_mut().until(deadline.clone());
        let sent = port.tx((number, code, data));
        sent.map(|_| ()).map_err(|e| match e.is_timeout() {
            true => deadline.error(
                &self.name,
                &action,
                "a line that takes it",
                "one that does not",
            ),
            false => self.fail(
                DeviceErrorKind::Disconnected,
                &action,
                "a working link",
                &e.to_string(),
            ),
        })
    }

    /// Starts a motion; its reply comes when it has ended.
    pub(super) fn start(&mut self, code: u8, data: i32) -> Result<(), DeviceError> {
        let deadline = Deadline::after(REPLY, &self.interrupt);
        self.send(code, data, &deadline)
    }

    pub(super) fn ask(&mut self, code: u8, data: i32, answer: u8) -> Result<i32, DeviceError> {
        self.repeatedly(code, data, answer, &self.interrupt.clone())
    }

    /// A setting of the unit.
    pub(super) fn setting(&mut self, setting: u8) -> Result<i32, DeviceError> {
        self.ask(command::RETURN_SETTING, setting.into(), setting)
    }

    /// Reads the speed, which is put back when the line is dropped.
    pub(super) fn remember_speed(&mut self) -> Result<(), DeviceError> {
        // A line that was opened again remembers what it found the first time.
        if self.speed.is_none() {
            self.speed = Some((self.setting(command::SET_TARGET_SPEED)?, false));
        }
        Ok(())
    }

    pub(super) fn set_speed(&mut self, data: i32) -> Result<(), DeviceError> {
        if let Some((found, changed)) = &mut self.speed {
            *changed |= *found != data;
        }
        self.ask(command::SET_TARGET_SPEED, data, command::SET_TARGET_SPEED)
            .map(|_| ())
    }

    /// Repeats the request until the reply with command number `answer` arrives.
    pub(super) fn repeatedly(
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
            self.failed = done
                .as_ref()
                .is_err_and(|e| e.kind != DeviceErrorKind::Rejected);
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

    pub(super) fn once(
        &mut self,
        code: u8,
        data: i32,
        answer: u8,
        deadline: &Deadline,
    ) -> Result<i32, DeviceError> {
        // Replies carry no number: one that is late would answer the next question of its kind, and
        // every one after that.
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

    /// Passes over the replies that are still under way: a unit answers in order, so that none
    /// follows the echo.
    pub(super) fn catch_up(&mut self, deadline: &Deadline) -> Result<(), DeviceError> {
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
                    let among = format!(
                        "none among {others} messages of other units and {own} of this unit"
                    );
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
