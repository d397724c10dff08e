//! A chain of units on one port: checked replies, message ids, checksums, and repeated questions.

use super::wire::{Asks, Connect, Port, REPLY, Wire};
use std::collections::{BTreeMap, BTreeSet};
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind};
use zproto::ascii::Port as AsciiPort;
use zproto::ascii::response::{AnyResponse, Flag, Reply, Status, check};
use zproto::error::AsciiError;

/// Speeds that units are found at: the factory's, then that of older and rig-configured ones.
const SPEEDS: [u32; 2] = [115_200, 9600];

/// A checked reply.
#[derive(Debug)]
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
    port: AsciiPort<'static, Wire>,
    /// `maxspeed` of each axis as it was found, and whether it was changed since.
    speeds: BTreeMap<(u8, u8), (i64, bool)>,
}

impl Asks for Chain {
    fn wire(&mut self) -> &mut Wire {
        self.port.backend_mut()
    }
}

impl Drop for Chain {
    fn drop(&mut self) {
        for (target, (data, changed)) in std::mem::take(&mut self.speeds) {
            if changed && !self.wire().failed {
                // Nobody remains to tell; a unit that does not hear it keeps the sweep's speed.
                let set = format!("set maxspeed {data}");
                let sent = self.once(target, &set, &Deadline::uninterruptible(REPLY));
                self.wire().failed = sent.is_err();
            }
        }
    }
}

/// What came instead of the reply: none of it is an answer, and none of it prolongs the wait.
#[derive(Default)]
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
        // A checksum catches a wrong bit, a message id the late reply to another question.
        let mut port = AsciiPort::open_general_options()
            .checksums(true)
            .message_ids(true)
            .open(Wire::open(place, interrupt, connect)?);
        // Alerts may come at any time; state is always asked for, so they carry nothing new.
        port.set_unexpected_alert_handler(|_| Ok(()));
        Ok(Self {
            port,
            speeds: BTreeMap::new(),
        })
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
        // A line on which only others answer is kept: the error can name them.
        for anybody in [false, true] {
            for baud in SPEEDS {
                let place = Port::Serial(path.to_owned(), baud);
                let mut chain = Self::open(&place, interrupt, connect)?;
                chain.wire().drain();
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
        Err(DeviceError::new(
            DeviceErrorKind::Timeout,
            format!("stage {path}"),
            "probe",
            format!("an answer at one of {SPEEDS:?} baud"),
            "silence",
        ))
    }

    /// Addresses of the units that answer a question to all.
    pub(super) fn units(&mut self) -> Result<Vec<u8>, DeviceError> {
        self.wire().drain();
        let deadline = Deadline::after(REPLY, &self.wire().interrupt);
        let command = "get system.serial";
        self.send((0, 0), command, &deadline)?;
        let mut units = BTreeSet::new();
        loop {
            match self.next(command, &deadline, &mut SkippedMessages::default()) {
                Ok(AnyResponse::Reply(reply)) => {
                    units.insert(reply.target().device());
                }
                // Nobody knows how many units there are: the deadline ends the list.
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
    pub(super) fn remember_speed(&mut self, device: u8, axis: u8) -> Result<(), DeviceError> {
        // A chain that was opened again remembers what it found the first time.
        if self.speeds.contains_key(&(device, axis)) {
            return Ok(());
        }
        let found = self.number(device, axis, "get maxspeed")?;
        self.speeds.insert((device, axis), (found, false));
        Ok(())
    }

    /// Sets the speed of an axis.
    pub(super) fn set_speed(&mut self, device: u8, axis: u8, data: i64) -> Result<(), DeviceError> {
        if let Some((found, changed)) = self.speeds.get_mut(&(device, axis)) {
            *changed |= *found != data;
        }
        let set = format!("set maxspeed {data}");
        self.ask(device, axis, &set).map(drop)
    }

    /// Requests that had to be repeated.
    pub fn repeats(&self) -> u64 {
        self.port.backend().repeats
    }

    /// Sends a command that may be sent again without harm (absolute moves and questions are), and
    /// returns its reply.
    ///
    /// # Errors
    /// `Rejected` with the unit's reason, `Timeout` or `Protocol` after some attempts,
    /// `Disconnected`, `Interrupted`.
    pub fn ask(&mut self, device: u8, axis: u8, command: &str) -> Result<Answer, DeviceError> {
        let interrupt = self.wire().interrupt.clone();
        self.repeatedly(&interrupt, |chain, end| {
            chain.once((device, axis), command, end)
        })
    }

    /// As [`Self::ask`], for what must be tried although the user wants an end: to stop.
    pub(super) fn ask_to_stop(
        &mut self,
        device: u8,
        axis: u8,
        command: &str,
    ) -> Result<Answer, DeviceError> {
        self.repeatedly(&Interrupt::default(), |chain, end| {
            chain.once((device, axis), command, end)
        })
    }

    /// The whole number that a unit answers.
    pub(super) fn number(
        &mut self,
        device: u8,
        axis: u8,
        command: &str,
    ) -> Result<i64, DeviceError> {
        let data = self.ask(device, axis, command)?.data;
        let kind = DeviceErrorKind::Protocol;
        data.parse()
            .map_err(|_| self.error(kind, command, "a number", &data))
    }

    /// Sends a command to a unit and axis; its number.
    fn send(
        &mut self,
        (device, axis): (u8, u8),
        command: &str,
        deadline: &Deadline,
    ) -> Result<Option<u8>, DeviceError> {
        self.wire().until(deadline.clone());
        let sent = self.port.command((device, axis, command));
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
            let found = self.port.response::<AnyResponse>();
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
        let kind = DeviceErrorKind::Rejected;
        Err(self.error(kind, command, "an accepted command", &found))
    }

    fn error(
        &self,
        kind: DeviceErrorKind,
        command: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        let wire = self.port.backend();
        wire.error(kind, command_name(command), expected, found)
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
                let (name, action) = (&self.port.backend().name, command_name(command));
                return deadline.error(name, action, "a reply", &passed.text());
            }
            AsciiError::Io(_) | AsciiError::SerialDeviceInUseOrDisconnected(_) => {
                DeviceErrorKind::Disconnected
            }
            _ => DeviceErrorKind::Protocol,
        };
        self.error(kind, command, "a reply", error.to_string().trim())
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
