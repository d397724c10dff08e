//! The byte link to a chain of units: a serial port or TCP, buffered, with one meaning of "timed out" and one deadline an exchange.

use crate::host::is_timeout;
use crate::link;
use serialport::{SerialPort, TTYPort};
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use wcal_core::deadline::Deadline;
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

#[derive(Debug)]
enum Link {
    Tcp(TcpStream),
    Serial(TTYPort),
}

/// An open link. Reading and writing end with the deadline of the exchange, however much the other end sends.
#[derive(Debug)]
pub struct Wire {
    link: Link,
    buffer: Vec<u8>,
    at: usize,
    /// Longest pause between two bytes.
    timeout: Option<Duration>,
    deadline: Deadline,
    name: String,
}

impl Wire {
    /// Opens the port; a serial port exclusively, 8N1, without touching DTR or RTS (a pseudo-terminal has none).
    ///
    /// # Errors
    /// What the system reports.
    pub fn open(port: &Port, deadline: &Deadline) -> io::Result<Self> {
        let link = match port {
            Port::Tcp(address) => {
                let stream = link::connect(address, deadline)?;
                stream.set_nodelay(true)?;
                Link::Tcp(stream)
            }
            Port::Serial(path, baud) => {
                let mut tty = serialport::new(path, *baud).timeout(deadline.slice()).open_native()?;
                // Not every baud rate reaches the port on opening (serialport issue 20); set it again.
                tty.set_baud_rate(*baud)?;
                Link::Serial(tty)
            }
        };
        let (deadline, name) = (deadline.clone(), port.to_string());
        Ok(Self { link, buffer: Vec::new(), at: 0, timeout: None, deadline, name })
    }

    /// Begins an exchange: all reading and writing from here on ends with this deadline.
    pub fn until(&mut self, deadline: Deadline) {
        self.deadline = deadline;
    }

    /// Throws away what has arrived and what still arrives within `quiet`, for a tenth of a second at most.
    pub fn drain(&mut self, quiet: Duration) {
        let before = (self.timeout, self.deadline.clone());
        self.timeout = Some(quiet);
        self.deadline = Deadline::whatever_happens(DRAIN);
        let mut scrap = [0_u8; 256];
        // Not an error here: the use that follows reports a broken link.
        while matches!(self.read(&mut scrap), Ok(n) if n > 0) {}
        (self.timeout, self.deadline) = before;
    }

    /// Bytes that arrive before the deadline and before the longest pause.
    fn receive(&mut self) -> io::Result<usize> {
        let pause = self.timeout.map(|t| self.deadline.within(t));
        let deadline = pause.as_ref().unwrap_or(&self.deadline);
        match &mut self.link {
            Link::Tcp(stream) => link::read(stream, &mut self.buffer, deadline),
            Link::Serial(tty) => loop {
                tty.set_timeout(deadline.slice())?;
                match tty.read(&mut self.buffer) {
                    Ok(0) => return Err(io::Error::new(ErrorKind::BrokenPipe, "the link is closed")),
                    Err(e) if is_timeout(&e) || e.kind() == ErrorKind::Interrupted => {
                        if deadline.is_over() {
                            return Err(ErrorKind::TimedOut.into());
                        }
                    }
                    other => return other,
                }
            },
        }
    }
}

impl Read for Wire {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        // A unit that never stops sending does not prolong the exchange.
        if self.deadline.is_over() {
            return Err(ErrorKind::TimedOut.into());
        }
        if self.at == self.buffer.len() {
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
        match &mut self.link {
            Link::Tcp(stream) => link::write(stream, bytes, &self.deadline),
            Link::Serial(tty) => loop {
                tty.set_timeout(self.deadline.slice())?;
                match tty.write(bytes) {
                    Err(e) if is_timeout(&e) || e.kind() == ErrorKind::Interrupted => {
                        if self.deadline.is_over() {
                            return Err(ErrorKind::TimedOut.into());
                        }
                    }
                    other => return other,
                }
            },
        }
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
