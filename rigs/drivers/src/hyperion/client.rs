//! A Hyperion unit: one connection for commands, one for streamed peaks.

use super::frame::{self, Response};
use crate::link::{Link, REPLY};
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, FbgReading, Interrogator};

const READ: &str = "read the stream";

/// A connected unit.
#[derive(Debug)]
pub struct Hyperion {
    commands: Link,
    peaks_address: String,
    peaks: Option<Link>,
    clock: HostClock,
    rate_hz: f64,
    interrupt: Interrupt,
}

fn link(address: &str, interrupt: &Interrupt) -> Result<Link, DeviceError> {
    Link::connect(format!("hyperion {address}"), address, interrupt)
}

fn next_response(link: &mut Link, action: &str) -> Result<Option<Response>, DeviceError> {
    let parsed = frame::response(&link.buffer).map_err(|found| protocol(link, action, found))?;
    Ok(parsed.map(|(response, length)| {
        link.buffer.drain(..length);
        response
    }))
}

fn protocol(link: &Link, action: &str, found: String) -> DeviceError {
    link.error(DeviceErrorKind::Protocol, action, "a response", found)
}

/// Sends a command and returns its response.
fn ask(link: &mut Link, command: &str) -> Result<Response, DeviceError> {
    link.send(&frame::request(command, b"", false), command)?;
    // Responses carry no number: those of commands given up come first, and are left out.
    link.owed += 1;
    let deadline = link.deadline(REPLY);
    let response = link.wait(command, "a reply", &deadline, |link| {
        while let Some(response) = next_response(link, command)? {
            link.owed = link.owed.saturating_sub(1);
            if link.owed == 0 {
                return Ok(Some(response));
            }
        }
        Ok(None)
    })?;
    if response.status == 0 {
        return Ok(response);
    }
    let found = format!("status {}: {}", response.status, response.message);
    Err(link.error(DeviceErrorKind::Rejected, command, "status 0", found))
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
        Ok(Self {
            commands: link(commands, interrupt)?,
            peaks_address: peaks.to_owned(),
            peaks: None,
            clock,
            rate_hz,
            interrupt: interrupt.clone(),
        })
    }
}

impl Interrogator for Hyperion {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let mut text =
            |command: &str| ask(&mut self.commands, command).map(|r| r.message.trim().to_owned());
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
        // Assumed (?): records stream as responses on the port of the peaks.
        let mut peaks = link(&self.peaks_address, &self.interrupt)?;
        ask(&mut peaks, "#EnablePeakDataStreaming")?;
        self.peaks = Some(peaks);
        Ok(())
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        let Some(peaks) = self.peaks.as_mut() else {
            let (kind, expected) = (DeviceErrorKind::Configuration, "a started stream");
            return Err(self.commands.error(kind, READ, expected, "none"));
        };
        let deadline = peaks.deadline(timeout);
        peaks.receive(READ, &deadline)?;
        // One arrival time for a block of scans: the least delayed ones align the clocks.
        let host_s = self.clock.now_s();
        let mut readings = Vec::new();
        while let Some(response) = next_response(peaks, READ)? {
            let reading = frame::peaks(&response.content, host_s);
            readings.push(reading.map_err(|e| protocol(peaks, READ, e))?);
        }
        Ok(readings)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        // Closing the stream's own connection ends it.
        self.peaks = None;
        Ok(())
    }
}
