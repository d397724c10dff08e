//! Errors of links as device errors.

use wcal_core::device::{DeviceError, DeviceErrorKind};

/// Whether an I/O error is a read that ran out of time (`TimedOut` on serial ports, `WouldBlock` on
/// TCP).
pub(crate) fn is_timeout(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        std::io::ErrorKind::TimedOut | std::io::ErrorKind::WouldBlock
    )
}

/// An I/O error as a device error.
pub(crate) fn io_error(device: &str, action: &str, error: &std::io::Error) -> DeviceError {
    let kind = if is_timeout(error) {
        DeviceErrorKind::Timeout
    } else {
        DeviceErrorKind::Disconnected
    };
    DeviceError::new(kind, device, action, "a working link", error.to_string())
}

/// A number of a message, low byte first.
pub(crate) fn u16_at(b: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([b[at], b[at + 1]])
}

/// The same of four bytes.
pub(crate) fn u32_at(b: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]])
}
