//! A camera that sends its pictures over TCP, as the virtual bench's do: a 40-byte header and grey
//! values.

use crate::host::u32_at;
use crate::link::Link;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{
    Camera, CameraFrame, Clocks, DeviceError, DeviceErrorKind, DeviceIdentity,
};

/// Length of the header: magic, width, height, zero (u32), trigger (u64), start of exposure s,
/// exposure ms (f64).
const HEADER: usize = 40;
const MAGIC: &[u8; 4] = b"WCAM";
/// Largest accepted side of a picture, px.
const MAX_SIDE: u32 = 16_384;

/// A connected camera.
#[derive(Debug)]
pub struct NetCamera {
    link: Link,
    clock: HostClock,
}

impl NetCamera {
    /// Connects.
    ///
    /// # Errors
    /// `Disconnected` when nothing listens there, `Timeout` when nobody answers.
    pub fn connect(
        address: &str,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let link = Link::connect(format!("camera {address}"), address, interrupt)?;
        Ok(Self { link, clock })
    }
}

/// The first frame in the buffer, once all of it is there.
fn frame(link: &mut Link) -> Result<Option<Vec<u8>>, DeviceError> {
    let buffer = &mut link.buffer;
    if buffer.len() < HEADER {
        return Ok(None);
    }
    let [width, height] = [4, 8].map(|at| u32_at(buffer, at));
    // A damaged size would make the reader wait for a picture that never ends.
    if &buffer[..4] != MAGIC || width.max(height) > MAX_SIDE {
        let found = format!("{:?}, {width} x {height}", &buffer[..4]);
        return Err(link.error(DeviceErrorKind::Protocol, "grab", "a WCAM header", found));
    }
    let length = HEADER + width as usize * height as usize;
    Ok((buffer.len() >= length).then(|| buffer.drain(..length).collect()))
}

fn u64_at(b: &[u8], at: usize) -> u64 {
    u64::from(u32_at(b, at)) | u64::from(u32_at(b, at + 4)) << 32
}

impl Camera for NetCamera {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        Ok(DeviceIdentity {
            driver: "net".to_owned(),
            model: "virtual camera".to_owned(),
            ..DeviceIdentity::default()
        })
    }

    fn grab(&mut self, timeout: Duration) -> Result<CameraFrame, DeviceError> {
        let deadline = self.link.deadline(timeout);
        let b = self.link.wait("grab", "a picture", &deadline, frame)?;
        Ok(CameraFrame {
            trigger: u64_at(&b, 16),
            commanded_exposure_ms: None,
            measured_exposure_ms: Some(f64::from_bits(u64_at(&b, 32))),
            width_px: u32_at(&b, 4),
            height_px: u32_at(&b, 8),
            grey: b[HEADER..].to_vec(),
            clocks: Clocks {
                host_s: self.clock.now_s(),
                device_s: Some(f64::from_bits(u64_at(&b, 24))),
            },
        })
    }
}
