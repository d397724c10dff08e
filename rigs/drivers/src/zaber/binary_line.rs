//! The line of a T-series unit: questions, replies and what is passed over.

use super::wire::{Asks, Connect, Port, REPLY, Wire};
use std::collections::BTreeSet;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind};
use zproto::binary::command::untyped as command;
use zproto::binary::{Message, Port as BinaryPort};
use zproto::error::BinaryError;

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
    port: BinaryPort<'static, Wire>,
    number: u8,
    /// The last question was given up: its reply may still come.
    owed: bool,
    /// Data of the last echo.
    echo: i32,
    /// Speed data as found, and whether it was changed since.
    speed: Option<(i32, bool)>,
}

impl Asks for BinaryLine {
    fn wire(&mut self) -> &mut Wire {
        self.port.backend_mut()
    }
}

impl Drop for BinaryLine {
    fn drop(&mut self) {
        if let (Some((data, true)), false) = (self.speed, self.wire().failed) {
            let set = command::SET_TARGET_SPEED;
            // Nobody remains to tell; a unit that does not hear it keeps the sweep's speed.
            let _ = self.once(set, data, set, &Deadline::uninterruptible(REPLY));
        }
    }
}

/// Messages that were passed over: of other units, and of this one.
#[derive(Default)]
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
        Ok(Self {
            port: BinaryPort::open_general(Wire::open(place, interrupt, connect)?),
            number,
            owed: false,
            echo: 0,
            speed: None,
        })
    }

    /// Whether the unit answers in this protocol: an echo moves nothing and changes nothing.
    pub(super) fn answers(&mut self) -> bool {
        // What it was asked in another protocol is forgotten.
        self.wire().drain();
        let deadline = Deadline::after(REPLY, &self.wire().interrupt);
        self.catch_up(&deadline).is_ok()
    }

    /// Numbers of the units that answer an echo to all.
    pub(super) fn units(&mut self) -> Result<Vec<u8>, DeviceError> {
        let deadline = Deadline::after(REPLY, &self.wire().interrupt);
        self.send_to(0, command::ECHO_DATA, 0, &deadline)?;
        let mut units = BTreeSet::new();
        loop {
            match self.port.recv_any() {
                Ok(message) if message.command() == command::ECHO_DATA => {
                    units.insert(message.target());
                }
                Ok(_) | Err(BinaryError::CommandFailure(_)) => {}
                Err(_) => return Ok(units.into_iter().collect()),
            }
        }
    }

    /// Sends a message to this unit; the reply to a motion comes when it has ended.
    pub(super) fn send(
        &mut self,
        code: u8,
        data: i32,
        deadline: &Deadline,
    ) -> Result<(), DeviceError> {
        self.send_to(self.number, code, data, deadline)
    }

    fn send_to(
        &mut self,
        number: u8,
        code: u8,
        data: i32,
        deadline: &Deadline,
    ) -> Result<(), DeviceError> {
        let action = action(code);
        self.wire().until(deadline.clone());
        let Err(e) = self.port.tx((number, code, data)) else {
            return Ok(());
        };
        let (name, found) = (&self.port.backend().name, "one that does not");
        Err(match e.is_timeout() {
            true => deadline.error(name, &action, "a line that takes it", found),
            false => self.broken(&action, &e),
        })
    }

    fn broken(&self, action: &str, error: &dyn std::error::Error) -> DeviceError {
        let kind = DeviceErrorKind::Disconnected;
        let (wire, found) = (self.port.backend(), error.to_string());
        wire.error(kind, action, "a working link", &found)
    }

    /// Asks until the reply with command number `answer` arrives.
    pub(super) fn ask(&mut self, code: u8, data: i32, answer: u8) -> Result<i32, DeviceError> {
        let interrupt = self.wire().interrupt.clone();
        self.repeatedly(&interrupt, |line, end| line.once(code, data, answer, end))
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
        let set = command::SET_TARGET_SPEED;
        self.ask(set, data, set).map(drop)
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
            let (code, value) = self.next(&action, deadline, &mut passed)?;
            if code != answer && code != command::ERROR {
                passed.own += 1;
                continue;
            }
            self.owed = false;
            if code == answer {
                return Ok(value);
            }
            let (kind, found) = (DeviceErrorKind::Rejected, format!("error {value}"));
            return Err(self.wire().error(kind, &action, "a reply", &found));
        }
    }

    /// Passes over the replies that are still under way: a unit answers in order, so that none
    /// follows the echo.
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
            let message = match self.port.recv_any() {
                Ok(message) => message,
                Err(BinaryError::CommandFailure(failure)) => Message::from(failure),
                Err(e) if e.is_timeout() => {
                    let SkippedMessages { others, own } = passed;
                    let among = format!(
                        "none among {others} messages of other units and {own} of this unit"
                    );
                    let found = if *others + *own == 0 { "none" } else { &among };
                    return Err(deadline.error(&self.wire().name, action, "a reply", found));
                }
                Err(e) => return Err(self.broken(action, &e)),
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
