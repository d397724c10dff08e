//! A chain of units on one port: checked replies, message ids, checksums, and repeated questions.

use super::wire::{Port, Wire};
use crate::host::is_timeout;
use crate::link::CONNECT;
use std::time::Duration;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind};
use zproto::ascii::Port as AsciiPort;
use zproto::ascii::response::{AnyResponse, Flag, Reply, Status, check};
use zproto::error::AsciiError;

/// How long one reply may take.
const REPLY: Duration = Duration::from_millis(400);
/// Quiet time after which a disturbed line is clean.
const QUIET: Duration = Duration::from_millis(30);
/// Attempts of a request before its failure counts.
const ATTEMPTS: u32 = 4;
/// Speeds that units are found at: the factory's, then that of older and rig-configured ones.
pub const SPEEDS: [u32; 2] = [115_200, 9600];

/// A checked reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// Moving.
    pub busy: bool,
    /// Highest flag, `--` when there is none.
    pub flag: String,
    /// Data.
    pub data: String,
}

/// One open port with all units on it.
#[derive(Debug)]
pub struct Chain {
    port: AsciiPort<'static, Wire>,
    name: String,
    repeats: u64,
    interrupt: Interrupt,
}

/// What came instead of the reply: none of it is an answer, and none of it prolongs the wait.
#[derive(Debug, Default)]
struct SkippedMessages {
    alerts: u32,
    others: u32,
    late: u32,
    info: u32,
    noise: u32,
}

impl SkippedMessages {
    fn note(&mut self, response: &AnyResponse, device: u8) {
        let own = |r: &Reply| r.target().device() == device;
        match response {
            AnyResponse::Alert(_) => self.alerts += 1,
            AnyResponse::Info(_) => self.info += 1,
            AnyResponse::Reply(reply) if own(reply) => self.late += 1,
            AnyResponse::Reply(_) => self.others += 1,
        }
    }

    fn text(&self) -> String {
        let all = [
            (self.alerts, "alerts"),
            (self.others, "replies of other units"),
            (self.late, "replies to other questions"),
            (self.info, "info lines"),
            (self.noise, "lines of noise"),
        ];
        let there = all.iter().filter(|(count, _)| *count > 0);
        let list: Vec<String> = there.map(|(count, what)| format!("{count} {what}")).collect();
        if list.is_empty() { "none".to_owned() } else { format!("none among {}", list.join(", ")) }
    }
}

impl Chain {
    /// Opens a port of known kind and speed, with checksums and message ids.
    ///
    /// # Errors
    /// `Disconnected` when it cannot be opened, `Timeout` when nobody answers at its address.
    pub fn open(port: &Port, interrupt: &Interrupt) -> Result<Self, DeviceError> {
        let name = format!("stage {port}");
        let deadline = Deadline::after(CONNECT, interrupt);
        let wire = Wire::open(port, &deadline).map_err(|e| {
            if is_timeout(&e) {
                return deadline.error(&name, "open", "a connection", "no answer from this address");
            }
            DeviceError::new(DeviceErrorKind::Disconnected, &name, "open", "a free port", e.to_string())
        })?;
        let mut port = AsciiPort::open_general_options().checksums(true).message_ids(true).open(wire);
        // Alerts may come at any time; state is always asked for, so they carry nothing new.
        port.set_unexpected_alert_handler(|_| Ok(()));
        Ok(Self { port, name, repeats: 0, interrupt: interrupt.clone() })
    }

    /// Opens a serial port at the first speed at which a unit replies.
    ///
    /// # Errors
    /// `Timeout` when no speed does.
    pub fn probe(path: &str, interrupt: &Interrupt) -> Result<(Self, u32), DeviceError> {
        for baud in SPEEDS {
            let mut chain = Self::open(&Port::Serial(path.to_owned(), baud), interrupt)?;
            chain.port.backend_mut().drain(QUIET);
            match chain.once(1, 0, "", &Deadline::after(REPLY, interrupt)) {
                Ok(_) => return Ok((chain, baud)),
                Err(e) if e.kind == DeviceErrorKind::Interrupted => return Err(e),
                Err(_) => {}
            }
        }
        let (kind, expected) = (DeviceErrorKind::Timeout, format!("an answer at one of {SPEEDS:?} baud"));
        Err(DeviceError::new(kind, format!("stage {path}"), "probe", expected, "silence"))
    }

    /// Requests that had to be repeated.
    #[must_use]
    pub fn repeats(&self) -> u64 {
        self.repeats
    }

