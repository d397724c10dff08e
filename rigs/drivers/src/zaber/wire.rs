//! The byte link to a chain of units: a serial port or TCP, buffered, with one meaning of "timed
//! out" and one deadline an exchange.

use crate::{link, trouble};
use serialport::{SerialPort, TTYPort};
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind};
use zproto::backend::Backend;

/// How long one reply may take.
pub(super) const REPLY: Duration = Duration::from_millis(400);
/// Attempts of a request before its failure counts.
const ATTEMPTS: u32 = 4;
/// Quiet time after which a disturbed line is clean.
const QUIET: Duration = Duration::from_millis(30);
/// Longest time in which it is emptied.
const DRAIN: Duration = Duration::from_millis(100);

/// Where a chain hangs.
#[derive(Debug, Clone)]
pub enum Port {
    /// `host:port`.
    Tcp(String),
    /// Path of a serial port and its speed.
    Serial(String, u32),
}

impl std::fmt::Display for Port {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "{address}"),
            Self::Serial(path, baud) => write!(f, "{path} at {baud} baud"),
        }
    }
}

/// A link that carries bytes. Sending and receiving end with the deadline, whatever the other end
/// does.
pub trait ByteLink: std::fmt::Debug {
    /// Bytes that arrive, at least one.
    ///
    /// # Errors
    /// `TimedOut` when none came, `BrokenPipe` when the other end is gone, else what the system
    /// says.
    fn receive(&mut self, into: &mut [u8], deadline: &Deadline) -> io::Result<usize>;
    /// Sends some of the bytes.
    ///
    /// # Errors
    /// `TimedOut` when the other end takes nothing, else what the system says.
    fn send(&mut self, bytes: &[u8], deadline: &Deadline) -> io::Result<usize>;
    /// Waits between two questions.
    fn pause(&mut self, pause: Duration, deadline: &Deadline) {
        deadline.pause(pause);
    }
}

/// Opens a link: the system's, or one that a test puts in its place.
pub type Connect = Rc<dyn Fn(&Port, &Deadline) -> io::Result<Box<dyn ByteLink>>>;

impl ByteLink for TcpStream {
    fn receive(&mut self, into: &mut [u8], deadline: &Deadline) -> io::Result<usize> {
        link::read(self, into, deadline)
    }

    fn send(&mut self, bytes: &[u8], deadline: &Deadline) -> io::Result<usize> {
        link::write(self, bytes, deadline)
    }
}

impl ByteLink for TTYPort {
    fn receive(&mut self, into: &mut [u8], deadline: &Deadline) -> io::Result<usize> {
        link::attempts(deadline, |slice| {
            self.set_timeout(slice)?;
            self.read(into)
        })
    }

    fn send(&mut self, bytes: &[u8], deadline: &Deadline) -> io::Result<usize> {
        link::attempts(deadline, |slice| {
            self.set_timeout(slice)?;
            self.write(bytes)
        })
    }
}

/// Opens a port of the system; a serial port exclusively, 8N1, without touching DTR or RTS (a
/// pseudo-terminal has none).
///
/// # Errors
/// What the system reports; `ResourceBusy` where another process has the port.
pub fn connect(port: &Port, deadline: &Deadline) -> io::Result<Box<dyn ByteLink>> {
    match port {
        Port::Tcp(address) => {
            let stream = link::connect(address, deadline)?;
            // Questions are a few bytes, which must not wait for more to fill a packet.
            stream.set_nodelay(true)?;
            Ok(Box::new(stream))
        }
        Port::Serial(path, baud) => {
            let opened = serialport::new(path, *baud)
                .timeout(deadline.slice())
                .open_native();
            let mut tty = opened.map_err(|e| match e.kind {
                // What the crate makes of EBUSY, and of a lock that another process holds.
                serialport::ErrorKind::NoDevice => {
                    io::Error::new(ErrorKind::ResourceBusy, e.description)
                }
                _ => e.into(),
            })?;
            // Not every baud rate reaches the port on opening (serialport issue 20); set it again.
            tty.set_baud_rate(*baud)?;
            Ok(Box::new(tty))
        }
    }
}

/// A link to units, buffered, and opened again where it is lost. Reading and writing end with the
/// deadline of the exchange, however much the other end sends.
pub(super) struct Wire {
    /// `None` once it was given back to the system.
    link: Option<Box<dyn ByteLink>>,
    place: Port,
    connect: Connect,
    /// For messages.
    pub name: String,
    pub interrupt: Interrupt,
    buffer: Vec<u8>,
    at: usize,
    /// Longest pause between two bytes.
    timeout: Option<Duration>,
    deadline: Deadline,
    /// What had come at its end was looked for.
    looked: bool,
    /// Requests that had to be repeated.
    pub repeats: u64,
    /// The last exchange failed: who drops the line does not wait for another.
    pub failed: bool,
}

impl Wire {
    /// Opens a port.
    ///
    /// # Errors
    /// `Disconnected`, `Timeout` or `Interrupted`, in words that say what to do.
    pub(super) fn open(
        place: &Port,
        interrupt: &Interrupt,
        connect: &Connect,
    ) -> Result<Self, DeviceError> {
        let mut wire = Self {
            link: None,
            place: place.clone(),
            connect: connect.clone(),
            name: format!("stage {place}"),
            interrupt: interrupt.clone(),
            buffer: Vec::new(),
            at: 0,
            timeout: None,
            deadline: Deadline::after(link::CONNECT, interrupt),
            looked: false,
            repeats: 0,
            failed: false,
        };
        wire.reopen()?;
        Ok(wire)
    }

