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

/// Longest time in which a disturbed line is emptied.
const DRAIN: Duration = Duration::from_millis(100);

/// Where a chain hangs.
#[derive(Debug, Clone, PartialEq, Eq)]
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

/// An open link, buffered. Reading and writing end with the deadline of the exchange, however much
/// the other end sends.
#[derive(Debug)]
pub struct Wire {
    link: Box<dyn ByteLink>,
    buffer: Vec<u8>,
    at: usize,
    /// Longest pause between two bytes.
    timeout: Option<Duration>,
    deadline: Deadline,
    /// What had come at its end was looked for.
    looked: bool,
    name: String,
}

impl Wire {
    /// Opens the link of a unit that messages call `name`.
    ///
    /// # Errors
    /// `Disconnected`, `Timeout` or `Interrupted`, in words that say what to do.
    pub(crate) fn open(
        connect: &Connect,
        place: &Port,
        name: &str,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let deadline = Deadline::after(link::CONNECT, interrupt);
        let link = connect(place, &deadline).map_err(|e| not_opened(name, place, &e, &deadline))?;
        Ok(Self::over(link, name.to_owned(), deadline))
    }

    /// Over an open link; `name` is for messages.
    pub fn over(link: Box<dyn ByteLink>, name: String, deadline: Deadline) -> Self {
        Self {
            link,
            buffer: Vec::new(),
            at: 0,
            timeout: None,
            deadline,
            looked: false,
            name,
        }
    }

    /// Begins an exchange: all reading and writing from here on ends with this deadline.
    pub fn until(&mut self, deadline: Deadline) {
        self.deadline = deadline;
        self.looked = false;
    }

    /// Waits between two questions, not beyond the deadline.
    pub fn pause(&mut self, pause: Duration, deadline: &Deadline) {
        self.link.pause(pause, deadline);
    }

    /// Throws away what has arrived and what still arrives within `quiet`, for a tenth of a second
    /// at most.
    pub fn drain(&mut self, quiet: Duration) {
        let before = (self.timeout, self.deadline.clone());
        self.timeout = Some(quiet);
        self.until(Deadline::uninterruptible(DRAIN));
        let mut scrap = [0_u8; 256];
        // Not an error here: the use that follows reports a broken link.
        while matches!(self.read(&mut scrap), Ok(n) if n > 0) {}
        (self.timeout, self.deadline) = before;
    }

    /// Bytes that arrive before the deadline and before the longest pause.
    fn receive(&mut self) -> io::Result<usize> {
        let pause = self.timeout.map(|t| self.deadline.within(t));
        self.link
            .receive(&mut self.buffer, pause.as_ref().unwrap_or(&self.deadline))
    }
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
            let received = self.receive();
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
        self.link.send(bytes, &self.deadline)
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
        Some(self.name.clone())
    }
}

/// Why a port was not opened, in words that say what to do.
/// The error of a question on a port that was given back.
pub(crate) fn closed(name: &str, action: &str) -> DeviceError {
    let (kind, expected) = (DeviceErrorKind::Disconnected, "a link to the unit");
    DeviceError::new(kind, name, action, expected, "a port that is closed")
}

fn not_opened(device: &str, port: &Port, error: &io::Error, deadline: &Deadline) -> DeviceError {
    match port {
        Port::Tcp(address) => trouble::of_connection(device, address, error, deadline),
        Port::Serial(path, _) => trouble::of_serial_port(device, path, error, deadline),
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
        let over = Deadline::uninterruptible(Duration::ZERO);
        let mut wire = Wire::over(Box::new(Flood), "unit".to_owned(), over);
        let mut bytes = [0; 400];
        let mut read = || wire.read(&mut bytes).map_err(|e| e.kind());
        assert_eq!(
            [read(), read(), read()],
            [Ok(400), Ok(112), Err(ErrorKind::TimedOut)]
        );
    }
}