    /// Name for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Sends a command that may be sent again without harm (absolute moves and questions are), and returns its reply.
    ///
    /// # Errors
    /// `Rejected` with the unit's reason, `Timeout` or `Protocol` after some attempts, `Disconnected`, `Interrupted`.
    pub fn ask(&mut self, device: u8, axis: u8, command: &str) -> Result<Answer, DeviceError> {
        self.repeatedly(device, axis, command, &self.interrupt.clone())
    }

    /// As [`Self::ask`], for what must be tried although the user wants an end: to stop.
    ///
    /// # Errors
    /// As there, but never `Interrupted`.
    pub fn ask_to_stop(&mut self, device: u8, axis: u8, command: &str) -> Result<Answer, DeviceError> {
        self.repeatedly(device, axis, command, &Interrupt::default())
    }

    fn repeatedly(
        &mut self,
        device: u8,
        axis: u8,
        command: &str,
        interrupt: &Interrupt,
    ) -> Result<Answer, DeviceError> {
        let mut last = None;
        for attempt in 0..ATTEMPTS {
            if attempt > 0 {
                self.repeats += 1;
                self.port.backend_mut().drain(QUIET);
            }
            match self.once(device, axis, command, &Deadline::after(REPLY, interrupt)) {
                Err(e) if e.kind.may_retry() => last = Some(e),
                done => return done,
            }
        }
        Err(last.unwrap_or_else(|| self.error(DeviceErrorKind::Timeout, command, "a reply", "none")))
    }

    /// The reply with the number of this command; alerts, info, replies of other units and late ones are passed over until the deadline.
    fn once(
        &mut self,
        device: u8,
        axis: u8,
        command: &str,
        deadline: &Deadline,
    ) -> Result<Answer, DeviceError> {
        self.port.backend_mut().until(deadline.clone());
        let sent = self.port.command((device, axis, command));
        let id = sent.map_err(|e| self.translate(command, &e, deadline, &SkippedMessages::default()))?;
        let meant = |r: &Reply| {
            let (unit, own_axis) = (r.target().device(), r.target().axis());
            (device == 0 || unit == device) && (axis == 0 || own_axis == axis) && r.id() == id
        };
        let mut passed = SkippedMessages::default();
        let reply = loop {
            let found = self.port.response::<AnyResponse>();
            match found.and_then(|r| r.check(check::unchecked()).map_err(AsciiError::from)) {
                Ok(AnyResponse::Reply(reply)) if meant(&reply) => break reply,
                Ok(other) => passed.note(&other, device),
                // An empty line, or the rest of one.
                Err(
                    AsciiError::PacketMissingStart(_)
                    | AsciiError::UnexpectedPacket(_)
                    | AsciiError::UnexpectedResponse(_),
                ) => passed.noise += 1,
                Err(e) => return Err(self.translate(command, &e, deadline, &passed)),
            }
        };
        let flag = reply.warning();
        let answer = Answer {
            busy: reply.status() == Status::Busy,
            flag: String::from_utf8_lossy(flag.as_ref()).into_owned(),
            data: reply.data().to_owned(),
        };
        if reply.flag() == Flag::Ok {
            return Ok(answer);
        }
        let found = format!("{} with flag {}", answer.data, answer.flag);
        Err(self.error(DeviceErrorKind::Rejected, command, "an accepted command", &found))
    }

    fn translate(
        &self,
        command: &str,
        error: &AsciiError,
        deadline: &Deadline,
        passed: &SkippedMessages,
    ) -> DeviceError {
        let kind = match error {
            // In a flood the deadline falls into the middle of a line.
            e if e.is_timeout() || deadline.is_over() && !e.is_io() => {
                return deadline.error(&self.name, shown(command), "a reply", &passed.text());
            }
            AsciiError::Io(_) | AsciiError::SerialDeviceInUseOrDisconnected(_) => {
                DeviceErrorKind::Disconnected
            }
            _ => DeviceErrorKind::Protocol,
        };
        self.error(kind, command, "a reply", error.to_string().trim())
    }

    fn error(&self, kind: DeviceErrorKind, command: &str, expected: &str, found: &str) -> DeviceError {
        DeviceError::new(kind, &self.name, shown(command), expected, found)
    }
}

/// A command for people: the empty one asks for the state.
fn shown(command: &str) -> &str {
    if command.is_empty() { "poll" } else { command }
}
