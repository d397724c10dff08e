//! Host time of readings.

use std::time::{SystemTime, UNIX_EPOCH};
use wcal_core::device::{DeviceError, DeviceErrorKind};

/// Host clock: seconds since the Unix epoch, monotonic; runs `scale` times as fast beside an accelerated virtual bench.
#[derive(Debug, Clone, Copy)]
pub struct HostClock {
    start: std::time::Instant,
    start_epoch_s: f64,
    scale: f64,
}

impl HostClock {
    /// Starts at the system time.
    #[must_use]
    pub fn start(scale: f64) -> Self {
        let epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { start: std::time::Instant::now(), start_epoch_s: epoch.as_secs_f64(), scale }
    }

    /// Now, s.
    #[must_use]
    pub fn now_s(&self) -> f64 {
        self.start_epoch_s + self.start.elapsed().as_secs_f64() * self.scale
    }

    /// Host seconds per wall second; 1 on a real bench.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }
}

/// Whether an I/O error is a read that ran out of time (`TimedOut` on serial ports, `WouldBlock` on TCP).
pub(crate) fn is_timeout(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::TimedOut | std::io::ErrorKind::WouldBlock)
}

/// An I/O error as a device error.
pub(crate) fn io_error(device: &str, action: &str, error: &std::io::Error) -> DeviceError {
    let kind = if is_timeout(error) { DeviceErrorKind::Timeout } else { DeviceErrorKind::Disconnected };
    DeviceError::new(kind, device, action, "a working link", error.to_string())
}