    /// Opens the same port again. The old link goes first: it holds the port's exclusive lock. All
    /// who share the wire go on with the new one.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(super) fn reopen(&mut self) -> Result<(), DeviceError> {
        self.close();
        let deadline = Deadline::after(link::CONNECT, &self.interrupt);
        let opened = (self.connect)(&self.place, &deadline);
        self.link = Some(opened.map_err(|e| match &self.place {
            Port::Tcp(address) => trouble::of_connection(&self.name, address, &e, &deadline),
            Port::Serial(path, _) => trouble::of_serial_port(&self.name, path, &e, &deadline),
        })?);
        self.failed = false;
        Ok(())
    }

    /// Gives the port back to the system.
    pub(super) fn close(&mut self) {
        // Marked as failed: who drops a closed line does not try to talk over it.
        (self.link, self.failed) = (None, true);
        (self.buffer, self.at) = (Vec::new(), 0);
    }

    /// Begins an exchange: all reading and writing from here on ends with this deadline.
    pub(super) fn until(&mut self, deadline: Deadline) {
        self.deadline = deadline;
        self.looked = false;
    }

    /// Waits between two questions, not beyond the deadline.
    pub(super) fn pause(&mut self, pause: Duration, deadline: &Deadline) {
        match &mut self.link {
            Some(link) => link.pause(pause, deadline),
            None => deadline.pause(pause),
        }
    }

    /// Throws away what has arrived and what still arrives, for a tenth of a second at most: a unit
    /// forgets a message that stops for 10 ms.
    pub(super) fn drain(&mut self) {
        let before = (self.timeout, self.deadline.clone());
        self.timeout = Some(QUIET);
        self.until(Deadline::uninterruptible(DRAIN));
        let mut scrap = [0_u8; 256];
        // Not an error here: the use that follows reports a broken link.
        while matches!(self.read(&mut scrap), Ok(n) if n > 0) {}
        (self.timeout, self.deadline) = before;
    }

    pub(super) fn error(
        &self,
        kind: DeviceErrorKind,
        action: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }
}

/// Who asks the units on a wire.
pub(super) trait Asks {
    fn wire(&mut self) -> &mut Wire;

    /// Asks `once`, and again where no reply comes.
    fn repeatedly<T>(
        &mut self,
        interrupt: &Interrupt,
        once: impl Fn(&mut Self, &Deadline) -> Result<T, DeviceError>,
    ) -> Result<T, DeviceError> {
        let mut attempt = 1;
        loop {
            // A deadline for each attempt: four times 0.4 s is the longest silence.
            let done = once(self, &Deadline::after(REPLY, interrupt));
            let failure = done.as_ref().err().map(|e| e.kind);
            let wire = self.wire();
            // A refusal is an answer, too: the line works.
            wire.failed = failure.is_some_and(|kind| kind != DeviceErrorKind::Rejected);
            if attempt == ATTEMPTS || !failure.is_some_and(DeviceErrorKind::may_retry) {
                return done;
            }
            attempt += 1;
            wire.repeats += 1;
            // What the failed attempt left on the line must not answer the next one.
            wire.drain();
        }
    }
}

fn closed() -> io::Error {
    io::Error::new(ErrorKind::NotConnected, "the port is closed")
}

impl Read for Wire {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.at == self.buffer.len() {
            // A unit that never stops sending does not prolong the exchange; what came while this
            // program did not get to run is read.
            if self.deadline.is_over() && std::mem::replace(&mut self.looked, true) {
                return Err(ErrorKind::TimedOut.into());
            }
            self.buffer.resize(512, 0);
            self.at = 0;
            let pause = self.timeout.map(|longest| self.deadline.within(longest));
            let end = pause.as_ref().unwrap_or(&self.deadline);
            let link = self.link.as_mut().ok_or_else(closed);
            let received = link.and_then(|link| link.receive(&mut self.buffer, end));
            self.buffer.truncate(*received.as_ref().unwrap_or(&0));
            received?;
        }
        let count = into.len().min(self.buffer.len() - self.at);
        into[..count].copy_from_slice(&self.buffer[self.at..self.at + count]);
        self.at += count;
        Ok(count)
    }
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let link = self.link.as_mut().ok_or_else(closed)?;
        link.send(bytes, &self.deadline)
    }

    /// The system sends what was written; waiting for it (`tcdrain`) has no time limit.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Backend for Wire {
    fn set_read_timeout(&mut self, timeout: Option<Duration>) -> io::Result<()> {
        self.timeout = timeout;
        Ok(())
    }

    fn read_timeout(&self) -> io::Result<Option<Duration>> {
        Ok(self.timeout)
    }

    fn name(&self) -> Option<String> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Always has something.
    #[derive(Debug)]
    struct Flood;

    impl ByteLink for Flood {
        fn receive(&mut self, into: &mut [u8], _: &Deadline) -> io::Result<usize> {
            into.fill(7);
            Ok(into.len())
        }

        fn send(&mut self, bytes: &[u8], _: &Deadline) -> io::Result<usize> {
            Ok(bytes.len())
        }
    }

    #[test]
    fn what_has_come_at_the_end_is_read_once_and_a_flood_does_not_prolong_it() {
        let connect: Connect = Rc::new(|_, _| Ok(Box::new(Flood)));
        let place = Port::Tcp("unit".to_owned());
        let mut wire = Wire::open(&place, &Interrupt::default(), &connect).unwrap();
        wire.until(Deadline::uninterruptible(Duration::ZERO));
        let mut bytes = [0; 400];
        let mut read = || wire.read(&mut bytes).map_err(|e| e.kind());
        assert_eq!(
            [read(), read(), read()],
            [Ok(400), Ok(112), Err(ErrorKind::TimedOut)]
        );
    }
}
