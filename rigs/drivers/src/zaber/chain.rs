//! A chain of units on one port: checked replies, message ids, checksums, and repeated questions.

use super::wire::{Connect, Port, Wire, closed};
use std::collections::{BTreeMap, BTreeSet};
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
const SPEEDS: [u32; 2] = [115_200, 9600];

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

/// One open port with all units on it. Dropped, it leaves the units with the speeds that it found.
pub struct Chain {
    /// `None` while a lost link is opened again.
    port: Option<AsciiPort<'static, Wire>>,
    place: Port,
    connect: Connect,
    name: String,
    repeats: u64,
    interrupt: Interrupt,
    /// `maxspeed` of each axis as it was found, and whether it was changed since.
    speeds: BTreeMap<(u8, u8), (i64, bool)>,
    /// The last exchange failed: who drops the chain does not wait for another.
    failed: bool,
}

impl std::fmt::Debug for Chain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Chain")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

impl Drop for Chain {
    fn drop(&mut self) {
        let changed = std::mem::take(&mut self.speeds);
        for ((device, axis), (data, _)) in changed.into_iter().filter(|(_, (_, changed))| *changed)
        {
            if self.failed {
                return;
            }
            // Nobody remains to tell; a unit that does not hear it keeps the sweep's speed.
            let set = format!("set maxspeed {data}");
            let sent = self.once((device, axis), &set, &Deadline::uninterruptible(REPLY));
            self.failed = sent.is_err();
        }
    }
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
        let list: Vec<String> = there
            .map(|(count, what)| format!("{count} {what}"))
            .collect();
        if list.is_empty() {
            "none".to_owned()
        } else {
            format!("none among {}", list.join(", "))
        }
    }
}

impl Chain {
    /// Opens a port of known kind and speed, with checksums and message ids.
    ///
    /// # Errors
    /// `Disconnected` when it cannot be opened, `Timeout` when nobody answers at its address.
    pub fn open(
        place: &Port,
        interrupt: &Interrupt,
        connect: &Connect,
    ) -> Result<Self, DeviceError> {
        let mut chain = Self {
            port: None,
            place: place.clone(),
            connect: connect.clone(),
            name: format!("stage {place}"),
            repeats: 0,
            interrupt: interrupt.clone(),
            speeds: BTreeMap::new(),
            failed: false,
        };
        chain.reopen()?;
        Ok(chain)
    }

    /// Opens a serial port at the first speed at which the unit of this address replies; where none
    /// does, at one where another unit does.
    ///
    /// # Errors
    /// `Timeout` when no unit replies at any speed.
    pub fn probe(
        path: &str,
        address: u8,
        interrupt: &Interrupt,
        connect: &Connect,
    ) -> Result<(Self, u32), DeviceError> {
        for anybody in [false, true] {
            for baud in SPEEDS {
                let mut chain =
                    Self::open(&Port::Serial(path.to_owned(), baud), interrupt, connect)?;
                chain.drain();
                let answered = match anybody {
                    false => chain
                        .once((address, 0), "", &Deadline::after(REPLY, interrupt))
                        .map(|_| true),
                    true => chain.units().map(|units| !units.is_empty()),
                };
                match answered {
                    Ok(true) => return Ok((chain, baud)),
                    Err(e) if e.kind == DeviceErrorKind::Interrupted => return Err(e),
                    _ => {}
                }
            }
        }
        let (kind, expected) = (
            DeviceErrorKind::Timeout,
            format!("an answer at one of {SPEEDS:?} baud"),
        );
        Err(DeviceError::new(
            kind,
            format!("stage {path}"),
            "probe",
            expected,
            "silence",
        ))
    }

