//! A Hyperion unit: one connection for commands, one for streamed peaks.

use super::frame::{self, Response};
use crate::host::{io_error, is_timeout};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use wcal_core::clock::HostClock;
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, FbgReading, Interrogator};

/// Longest wait for the reply to a command.
const REPLY: Duration = Duration::from_secs(3);

/// A connected unit.
#[derive(Debug)]
pub struct Hyperion {
    commands: Channel,
    peaks_address: String,
    peaks: Option<Channel>,
    clock: HostClock,
    rate_hz: f64,
}

/// One connection with its unread bytes.
#[derive(Debug)]
struct Channel {
    link: TcpStream,
    name: String,
    buffer: Vec<u8>,
}

impl Channel {
    fn connect(address: &str) -> Result<Self, DeviceError> {
        let name = format!("hyperion {address}");
        let link = TcpStream::connect(address).map_err(|e| {
            let found = e.to_string();
            DeviceError::new(DeviceErrorKind::Disconnected, &name, "connect", "a listening unit", found)
        })?;
        link.set_nodelay(true).map_err(|e| io_error(&name, "connect", &e))?;
        Ok(Self { link, name, buffer: Vec::new() })
    }

    fn fill(&mut self, action: &str, wait: Duration) -> Result<bool, DeviceError> {
        let fail = |e: std::io::Error| io_error(&self.name, action, &e);
        self.link.set_read_timeout(Some(wait.max(Duration::from_millis(1)))).map_err(fail)?;
        let mut bytes = [0_u8; 64 * 1024];
        match self.link.read(&mut bytes) {
            Ok(0) => {
                let found = "the unit closed the connection";
                Err(DeviceError::new(DeviceErrorKind::Disconnected, &self.name, action, "data", found))
            }
            Ok(n) => {
                self.buffer.extend_from_slice(&bytes[..n]);
                Ok(true)
            }
            Err(e) if is_timeout(&e) => Ok(false),
            Err(e) => Err(io_error(&self.name, action, &e)),
        }
    }

    fn next_response(&mut self, action: &str) -> Result<Option<Response>, DeviceError> {
        let parsed = frame::response(&self.buffer).map_err(|found| self.protocol(action, found))?;
        Ok(parsed.map(|(response, length)| {
            self.buffer.drain(..length);
            response
        }))
    }

    fn protocol(&self, action: &str, found: String) -> DeviceError {
        DeviceError::new(DeviceErrorKind::Protocol, &self.name, action, "a response", found)
    }

    fn ask(&mut self, command: &str, arguments: &[u8]) -> Result<Response, DeviceError> {
        let bytes = frame::request(command, arguments, false);
        self.link.write_all(&bytes).map_err(|e| io_error(&self.name, command, &e))?;
        let end = Instant::now() + REPLY;
        loop {
            if let Some(response) = self.next_response(command)? {
                if response.status == 0 {
                    return Ok(response);
                }
                let found = format!("status {}: {}", response.status, response.message);
                return Err(DeviceError::new(
                    DeviceErrorKind::Rejected,
                    &self.name,
                    command,
                    "status 0",
                    found,
                ));
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() || !self.fill(command, left)? {
                let kind = DeviceErrorKind::Timeout;
                return Err(DeviceError::new(kind, &self.name, command, "a reply", "nothing in time"));
            }
        }
    }
}

impl Hyperion {
    /// Connects to the command port; `peaks` is the address of the peak stream.
    ///
    /// # Errors
    /// `Disconnected` when nothing listens there.
    pub fn connect(commands: &str, peaks: &str, rate_hz: f64, clock: HostClock) -> Result<Self, DeviceError> {
        let commands = Channel::connect(commands)?;
        Ok(Self { commands, peaks_address: peaks.to_owned(), peaks: None, clock, rate_hz })
    }

    /// One scan on request.
    ///
    /// # Errors
    /// `Protocol` when the record cannot be decoded, or what the link reports.
    pub fn scan(&mut self) -> Result<FbgReading, DeviceError> {
        let response = self.commands.ask("#GetPeaks", b"")?;
        frame::peaks(&response.content, self.clock.now_s()).map_err(|e| self.commands.protocol("scan", e))
    }
}

impl Interrogator for Hyperion {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let mut text = |command: &str| self.commands.ask(command, b"").map(|r| r.message.trim().to_owned());
        let serial = text("#GetSerialNumber")?;
        let model = text("#GetInstrumentName")?;
        let firmware = text("#GetFirmwareVersion")?;
        Ok(DeviceIdentity { driver: "hyperion".to_owned(), model, serial, firmware, settings: Vec::new() })
    }

    fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    fn start(&mut self) -> Result<(), DeviceError> {
        let mut peaks = Channel::connect(&self.peaks_address)?;
        peaks.ask("#EnablePeakDataStreaming", b"")?;
        self.peaks = Some(peaks);
        Ok(())
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        let Some(peaks) = self.peaks.as_mut() else {
            let name = &self.commands.name;
            let kind = DeviceErrorKind::Configuration;
            return Err(DeviceError::new(kind, name, "read the stream", "a started stream", "none"));
        };
        peaks.fill("read the stream", timeout)?;
        let host_s = self.clock.now_s();
        let mut readings = Vec::new();
        while let Some(response) = peaks.next_response("read the stream")? {
            let reading = frame::peaks(&response.content, host_s);
            readings.push(reading.map_err(|e| peaks.protocol("read the stream", e))?);
        }
        Ok(readings)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        // Closing the stream's own connection ends it.
        self.peaks = None;
        Ok(())
    }
}
