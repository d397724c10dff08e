//! A TCP connection on which nothing waits longer than its deadline, whatever the other end does.

use crate::host::{io_error, is_timeout};
use crate::trouble;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind};

/// Longest wait for a connection: an address that nobody answers at would take the system two
/// minutes.
pub(crate) const CONNECT: Duration = Duration::from_secs(3);
/// Longest wait until the other end takes what is sent.
const SEND: Duration = Duration::from_secs(3);
/// Longest wait for the reply to a command.
pub(crate) const REPLY: Duration = Duration::from_secs(3);

/// Connects to `host:port`. Names are resolved and the handshake is made in its own thread, since
/// neither can be interrupted.
///
/// # Errors
/// What the system says, or `TimedOut` when the deadline is over.
pub(crate) fn connect(address: &str, deadline: &Deadline) -> io::Result<TcpStream> {
    let (sender, receiver) = channel();
    // `connect_timeout` takes a time of zero for an error.
    let (target, allowed) = (
        address.to_owned(),
        deadline.remaining().max(Duration::from_millis(1)),
    );
    let work = move || {
        let mut last = io::Error::new(ErrorKind::NotFound, "no such host");
        for one in target.to_socket_addrs()? {
            match TcpStream::connect_timeout(&one, allowed) {
                Ok(stream) => return Ok(stream),
                Err(e) => last = e,
            }
        }
        Err(last)
    };
    std::thread::Builder::new()
        .name("connect".to_owned())
        .spawn(move || {
            // Whoever waited may be gone by now.
            let _ = sender.send(work());
        })?;
    loop {
        match receiver.recv_timeout(deadline.slice()) {
            Ok(found) => return found,
            Err(RecvTimeoutError::Timeout) if !deadline.is_over() => {}
            Err(_) => return Err(ErrorKind::TimedOut.into()),
        }
    }
}

/// Reads or sends within the deadline. The last attempt begins after its end: what came while this
/// program did not get to run is no silence.
///
/// # Errors
/// `TimedOut` when nothing came or went, `BrokenPipe` when the other end closed, else what the
/// system says.
pub(crate) fn attempts(
    deadline: &Deadline,
    mut attempt: impl FnMut(Duration) -> io::Result<usize>,
) -> io::Result<usize> {
    loop {
        let over = deadline.is_over();
        match attempt(deadline.slice()) {
            Ok(0) => return Err(io::Error::new(ErrorKind::BrokenPipe, "the link is closed")),
            Err(e) if is_timeout(&e) || e.kind() == ErrorKind::Interrupted => {
                if over {
                    return Err(ErrorKind::TimedOut.into());
                }
            }
            other => return other,
        }
    }
}

/// Reads what is there within the deadline.
///
/// # Errors
/// As [`attempts`].
pub(crate) fn read(
    stream: &mut TcpStream,
    into: &mut [u8],
    deadline: &Deadline,
) -> io::Result<usize> {
    attempts(deadline, |slice| {
        // In short slices: an interrupt is heard between two of them.
        stream.set_read_timeout(Some(slice))?;
        stream.read(into)
    })
}

/// Sends some of the bytes within the deadline.
///
/// # Errors
/// As [`attempts`].
pub(crate) fn write(
    stream: &mut TcpStream,
    bytes: &[u8],
    deadline: &Deadline,
) -> io::Result<usize> {
    attempts(deadline, |slice| {
        stream.set_write_timeout(Some(slice))?;
        stream.write(bytes)
    })
}

/// A connection of a device, which its errors name.
#[derive(Debug)]
pub(crate) struct Link {
    stream: TcpStream,
    name: String,
    interrupt: Interrupt,
    /// What came and was not taken yet.
    pub(crate) buffer: Vec<u8>,
    /// Replies that had not come when their command was given up. Replies have no number, but come
    /// in the order of their commands: those that are late for earlier ones are left out.
    pub(crate) owed: usize,
}

impl Link {
    /// Connects the device `name`.
    ///
    /// # Errors
    /// `Disconnected` when nothing listens there, `Timeout` when nobody answers.
    pub(crate) fn connect(
        name: String,
        address: &str,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let deadline = Deadline::after(CONNECT, interrupt);
        let made = connect(address, &deadline)
            .and_then(|stream| stream.set_nodelay(true).map(|()| stream));
        match made {
            Ok(stream) => Ok(Self {
                stream,
                name,
                interrupt: interrupt.clone(),
                buffer: Vec::new(),
                owed: 0,
            }),
            Err(e) => Err(trouble::of_connection(&name, address, &e, &deadline)),
        }
    }

