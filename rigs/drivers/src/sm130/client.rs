//! The interrogator at the other end of a TCP connection.

use super::stream::{StreamDecoder, StreamItem};
use crate::link::{Link, REPLY};
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, FbgReading, Interrogator};

/// An sm130 or another unit of the x30 core.
#[derive(Debug)]
pub struct Sm130 {
    link: Link,
    decoder: StreamDecoder,
    clock: HostClock,
    rate_hz: f64,
    streaming: bool,
}

impl Sm130 {
    /// Connects; `rate_hz` is the scan rate of the model (1000 or 2000 over the divider).
    ///
    /// # Errors
    /// `Disconnected` when nothing listens there, `Timeout` when nobody answers.
    pub fn connect(
        address: &str,
        rate_hz: f64,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let link = Link::connect(format!("sm130 {address}"), address, interrupt)?;
        Ok(Self {
            link,
            decoder: StreamDecoder::default(),
            clock,
            rate_hz,
            streaming: false,
        })
    }

    /// Bytes of the stream that belonged to no frame.
    pub fn skipped_bytes(&self) -> u64 {
        self.decoder.skipped()
    }

    /// Sends a command and returns its text reply.
    ///
    /// # Errors
    /// `Timeout`, `Disconnected`, or `Protocol` when a frame came instead of text.
    pub fn command(&mut self, command: &str) -> Result<String, DeviceError> {
        self.send(command)?;
        // Replies carry no number: those of commands given up come first, and are left out.
        self.link.owed += 1;
        let deadline = self.link.deadline(REPLY);
        loop {
            let found = self.item(command, &deadline, |item| {
                !matches!(item, StreamItem::Frame(_))
            })?;
            self.link.owed -= 1;
            match found {
                _ if self.link.owed > 0 => {}
                StreamItem::Text(text) => return Ok(text),
                other => return Err(self.other(command, "text", &other)),
            }
        }
    }

    fn other(&self, action: &str, expected: &str, found: &StreamItem) -> DeviceError {
        let found = format!("{found:?}");
        self.link
            .error(DeviceErrorKind::Protocol, action, expected, found)
    }

    fn send(&mut self, command: &str) -> Result<(), DeviceError> {
        self.link.send(format!("{command}\n").as_bytes(), command)
    }

    /// Waits for the first wanted item.
    fn item(
        &mut self,
        action: &str,
        deadline: &Deadline,
        wanted: impl Fn(&StreamItem) -> bool,
    ) -> Result<StreamItem, DeviceError> {
        let decoder = &mut self.decoder;
        self.link.wait(action, "a reply", deadline, |link| {
            decoder.take(&mut link.buffer);
            Ok(std::iter::from_fn(|| decoder.next_item()).find(&wanted))
        })
    }
}

impl Interrogator for Sm130 {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let mut ask = |command: &str| self.command(command).map(|t| t.trim().to_owned());
        let model = ask("#IDN?")?;
        let serial = ask("#GET_SN")?;
        // Kept with the session: a divider that somebody else has set changes the rate.
        let mut settings = Vec::new();
        for command in [
            "#GET_CAPABILITIES",
            "#GET_NUM_DUT_CHANNELS",
            "#GET_DATA_RATE_DIVIDER",
        ] {
            settings.push((command[5..].to_lowercase(), ask(command)?));
        }
        Ok(DeviceIdentity {
            driver: "sm130".to_owned(),
            firmware: model
                .split_whitespace()
                .last()
                .unwrap_or_default()
                .to_owned(),
            model,
            serial,
            settings,
        })
    }

    fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    fn start(&mut self) -> Result<(), DeviceError> {
        let reply = self.command("#SET_STREAMING_DATA 1")?;
        if !reply.contains("enabled") {
            let (kind, expected) = (DeviceErrorKind::Rejected, "Streaming data enabled.");
            return Err(self.link.error(kind, "start streaming", expected, reply));
        }
        self.streaming = true;
        self.decoder.set_streaming(true);
        Ok(())
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        let deadline = self.link.deadline(timeout);
        self.link.receive("read the stream", &deadline)?;
        // One arrival time for a block of scans: the least delayed ones align the clocks.
        let host_s = self.clock.now_s();
        self.decoder.take(&mut self.link.buffer);
        let frame = |item| match item {
            StreamItem::Frame(frame) => Some(frame.reading(host_s)),
            _ => None,
        };
        let items = std::iter::from_fn(|| self.decoder.next_item());
        Ok(items.filter_map(frame).collect())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if !std::mem::take(&mut self.streaming) {
            return Ok(());
        }
        self.send("#SET_STREAMING_DATA 0")?;
        // What still streams does not prolong the wait; a user who wants an end gets it.
        self.item("stop streaming", &Deadline::uninterruptible(REPLY), |i| {
            matches!(i, StreamItem::Stopped)
        })?;
        self.decoder.set_streaming(false);
        Ok(())
    }
}
