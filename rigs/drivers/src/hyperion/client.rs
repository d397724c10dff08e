//! A Hyperion unit: one connection for commands, one for streamed peaks.

use super::frame::{self, Response};
use crate::link::Link;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
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
    interrupt: Interrupt,
}

/// One connection with its unread bytes.
#[derive(Debug)]
struct Channel {
    link: Link,
    buffer: Vec<u8>,
    /// Responses that had not come when their command was given up.
    owed: usize,
}

impl Channel {
    fn connect(address: &str, interrupt: &Interrupt) -> Result<Self, DeviceError> {
        let link = Link::connect(format!("hyperion {address}"), address, interrupt)?;
        Ok(Self {
            link,
            buffer: Vec::new(),
            owed: 0,
        })
    }

    fn next_response(&mut self, action: &str) -> Result<Option<Response>, DeviceError> {
        let parsed = frame::response(&self.buffer).map_err(|found| self.protocol(action, found))?;
        Ok(parsed.map(|(response, length)| {
            self.buffer.drain(..length);
            response
        }))
    }

    fn protocol(&self, action: &str, found: String) -> DeviceError {
        DeviceError::new(
            DeviceErrorKind::Protocol,
            &self.link.name,
            action,
            "a response",
            found,
        )
    }

    /// Sends a command and returns its response. Responses have no number, but come in the order of
    /// their commands: those that are late for earlier ones are left out.
    fn ask(&mut self, command: &str, arguments: &[u8]) -> Result<Response, DeviceError> {
        self.link
            .send(&frame::request(command, arguments, false), command)?;
        self.owed += 1;
        let deadline = self.link.deadline(REPLY);
        loop {
            while let Some(response) = self.next_response(command)? {
                self.owed = self.owed.saturating_sub(1);
                if self.owed > 0 {
                    continue;
                }
                if response.status == 0 {
                    return Ok(response);
                }
                let (kind, found) = (
                    DeviceErrorKind::Rejected,
                    format!("status {}: {}", response.status, response.message),
                );
                return Err(DeviceError::new(
                    kind,
                    &self.link.name,
                    command,
                    "status 0",
                    found,
                ));
            }
            let take = |b: &[u8]| self.buffer.extend_from_slice(b);
            if deadline.is_over() || !self.link.receive(command, &deadline, take)? {
                return Err(deadline.error(&self.link.name, command, "a reply", "none"));
            }
        }
    }
}

impl Hyperion {
    /// Connects to the command port; `peaks` is the address of the peak stream.
    ///
    /// # Errors
    /// `Disconnected` when nothing listens there, `Timeout` when nobody answers.
    pub fn connect(
        commands: &str,
        peaks: &str,
        rate_hz: f64,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let commands = Channel::connect(commands, interrupt)?;
        let (peaks_address, interrupt) = (peaks.to_owned(), interrupt.clone());
        Ok(Self {
            commands,
            peaks_address,
            peaks: None,
            clock,
            rate_hz,
            interrupt,
        })
    }

    /// One scan on request.
    ///
    /// # Errors
    /// `Protocol` when the record cannot be decoded, or what the link reports.
    pub fn scan(&mut self) -> Result<FbgReading, DeviceError> {
        let response = self.commands.ask("#GetPeaks", b"")?;
        frame::peaks(&response.content, self.clock.now_s())
            .map_err(|e| self.commands.protocol("scan", e))
    }
}

impl Interrogator for Hyperion {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let mut text = |command: &str| {
            self.commands
                .ask(command, b"")
                .map(|r| r.message.trim().to_owned())
        };
        let serial = text("#GetSerialNumber")?;
        let model = text("#GetInstrumentName")?;
        let firmware = text("#GetFirmwareVersion")?;
        Ok(DeviceIdentity {
            driver: "hyperion".to_owned(),
            model,
            serial,
            firmware,
            settings: Vec::new(),
        })
    }

    fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    fn start(&mut self) -> Result<(), DeviceError> {
        let mut peaks = Channel::connect(&self.peaks_address, &self.interrupt)?;
        peaks.ask("#EnablePeakDataStreaming", b"")?;
        self.peaks = Some(peaks);
        Ok(())
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        let Some(peaks) = self.peaks.as_mut() else {
            let name = &self.commands.link.name;
            let kind = DeviceErrorKind::Configuration;
            return Err(DeviceError::new(
                kind,
                name,
                "read the stream",
                "a started stream",
                "none",
            ));
        };
        let deadline = peaks.link.deadline(timeout);
        peaks.link.receive("read the stream", &deadline, |b| {
            peaks.buffer.extend_from_slice(b)
        })?;
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
