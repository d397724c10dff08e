//! The byte link to a chain of units: a serial port or TCP, buffered, with one meaning of "timed out".

use crate::host::is_timeout;
use serialport::{SerialPort, TTYPort};
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use zproto::backend::Backend;

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

/// An open link.
#[derive(Debug)]
pub struct Wire {
    link: Link,
    buffer: Vec<u8>,
    at: usize,
    timeout: Option<Duration>,
    name: String,
}

impl Wire {
    /// Opens the port; a serial port exclusively, 8N1, without touching DTR or RTS (a pseudo-terminal has none).
    ///
    /// # Errors
    /// What the system reports.
    pub fn open(port: &Port, timeout: Duration) -> io::Result<Self> {
        let link = match port {
            Port::Tcp(address) => {
                let stream = TcpStream::connect(address)?;
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(timeout))?;
                stream.set_write_timeout(Some(timeout))?;
                Link::Tcp(stream)
            }
            Port::Serial(path, baud) => {
                let mut tty = serialport::new(path, *baud).timeout(timeout).open_native()?;
                // Not every baud rate reaches the port on opening (serialport issue 20); set it again.
                tty.set_baud_rate(*baud)?;
                Link::Serial(tty)
            }
        };
        Ok(Self { link, buffer: Vec::new(), at: 0, timeout: Some(timeout), name: port.to_string() })
    }

    /// Throws away what has arrived and what still arrives within `quiet`.
    pub fn drain(&mut self, quiet: Duration) {
        let before = self.timeout;
        if self.set_read_timeout(Some(quiet)).is_ok() {
            let mut scrap = [0_u8; 256];
            while matches!(self.read(&mut scrap), Ok(n) if n > 0) {}
            // Not an error here: the use that follows reports a broken link.
            let _ = self.set_read_timeout(before);
        }
    }
}

impl Read for Wire {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.at == self.buffer.len() {
            self.buffer.resize(512, 0);
            self.at = 0;
            let result = match &mut self.link {
                Link::Tcp(stream) => stream.read(&mut self.buffer),
                Link::Serial(tty) => tty.read(&mut self.buffer),
            };
            match result {
                Ok(n) => self.buffer.truncate(n),
                Err(e) => {
                    self.buffer.clear();
                    let timeout = is_timeout(&e);
                    return Err(if timeout { io::ErrorKind::TimedOut.into() } else { e });
                }
            }
            if self.buffer.is_empty() {
                return Err(io::Error::new(io::ErrorKind::BrokenPipe, "the link is closed"));
            }
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
            Link::Tcp(stream) => stream.write(bytes),
            Link::Serial(tty) => tty.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.link {
            Link::Tcp(stream) => stream.flush(),
            Link::Serial(tty) => tty.flush(),
        }
    }
}

impl Backend for Wire {
    fn set_read_timeout(&mut self, timeout: Option<Duration>) -> io::Result<()> {
        if timeout == self.timeout {
            return Ok(());
        }
        match &mut self.link {
            Link::Tcp(stream) => stream.set_read_timeout(timeout)?,
            Link::Serial(tty) => tty.set_timeout(timeout.unwrap_or(Duration::MAX))?,
        }
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
