//! The interrogator at the other end of a TCP connection.

use super::stream::{Item, StreamDecoder};
use crate::host::{io_error, is_timeout};
use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use wcal_core::clock::HostClock;
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, FbgReading, Interrogator};

/// Longest wait for the reply to a command.
const REPLY: Duration = Duration::from_secs(3);

/// An sm130 or another unit of the x30 core.
#[derive(Debug)]
pub struct Sm130 {
    link: TcpStream,
    name: String,
    decoder: StreamDecoder,
    clock: HostClock,
    rate_hz: f64,
    streaming: bool,
}

impl Sm130 {
    /// Connects; `rate_hz` is the scan rate of the model (1000 or 2000 over the divider).
    ///
    /// # Errors
    /// `Disconnected` when nothing listens there.
    pub fn connect(address: &str, rate_hz: f64, clock: HostClock) -> Result<Self, DeviceError> {
        let name = format!("sm130 {address}");
        let action = "connect";
        let targets = address.to_socket_addrs().map_err(|e| io_error(&name, action, &e))?;
        let mut last = None;
        for target in targets {
            match TcpStream::connect_timeout(&target, REPLY) {
                Ok(link) => {
                    link.set_nodelay(true).map_err(|e| io_error(&name, action, &e))?;
                    let decoder = StreamDecoder::default();
                    return Ok(Self { link, name, decoder, clock, rate_hz, streaming: false });
                }
                Err(e) => last = Some(e),
            }
        }
        let found = last.map_or_else(|| "no such host".to_owned(), |e| e.to_string());
        Err(DeviceError::new(DeviceErrorKind::Disconnected, name, action, "a listening unit", found))
    }

    /// Bytes of the stream that belonged to no frame.
    #[must_use]
    pub fn skipped_bytes(&self) -> u64 {
        self.decoder.skipped()
    }

    /// Sends a command and returns its text reply.
    ///
    /// # Errors
    /// `Timeout`, `Disconnected`, or `Protocol` when a frame came instead of text.
    pub fn command(&mut self, command: &str) -> Result<String, DeviceError> {
        self.send(command)?;
        match self.item(command, |item| !matches!(item, Item::Frame(_)))? {
            Item::Text(text) => Ok(text),
            other => Err(self.fail(DeviceErrorKind::Protocol, command, "text", format!("{other:?}"))),
        }
    }

    /// One scan on request.
    ///
    /// # Errors
    /// As for [`Self::command`].
    pub fn scan(&mut self) -> Result<FbgReading, DeviceError> {
        self.send("#GET_UNBUFFERED_DATA")?;
        match self.item("#GET_UNBUFFERED_DATA", |_| true)? {
            Item::Frame(frame) => Ok(frame.reading(self.clock.now_s())),
            other => Err(self.fail(DeviceErrorKind::Protocol, "scan", "a data frame", format!("{other:?}"))),
        }
    }

    fn fail(&self, kind: DeviceErrorKind, action: &str, expected: &str, found: String) -> DeviceError {
        DeviceError::new(kind, &self.name, action, expected, found)
    }

    fn send(&mut self, command: &str) -> Result<(), DeviceError> {
        self.link.write_all(format!("{command}\n").as_bytes()).map_err(|e| io_error(&self.name, command, &e))
    }

    /// Waits for the first wanted item.
    fn item(&mut self, action: &str, wanted: impl Fn(&Item) -> bool) -> Result<Item, DeviceError> {
        let end = Instant::now() + REPLY;
        loop {
            while let Some(item) = self.decoder.next_item() {
                if wanted(&item) {
                    return Ok(item);
                }
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() || !self.fill(action, left)? {
                let found = format!("nothing in {} s", REPLY.as_secs());
                return Err(self.fail(DeviceErrorKind::Timeout, action, "a reply", found));
            }
        }
    }

    /// Reads what is there; false when nothing came in time.
    fn fill(&mut self, action: &str, wait: Duration) -> Result<bool, DeviceError> {
        let fail = |e: std::io::Error| io_error(&self.name, action, &e);
        self.link.set_read_timeout(Some(wait.max(Duration::from_millis(1)))).map_err(fail)?;
        let mut bytes = [0_u8; 64 * 1024];
        match self.link.read(&mut bytes) {
            Ok(0) => Err(self.fail(
                DeviceErrorKind::Disconnected,
                action,
                "data",
                "the unit closed the connection".to_owned(),
            )),
            Ok(count) => {
                self.decoder.push(&bytes[..count]);
                Ok(true)
            }
            Err(e) if is_timeout(&e) => Ok(false),
            Err(e) => Err(io_error(&self.name, action, &e)),
        }
    }
}

impl Interrogator for Sm130 {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let mut ask = |command: &str| self.command(command).map(|t| t.trim().to_owned());
        let model = ask("#IDN?")?;
        let serial = ask("#GET_SN")?;
        let mut settings = Vec::new();
        for command in ["#GET_CAPABILITIES", "#GET_NUM_DUT_CHANNELS", "#GET_DATA_RATE_DIVIDER"] {
            settings.push((command[5..].to_lowercase(), ask(command)?));
        }
        Ok(DeviceIdentity {
            driver: "sm130".to_owned(),
            firmware: model.split_whitespace().last().unwrap_or_default().to_owned(),
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
            let expected = "Streaming data enabled.";
            return Err(self.fail(DeviceErrorKind::Rejected, "start streaming", expected, reply));
        }
        self.streaming = true;
        self.decoder.set_streaming(true);
        Ok(())
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        self.fill("read the stream", timeout)?;
        let host_s = self.clock.now_s();
        let mut readings = Vec::new();
        while let Some(item) = self.decoder.next_item() {
            if let Item::Frame(frame) = item {
                readings.push(frame.reading(host_s));
            }
        }
        Ok(readings)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if !std::mem::take(&mut self.streaming) {
            return Ok(());
        }
        self.send("#SET_STREAMING_DATA 0")?;
        self.item("stop streaming", |i| matches!(i, Item::Stopped))?;
        self.decoder.set_streaming(false);
        Ok(())
    }
}
