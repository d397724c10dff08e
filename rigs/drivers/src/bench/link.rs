//! Byte links of the virtual bench, and what can go wrong on them.

use crate::host::is_timeout;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::io::retry_on_intr;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::fd::OwnedFd;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use wcal_core::shared_time;

/// What happens to one of the next replies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReplyFault {
    /// Never sent.
    Lose,
    /// One bit is wrong.
    Corrupt,
    /// Sent in pieces with pauses.
    Split,
    /// Sent twice.
    Double,
    /// Preceded by noise.
    Noise,
    /// Sent when the client has given it up.
    Late,
    /// Preceded by a reply of another unit.
    Foreign,
    /// Preceded by info and empty lines.
    Info,
}

/// What a line carries instead of replies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnsolicitedTraffic {
    /// Messages of the unit that nobody asked for.
    Alerts,
    /// Replies of another unit.
    Foreign,
}

/// A late reply comes after this time: a client waits for 0.4 s.
const LATE: Duration = Duration::from_millis(600);
/// Messages of a flood that are sent at once.
const POURED: usize = 40;
/// Longest wait for a client that takes nothing.
const TAKEN: Duration = Duration::from_secs(1);

/// A message that is no reply of unit 1: binary messages have six bytes, all others are ASCII
/// lines.
fn stray(flood: UnsolicitedTraffic, binary: bool) -> &'static [u8] {
    match (flood, binary) {
        (UnsolicitedTraffic::Alerts, false) => b"!01 1 IDLE --\r\n",
        (UnsolicitedTraffic::Alerts, true) => &[1, 8, 0, 0, 0, 0],
        (UnsolicitedTraffic::Foreign, false) => b"@09 1 77 OK IDLE -- 0\r\n",
        (UnsolicitedTraffic::Foreign, true) => &[9, 60, 0, 0, 0, 0],
    }
}

/// Whether a reply is of the binary protocol.
fn is_binary(reply: &[u8]) -> bool {
    reply.len() == 6 && reply[0] != b'@'
}

/// State of one cable.
#[derive(Debug, Default)]
pub struct Cable {
    unplugged: AtomicBool,
    next: Mutex<VecDeque<ReplyFault>>,
    flood: Mutex<Option<UnsolicitedTraffic>>,
}

impl Cable {
    /// Pulls or plugs the cable.
    pub fn unplug(&self, out: bool) {
        self.unplugged.store(out, Ordering::SeqCst);
    }

    /// Whether the cable is out.
    pub(crate) fn is_out(&self) -> bool {
        self.unplugged.load(Ordering::SeqCst)
    }

    /// Queues a fault for one of the next replies.
    pub(crate) fn disturb(&self, fault: ReplyFault) {
        if let Ok(mut queue) = self.next.lock() {
            queue.push_back(fault);
        }
    }

    /// Begins or ends a flood.
    pub fn flood(&self, flood: Option<UnsolicitedTraffic>) {
        if let Ok(mut now) = self.flood.lock() {
            *now = flood;
        }
    }

    fn flooded(&self) -> Option<UnsolicitedTraffic> {
        self.flood.lock().ok().and_then(|now| *now)
    }

    /// Sends a part of the flood, where there is one.
    ///
    /// # Errors
    /// What the link reports.
    pub(crate) fn pour(&self, wire: &mut dyn Wire, binary: bool) -> io::Result<()> {
        self.flooded().map_or(Ok(()), |flood| {
            wire.send(&stray(flood, binary).repeat(POURED))
        })
    }

    /// Sends a reply as the cable lets it through.
    ///
    /// # Errors
    /// What the link reports.
    pub fn send(&self, wire: &mut dyn Wire, bytes: &[u8]) -> io::Result<()> {
        // In a flood the reply is lost.
        if self.flooded().is_some() {
            return Ok(());
        }
        let fault = self.next.lock().ok().and_then(|mut q| q.pop_front());
        match fault {
            None => wire.send(bytes),
            Some(ReplyFault::Late) => {
                shared_time::pause(LATE);
                wire.send(bytes)
            }
            Some(ReplyFault::Foreign) => {
                wire.send(&[stray(UnsolicitedTraffic::Foreign, is_binary(bytes)), bytes].concat())
            }
            // The binary protocol has neither info nor lines.
            Some(ReplyFault::Info) if is_binary(bytes) => wire.send(bytes),
            Some(ReplyFault::Info) => wire.send(
                &[
                    &b"#01 1 the unit says more\r\n\r\n\r\n#01 0 and more\r\n"[..],
                    bytes,
                ]
                .concat(),
            ),
            Some(ReplyFault::Lose) => Ok(()),
            Some(ReplyFault::Corrupt) => {
                let mut wrong = bytes.to_vec();
                let middle = wrong.len() / 2;
                if let Some(b) = wrong.get_mut(middle) {
                    *b ^= 1;
                }
                wire.send(&wrong)
            }
            Some(ReplyFault::Split) => bytes.chunks(3).try_for_each(|part| {
                std::thread::sleep(Duration::from_millis(2));
                wire.send(part)
            }),
            Some(ReplyFault::Double) => wire.send(&[bytes, bytes].concat()),
            Some(ReplyFault::Noise) => wire.send(&[&b"\x00\xffx~"[..], bytes].concat()),
        }
    }
}

/// A link on which reads wait at most a few milliseconds.
pub trait Wire {
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

/// How long a read waits, so that alerts and shutdown are seen.
const PATIENCE: Duration = Duration::from_millis(5);

impl Wire for TcpStream {
    fn receive(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.set_read_timeout(Some(PATIENCE))?;
        match self.read(into) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            // Interrupted: this process was stopped, and goes on.
            Err(e) if is_timeout(&e) || e.kind() == io::ErrorKind::Interrupted => Ok(0),
            other => other,
        }
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }
}

/// A pseudo-terminal whose slave is raw and stays open: without a client the master would read EIO.
#[derive(Debug)]
pub(crate) struct Pty {
    master: OwnedFd,
    slave: OwnedFd,
    path: String,
}

impl Pty {
    /// Opens a new pair.
    ///
    /// # Errors
    /// What the system reports.
    pub(crate) fn open() -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, Vec::new())?.to_string_lossy().into_owned();
        let slave = open(
            &*path,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        Ok(Self {
            master,
            slave,
            path,
        })
    }

    /// Path of the slave, e.g. `/dev/pts/3`.
    pub(crate) fn path(&self) -> &str {
        &self.path
    }
}

impl Wire for Pty {
    fn receive(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let wait = Timespec {
            tv_sec: 0,
            tv_nsec: PATIENCE.as_nanos() as i64,
        };
        let mut fds = [PollFd::new(&self.master, PollFlags::IN)];
        if retry_on_intr(|| poll(&mut fds, Some(&wait)))? == 0 {
            return Ok(0);
        }
        Ok(rustix::io::read(&self.master, into)?)
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut rest = bytes;
        let wait = Timespec {
            tv_sec: TAKEN.as_secs() as i64,
            tv_nsec: 0,
        };
        while !rest.is_empty() {
            // Without a client the terminal fills up, and a write would wait for ever.
            let mut fds = [PollFd::new(&self.master, PollFlags::OUT)];
            if retry_on_intr(|| poll(&mut fds, Some(&wait)))? == 0 {
                return Err(io::ErrorKind::TimedOut.into());
            }
            let sent = rustix::io::write(&self.master, rest)?;
            rest = &rest[sent..];
        }
        Ok(())
    }

    fn baud(&self) -> Option<u32> {
        tcgetattr(&self.slave).ok().map(|t| t.output_speed())
    }
}