    /// Opens the same port again. The old link goes first: it holds the port's exclusive lock. All
    /// who share the chain go on with the new one.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn reopen(&mut self) -> Result<(), DeviceError> {
        self.close();
        let wire = Wire::open(&self.connect, &self.place, &self.name, &self.interrupt)?;
        let mut port = AsciiPort::open_general_options()
            .checksums(true)
            .message_ids(true)
            .open(wire);
        // Alerts may come at any time; state is always asked for, so they carry nothing new.
        port.set_unexpected_alert_handler(|_| Ok(()));
        (self.port, self.failed) = (Some(port), false);
        Ok(())
    }

    /// Gives the port back to the system.
    pub fn close(&mut self) {
        self.port = None;
        self.failed = true;
    }

    /// Where the chain hangs.
    pub fn place(&self) -> &Port {
        &self.place
    }

    /// Waits between two questions.
    pub fn pause(&mut self, pause: Duration, deadline: &Deadline) {
        match &mut self.port {
            Some(port) => port.backend_mut().pause(pause, deadline),
            None => deadline.pause(pause),
        }
    }

    /// Addresses of the units that answer a question to all.
    ///
    /// # Errors
    /// `Disconnected` or `Interrupted`.
    pub fn units(&mut self) -> Result<Vec<u8>, DeviceError> {
        let deadline = Deadline::after(REPLY, &self.interrupt);
        self.drain();
        let command = "get system.serial";
        self.send((0, 0), command, &deadline)?;
        let mut units = BTreeSet::new();
        loop {
            match self.next(command, &deadline, &mut SkippedMessages::default()) {
                Ok(AnyResponse::Reply(reply)) => {
                    units.insert(reply.target().device());
                }
                Ok(_) => {}
                Err(e) if e.kind == DeviceErrorKind::Timeout => {
                    return Ok(units.into_iter().collect());
                }
                Err(e) if e.kind == DeviceErrorKind::Protocol => {}
                Err(e) => return Err(e),
            }
        }
    }

    /// Reads the speed of an axis, which is put back when the chain is dropped.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub(crate) fn remember_speed(&mut self, device: u8, axis: u8) -> Result<(), DeviceError> {
        // A chain that was opened again remembers what it found the first time.
        if self.speeds.contains_key(&(device, axis)) {
            return Ok(());
        }
        let command = "get maxspeed";
        let data = self.ask(device, axis, command)?.data;
        let found = data
            .parse()
            .map_err(|_| self.error(DeviceErrorKind::Protocol, command, "a number", &data))?;
        self.speeds.insert((device, axis), (found, false));
        Ok(())
    }

    /// Sets the speed of an axis.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub(crate) fn set_speed(&mut self, device: u8, axis: u8, data: i64) -> Result<(), DeviceError> {
        if let Some((found, changed)) = self.speeds.get_mut(&(device, axis)) {
            *changed |= *found != data;
        }
        self.ask(device, axis, &format!("set maxspeed {data}"))
            .map(|_| ())
    }

    fn drain(&mut self) {
        if let Some(port) = &mut self.port {
            port.backend_mut().drain(QUIET);
        }
    }

    /// Requests that had to be repeated.
    pub fn repeats(&self) -> u64 {
        self.repeats
    }

    /// Name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Sends a command that may be sent again without harm (absolute moves and questions are), and
    /// returns its reply.
    ///
    /// # Errors
    /// `Rejected` with the unit's reason, `Timeout` or `Protocol` after some attempts,
    /// `Disconnected`, `Interrupted`.
    pub fn ask(&mut self, device: u8, axis: u8, command: &str) -> Result<Answer, DeviceError> {
        self.repeatedly(device, axis, command, &self.interrupt.clone())
    }

    /// As [`Self::ask`], for what must be tried although the user wants an end: to stop.
    ///
    /// # Errors
    /// As there, but never `Interrupted`.
    pub(crate) fn ask_to_stop(
        &mut self,
        device: u8,
        axis: u8,
        command: &str,
    ) -> Result<Answer, DeviceError> {
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
                self.drain();
            }
            let done = self.once((device, axis), command, &Deadline::after(REPLY, interrupt));
            self.failed = done
                .as_ref()
                .is_err_and(|e| e.kind != DeviceErrorKind::Rejected);
            match done {
                Err(e) if e.kind.may_retry() => last = Some(e),
                done => return done,
            }
        }
        Err(last
            .unwrap_or_else(|| self.error(DeviceErrorKind::Timeout, command, "a reply", "none")))
    }

    fn open_port(&mut self, command: &str) -> Result<&mut AsciiPort<'static, Wire>, DeviceError> {
        self.port
            .as_mut()
            .ok_or_else(|| closed(&self.name, command_name(command)))
    }

    /// Sends a command to a unit and axis; its number.
    fn send(
        &mut self,
        (device, axis): (u8, u8),
        command: &str,
        deadline: &Deadline,
    ) -> Result<Option<u8>, DeviceError> {
        let port = self.open_port(command)?;
        port.backend_mut().until(deadline.clone());
        let sent = port.command((device, axis, command));
        sent.map_err(|e| self.translate(command, &e, deadline, &SkippedMessages::default()))
    }

    /// The next message; empty lines and rests of lines are passed over.
    fn next(
        &mut self,
        command: &str,
        deadline: &Deadline,
        passed: &mut SkippedMessages,
    ) -> Result<AnyResponse, DeviceError> {
        loop {
            let found = self.open_port(command)?.response::<AnyResponse>();
            match found.and_then(|r| r.check(check::unchecked()).map_err(AsciiError::from)) {
                // An empty line, or the rest of one.
                Err(
                    AsciiError::PacketMissingStart(_)
                    | AsciiError::UnexpectedPacket(_)
                    | AsciiError::UnexpectedResponse(_),
                ) => passed.noise += 1,
                other => return other.map_err(|e| self.translate(command, &e, deadline, passed)),
            }
        }
    }

    /// The reply of this unit and axis with the number of this command; alerts, info, replies of
    /// others and late ones are passed over until the deadline.
    fn once(
        &mut self,
        (device, axis): (u8, u8),
        command: &str,
        deadline: &Deadline,
    ) -> Result<Answer, DeviceError> {
        let id = self.send((device, axis), command, deadline)?;
        let meant =
            |r: &Reply| r.target().device() == device && r.target().axis() == axis && r.id() == id;
        let mut passed = SkippedMessages::default();
        let reply = loop {
            match self.next(command, deadline, &mut passed)? {
                AnyResponse::Reply(reply) if meant(&reply) => break reply,
                other => passed.note(&other, device),
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
        Err(self.error(
            DeviceErrorKind::Rejected,
            command,
            "an accepted command",
            &found,
        ))
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
                return deadline.error(
                    &self.name,
                    command_name(command),
                    "a reply",
                    &passed.text(),
                );
            }
            AsciiError::Io(_) | AsciiError::SerialDeviceInUseOrDisconnected(_) => {
                DeviceErrorKind::Disconnected
            }
            _ => DeviceErrorKind::Protocol,
        };
        self.error(kind, command, "a reply", error.to_string().trim())
    }

    fn error(
        &self,
        kind: DeviceErrorKind,
        command: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        DeviceError::new(kind, &self.name, command_name(command), expected, found)
    }
}