    /// An error of the device.
    pub(crate) fn error(
        &self,
        kind: DeviceErrorKind,
        action: &str,
        expected: &str,
        found: impl Into<String>,
    ) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }

    /// A deadline from now on.
    pub(crate) fn deadline(&self, allowed: Duration) -> Deadline {
        Deadline::after(allowed, &self.interrupt)
    }

    /// Sends everything.
    ///
    /// # Errors
    /// `Timeout` when the unit does not take it, `Disconnected`, or `Interrupted`.
    pub(crate) fn send(&mut self, bytes: &[u8], action: &str) -> Result<(), DeviceError> {
        let deadline = self.deadline(SEND);
        let mut rest = bytes;
        while !rest.is_empty() {
            match write(&mut self.stream, rest, &deadline) {
                Ok(count) => rest = &rest[count..],
                Err(e) if is_timeout(&e) => {
                    let expected = "a unit that takes what is sent";
                    return Err(deadline.error(&self.name, action, expected, "one that does not"));
                }
                Err(e) => return Err(io_error(&self.name, action, &e)),
            }
        }
        Ok(())
    }

    /// Puts what came into the buffer; false when nothing came until the deadline.
    ///
    /// # Errors
    /// `Disconnected` when the link is gone, `Interrupted` when the user wants an end.
    pub(crate) fn receive(
        &mut self,
        action: &str,
        deadline: &Deadline,
    ) -> Result<bool, DeviceError> {
        let mut bytes = [0_u8; 64 * 1024];
        match read(&mut self.stream, &mut bytes, deadline) {
            Ok(count) => {
                self.buffer.extend_from_slice(&bytes[..count]);
                Ok(true)
            }
            Err(e) if is_timeout(&e) => self.interrupt.check(&self.name, action).map(|()| false),
            Err(e) => Err(io_error(&self.name, action, &e)),
        }
    }

    /// The first thing that `find` finds in what came.
    ///
    /// # Errors
    /// `Timeout` where it was not `expected` in time, what `find` says, or as [`Self::receive`].
    pub(crate) fn wait<T>(
        &mut self,
        action: &str,
        expected: &str,
        deadline: &Deadline,
        mut find: impl FnMut(&mut Self) -> Result<Option<T>, DeviceError>,
    ) -> Result<T, DeviceError> {
        loop {
            if let Some(found) = find(self)? {
                return Ok(found);
            }
            if deadline.is_over() || !self.receive(action, deadline)? {
                return Err(deadline.error(&self.name, action, expected, "none"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::*;
    use std::net::TcpListener;
    use wcal_core::deadline::Signal;

    /// A listener that accepts nobody, with a full queue: the next connection is not answered.
    fn full() -> (TcpListener, Vec<TcpStream>, String) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let waiting = std::iter::from_fn(|| {
            TcpStream::connect_timeout(&address, Duration::from_millis(300)).ok()
        });
        (listener, waiting.take(900).collect(), address.to_string())
    }

    #[test]
    fn a_connection_that_nobody_answers_ends_with_its_deadline_or_an_interrupt() {
        let (_listener, waiting, address) = full();
        let interrupt = Interrupt::default();
        if waiting.len() < 900 {
            let why = Link::connect("unit".to_owned(), &address, &interrupt).unwrap_err();
            assert_eq!(why.kind, DeviceErrorKind::Timeout, "{why}");
        }
        interrupt.set(Signal::Terminate);
        let why = Link::connect("unit".to_owned(), &address, &interrupt).unwrap_err();
        assert_eq!(why.kind, DeviceErrorKind::Interrupted, "{why}");
        // Controls: one that listens, and one that refuses.
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let never = Interrupt::default();
        Link::connect("unit".to_owned(), &address, &never).unwrap();
        drop(listener);
        let why = Link::connect("unit".to_owned(), &address, &never).unwrap_err();
        assert_eq!(why.kind, DeviceErrorKind::Disconnected, "{why}");
    }

    /// Who did not get to run until its wait was over looks once more.
    #[test]
    fn what_came_in_a_wait_that_was_slept_through_is_read() {
        let of = |comes: bool| {
            let (deadline, mut tries) = (Deadline::uninterruptible(Duration::from_millis(20)), 0);
            let found = attempts(&deadline, |_| {
                tries += 1;
                if tries == 1 {
                    std::thread::sleep(Duration::from_millis(40));
                }
                if comes && tries == 2 {
                    Ok(5)
                } else {
                    Err(ErrorKind::WouldBlock.into())
                }
            });
            (found.map_err(|e| e.kind()), tries)
        };
        assert_eq!(of(true), (Ok(5), 2));
        assert_eq!(of(false), (Err(ErrorKind::TimedOut), 2), "control");
    }

    #[test]
    fn a_unit_that_takes_nothing_and_says_nothing_is_not_waited_for() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let never = Interrupt::default();
        let mut link = Link::connect("unit".to_owned(), &address, &never).unwrap();
        let short = link.deadline(Duration::from_millis(30));
        assert!(!link.receive("read", &short).unwrap());
        // More than both ends can hold.
        let why = link.send(&vec![0; 64 << 20], "send").unwrap_err();
        assert_eq!(why.kind, DeviceErrorKind::Timeout, "{why}");
    }
}
