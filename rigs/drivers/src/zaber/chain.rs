//! A chain of units on one port: checked replies, message ids, checksums, and repeated questions.

use super::wire::{Port, Wire};
use std::time::Duration;
use wcal_core::device::{DeviceError, DeviceErrorKind};
use zproto::ascii::Port as AsciiPort;
use zproto::ascii::response::{Flag, Status, check};
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
}

impl Chain {
    /// Opens a port of known kind and speed, with checksums and message ids.
    ///
    /// # Errors
    /// `Disconnected` when it cannot be opened.
    pub fn open(port: &Port) -> Result<Self, DeviceError> {
        let name = format!("stage {port}");
        let wire = Wire::open(port, REPLY).map_err(|e| {
            DeviceError::new(DeviceErrorKind::Disconnected, &name, "open", "a free port", e.to_string())
        })?;
        let mut port = AsciiPort::open_general_options().checksums(true).message_ids(true).open(wire);
        // Alerts may come at any time; state is always asked for, so they carry nothing new.
        port.set_unexpected_alert_handler(|_| Ok(()));
        Ok(Self { port, name, repeats: 0 })
    }

    /// Opens a serial port at the first speed at which a unit replies.
    ///
    /// # Errors
    /// `Timeout` when no speed does.
    pub fn probe(path: &str) -> Result<(Self, u32), DeviceError> {
        for baud in SPEEDS {
            let mut chain = Self::open(&Port::Serial(path.to_owned(), baud))?;
            chain.port.backend_mut().drain(QUIET);
            if chain.once(1, 0, "").is_ok() {
                return Ok((chain, baud));
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
    /// `Rejected` with the unit's reason, `Timeout` or `Protocol` after some attempts, `Disconnected`.
    pub fn ask(&mut self, device: u8, axis: u8, command: &str) -> Result<Answer, DeviceError> {
        let mut last = None;
        for attempt in 0..ATTEMPTS {
            if attempt > 0 {
                self.repeats += 1;
                self.port.backend_mut().drain(QUIET);
            }
            match self.once(device, axis, command) {
                Err(e) if e.kind.may_retry() => last = Some(e),
                done => return done,
            }
        }
        Err(last.unwrap_or_else(|| self.error(DeviceErrorKind::Timeout, command, "a reply", "none")))
    }

    fn once(&mut self, device: u8, axis: u8, command: &str) -> Result<Answer, DeviceError> {
        let reply = self
            .port
            .command_reply((device, axis, command))
            .and_then(|r| r.check(check::unchecked()).map_err(AsciiError::from))
            .map_err(|e| self.translate(command, &e))?;
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

    fn translate(&self, command: &str, error: &AsciiError) -> DeviceError {
        let kind = match error {
            e if e.is_timeout() => DeviceErrorKind::Timeout,
            AsciiError::Io(_) | AsciiError::SerialDeviceInUseOrDisconnected(_) => {
                DeviceErrorKind::Disconnected
            }
            _ => DeviceErrorKind::Protocol,
        };
        self.error(kind, command, "a reply", error.to_string().trim())
    }

    fn error(&self, kind: DeviceErrorKind, command: &str, expected: &str, found: &str) -> DeviceError {
        let action = if command.is_empty() { "poll" } else { command };
        DeviceError::new(kind, &self.name, action, expected, found)
    }
}
