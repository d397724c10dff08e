//! Byte links of the virtual bench, and what can go wrong on that of the stage.

use super::faults::{Fault, FaultState};
use super::lock::guard;
use crate::host::is_timeout;
use serialport::{SerialPort, TTYPort};
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Mutex;
use std::time::Duration;
use wcal_core::shared_time;

/// A late reply comes after this time: a client waits for 0.4 s.
const LATE: Duration = Duration::from_millis(600);
/// Messages of a flood that are sent at once.
const POURED: usize = 40;
/// Longest wait for a client that takes nothing.
const TAKEN: Duration = Duration::from_secs(1);
/// How long a read waits, so that alerts and shutdown are seen.
const PATIENCE: Duration = Duration::from_millis(5);

/// A message that is no reply of unit 1: binary messages have six bytes, all others are ASCII
/// lines.
fn stray(foreign: bool, binary: bool) -> &'static [u8] {
    match (foreign, binary) {
        (false, false) => b"!01 1 IDLE --\r\n",
        (false, true) => &[1, 8, 0, 0, 0, 0],
        (true, false) => b"@09 1 77 OK IDLE -- 0\r\n",
        (true, true) => &[9, 60, 0, 0, 0, 0],
    }
}

/// Sends a part of the flood, where there is one.
///
/// # Errors
/// What the link reports.
pub(crate) fn pour(
    faults: &Mutex<FaultState>,
    wire: &mut dyn Wire,
    binary: bool,
) -> io::Result<()> {
    let flood = guard(faults).flood;
    flood.map_or(Ok(()), |foreign| {
        wire.send(&stray(foreign, binary).repeat(POURED))
    })
}

/// Sends a reply of the stage as its cable lets it through.
///
/// # Errors
/// What the link reports.
pub(crate) fn reply(
    faults: &Mutex<FaultState>,
    wire: &mut dyn Wire,
    bytes: &[u8],
) -> io::Result<()> {
    let fault = {
        let mut faults = guard(faults);
        // In a flood the reply is lost.
        if faults.flood.is_some() {
            return Ok(());
        }
        faults.replies.pop_front()
    };
    let binary = bytes.len() == 6 && bytes[0] != b'@';
    let before: &[u8] = match fault {
        Some(Fault::LoseReply) => return Ok(()),
        Some(Fault::CorruptReply) => {
            // One wrong bit in the middle: the checksum has to find it.
            let mut wrong = bytes.to_vec();
            let middle = wrong.len() / 2;
            wrong[middle] ^= 1;
            return wire.send(&wrong);
        }
        Some(Fault::SplitReply) => {
            return bytes.chunks(3).try_for_each(|part| {
                std::thread::sleep(Duration::from_millis(2));
                wire.send(part)
            });
        }
        Some(Fault::LateReply) => {
            shared_time::pause(LATE);
            b""
        }
        Some(Fault::DoubleReply) => bytes,
        Some(Fault::NoiseReply) => b"\x00\xffx~",
        Some(Fault::ForeignReply) => stray(true, binary),
        // The binary protocol has neither info nor lines.
        Some(Fault::InfoLines) if !binary => {
            b"#01 1 the unit says more\r\n\r\n\r\n#01 0 and more\r\n"
        }
        _ => b"",
    };
    wire.send(&[before, bytes].concat())
}

/// A link on which reads wait at most a few milliseconds.
pub(crate) trait Wire {
    /// Bytes that arrived; 0 when none did in time.
    ///
    /// # Errors
    /// `UnexpectedEof` when the peer is gone.
    fn receive(&mut self, into: &mut [u8]) -> io::Result<usize>;
    /// Sends everything.
    ///
    /// # Errors
    /// When the peer is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Line speed the peer has set, where there is one.
    fn baud(&self) -> Option<u32> {
        None
    }
}

fn arrived(found: io::Result<usize>) -> io::Result<usize> {
    match found {
        Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
        // Interrupted: this process was stopped, and goes on.
        Err(e) if is_timeout(&e) || e.kind() == ErrorKind::Interrupted => Ok(0),
        other => other,
    }
}

/// What a client has sent so far, without a wait.
///
/// # Errors
/// As [`Wire::receive`].
pub(crate) fn sent_so_far(link: &mut TcpStream, into: &mut [u8]) -> io::Result<usize> {
    link.set_nonblocking(true)?;
    let found = link.read(into);
    link.set_nonblocking(false)?;
    arrived(found)
}

impl Wire for TcpStream {
    fn receive(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.set_read_timeout(Some(PATIENCE))?;
        arrived(self.read(into))
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }
}

/// A pseudo-terminal whose slave stays open: without a client the master would read EIO.
pub(crate) struct Pty {
    pub(crate) master: TTYPort,
    pub(crate) slave: TTYPort,
}

impl Wire for Pty {
    fn receive(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.master.set_timeout(PATIENCE)?;
        arrived(self.master.read(into))
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        // Without a client the terminal fills up, and a write would wait for ever.
        self.master.set_timeout(TAKEN)?;
        self.master.write_all(bytes)
    }

    fn baud(&self) -> Option<u32> {
        self.slave.baud_rate().ok()
    }
}