/// A command for people: the empty one asks for the state.
fn command_name(command: &str) -> &str {
    if command.is_empty() { "poll" } else { command }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::zaber::wire::ByteLink;
    use std::io;
    use std::rc::Rc;

    /// A line on which every command is answered as this unit and axis would.
    #[derive(Debug)]
    struct AnswersAs(u8, u8, Vec<u8>);

    impl ByteLink for AnswersAs {
        fn send(&mut self, bytes: &[u8], _: &Deadline) -> io::Result<usize> {
            let command = crate::bench::ascii::parse(bytes.trim_ascii_end());
            let id = command.and_then(|c| c.id).unwrap_or(0);
            self.2 = format!("@{:02} {} {id:02} OK IDLE -- 5\r\n", self.0, self.1).into_bytes();
            Ok(bytes.len())
        }

        fn receive(&mut self, into: &mut [u8], _: &Deadline) -> io::Result<usize> {
            let count = into.len().min(self.2.len());
            into[..count].copy_from_slice(&self.2[..count]);
            self.2.drain(..count);
            if count == 0 {
                Err(io::ErrorKind::TimedOut.into())
            } else {
                Ok(count)
            }
        }
    }

    fn asked(as_unit: (u8, u8), of: (u8, u8)) -> Result<Answer, DeviceError> {
        let connect: Connect =
            Rc::new(move |_, _| Ok(Box::new(AnswersAs(as_unit.0, as_unit.1, Vec::new()))));
        let place = Port::Tcp("test".to_owned());
        Chain::open(&place, &Interrupt::default(), &connect)?.ask(of.0, of.1, "get pos")
    }

    #[test]
    fn a_reply_of_another_unit_or_axis_is_no_reply() {
        for (as_unit, of) in [
            ((2, 1), (1, 1)),
            ((1, 2), (1, 1)),
            ((1, 1), (1, 0)),
            ((7, 0), (0, 0)),
        ] {
            let why = asked(as_unit, of).unwrap_err();
            assert_eq!(
                why.kind,
                DeviceErrorKind::Timeout,
                "{as_unit:?} for {of:?}: {why}"
            );
        }
        for own in [(1, 1), (1, 0), (3, 2)] {
            assert_eq!(asked(own, own).unwrap().data, "5", "control: {own:?}");
        }
    }
}
