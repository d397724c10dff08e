//! Two cameras as one: frames of one trigger, their skew measured, pairs past a limit refused.

use std::time::Duration;
use wcal_core::device::{Camera, CameraFrame, DeviceError, DeviceErrorKind, DeviceIdentity};

/// A pair of one trigger.
#[derive(Debug, Clone, PartialEq)]
pub struct FramePair {
    /// First and second camera.
    pub frames: [CameraFrame; 2],
    /// Start of exposure of the second after the first, ms.
    pub skew_ms: f64,
}

/// A pair of cameras.
pub struct CameraPair {
    cameras: [Box<dyn Camera + Send>; 2],
    limit_ms: f64,
    refused: u64,
    last: Option<FramePair>,
    host_s: f64,
}

/// Frames that one camera may be ahead of the other.
const AHEAD: usize = 32;

impl CameraPair {
    /// Two cameras and the largest skew, ms.
    #[must_use]
    pub fn new(cameras: [Box<dyn Camera + Send>; 2], limit_ms: f64) -> Self {
        Self { cameras, limit_ms, refused: 0, last: None, host_s: 0.0 }
    }

    /// What both say of themselves.
    ///
    /// # Errors
    /// When a unit does not answer.
    pub fn identities(&mut self) -> Result<[DeviceIdentity; 2], DeviceError> {
        let [first, second] = &mut self.cameras;
        Ok([first.identity()?, second.identity()?])
    }

    /// Host time of the newest frame, s.
    #[must_use]
    pub fn host_s(&self) -> f64 {
        self.host_s
    }

    /// Pairs refused so far.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The next pair of one trigger.
    ///
    /// # Errors
    /// `DataInvalid` for a pair past the limit or a frozen camera; else what a camera reports.
    pub fn grab(&mut self, timeout: Duration) -> Result<FramePair, DeviceError> {
        let [first, second] = &mut self.cameras;
        let (mut a, mut b) = (first.grab(timeout)?, second.grab(timeout)?);
        for _ in 0..AHEAD {
            self.host_s = a.clocks.host_s.max(b.clocks.host_s);
            if a.trigger == b.trigger {
                return self.judge(a, b);
            }
            if self.last.as_ref().is_some_and(|l| l.frames[1].trigger == b.trigger) {
                return Err(self.refuse("a new picture of each camera", "the second repeats its last"));
            }
            let [first, second] = &mut self.cameras;
            if a.trigger < b.trigger {
                a = first.grab(timeout)?;
            } else {
                b = second.grab(timeout)?;
            }
        }
        let found = format!("triggers {} and {}", a.trigger, b.trigger);
        Err(self.refuse("frames of one trigger", &found))
    }

    fn judge(&mut self, a: CameraFrame, b: CameraFrame) -> Result<FramePair, DeviceError> {
        let start = |f: &CameraFrame| f.clocks.device_s.unwrap_or(f.clocks.host_s);
        let skew_ms = (start(&b) - start(&a)) * 1e3;
        if skew_ms.abs() > self.limit_ms {
            let expected = format!("a skew of at most {} ms", self.limit_ms);
            return Err(self.refuse(&expected, &format!("{skew_ms:.3} ms at trigger {}", a.trigger)));
        }
        let pair = FramePair { frames: [a, b], skew_ms };
        self.last = Some(pair.clone());
        Ok(pair)
    }

    fn refuse(&mut self, expected: &str, found: &str) -> DeviceError {
        self.refused += 1;
        DeviceError::new(DeviceErrorKind::DataInvalid, "camera pair", "grab", expected, found)
    }
}
