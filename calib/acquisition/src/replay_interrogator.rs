//! A recording as an interrogator: the same scans, once more, for every caller of the trait.

use crate::replay::{End, Message, read};
use std::collections::VecDeque;
use std::path::Path;
use std::time::Duration;
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, FbgReading, Interrogator};

/// Scans given at once: as many as a busy host reads from a real unit.
const BATCH: usize = 200;

/// Scans of a recording, first to last, as fast as they are taken.
#[derive(Debug)]
pub struct ReplayInterrogator {
    name: String,
    scans: VecDeque<FbgReading>,
    end: End,
}

impl ReplayInterrogator {
    /// Opens a recording.
    ///
    /// # Errors
    /// `Configuration` when it cannot be read or has no scan.
    pub fn open(path: &Path) -> Result<Self, DeviceError> {
        let name = format!("replay {}", path.display());
        let fail = |found: String| {
            let kind = DeviceErrorKind::Configuration;
            DeviceError::new(kind, &name, "open", "a recording with scans", found)
        };
        let mut scans = VecDeque::new();
        let end = read(path, |message| {
            if let Message::Scan(scan) = message {
                scans.push_back(scan.reading());
            }
        })
        .map_err(|e| fail(e.to_string()))?;
        if scans.is_empty() {
            return Err(fail("none".to_owned()));
        }
        Ok(Self { name, scans, end })
    }
}

impl Interrogator for ReplayInterrogator {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        Ok(DeviceIdentity {
            driver: "replay".to_owned(),
            model: format!("{} scans", self.scans.len()),
            settings: vec![("end".to_owned(), self.end.to_string())],
            ..DeviceIdentity::default()
        })
    }

    fn rate_hz(&self) -> f64 {
        // By the device's clock: a recording does not state the unit's rate.
        let time = |r: Option<&FbgReading>| r.and_then(|r| r.clocks.device_s);
        let span_s = time(self.scans.back())
            .zip(time(self.scans.front()))
            .map_or(0.0, |(b, a)| b - a);
        if span_s > 0.0 {
            (self.scans.len() - 1) as f64 / span_s
        } else {
            0.0
        }
    }

    fn start(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn read(&mut self, _timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        // Its end is a device that went away: callers end as they do with a live unit.
        if self.scans.is_empty() {
            let (kind, found) = (DeviceErrorKind::Disconnected, "the end of the recording");
            return Err(DeviceError::new(
                kind,
                &self.name,
                "read the stream",
                "scans",
                found,
            ));
        }
        let count = BATCH.min(self.scans.len());
        Ok(self.scans.drain(..count).collect())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}
