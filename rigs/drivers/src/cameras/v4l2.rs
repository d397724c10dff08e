//! A camera of the Linux kernel (V4L2: UVC and MIPI cameras) through the crate `moq-v4l`; grey
//! values as the sensor gave them.

use crate::host::io_error;
use moq_v4l::buffer::{Flags, Type};
use moq_v4l::capability::Flags as Able;
use moq_v4l::control::{Control, Value};
use moq_v4l::io::mmap::Stream;
use moq_v4l::io::traits::{CaptureStream, Stream as _};
use moq_v4l::video::Capture;
use moq_v4l::{Device, FourCC};
use rustix::event::PollFlags;
use std::io::ErrorKind;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{
    Camera, CameraFrame, Clocks, DeviceError, DeviceErrorKind, DeviceIdentity,
};

/// `V4L2_CID_EXPOSURE_AUTO`; 1 is manual (linux/v4l2-controls.h).
const EXPOSURE_AUTO: u32 = 0x009a_0901;
/// `V4L2_CID_EXPOSURE_ABSOLUTE`, in 0.1 ms.
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
/// `V4L2_CID_EXPOSURE_AUTO_PRIORITY`; 0 keeps the frame rate.
const EXPOSURE_AUTO_PRIORITY: u32 = 0x009a_0903;
const MANUAL: i64 = 1;
/// Buffers asked for: one is read while the kernel fills the others.
const BUFFERS: u32 = 4;

/// What a V4L2 camera is asked for.
#[derive(Debug, Clone, Default)]
pub struct V4l2Settings {
    /// Width and height, px; the camera's own where absent.
    pub size_px: Option<[u32; 2]>,
    /// Pictures per second; the camera's own where absent.
    pub rate_hz: Option<f64>,
    /// Further controls by the name that the driver gives them (gain, trigger mode), e.g.
    /// `("Gain", 12)`.
    pub controls: Vec<(String, i64)>,
}

/// Where the grey value of a pixel lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// One byte a pixel.
    Grey,
    /// Two bytes a pixel, the first is luminance.
    Yuyv,
}

const LAYOUTS: [(&[u8; 4], Layout); 2] = [(b"GREY", Layout::Grey), (b"YUYV", Layout::Yuyv)];

/// An open camera that streams from its first picture on.
pub struct V4l2Camera {
    name: String,
    device: Device,
    stream: Stream<'static>,
    clock: HostClock,
    layout: Layout,
    size_px: [u32; 2],
    stride: usize,
    settings: Vec<(String, String)>,
    commanded_exposure_ms: Option<f64>,
    interrupt: Interrupt,
}

impl V4l2Camera {
    /// Opens e.g. `/dev/video0`.
    ///
    /// # Errors
    /// `Disconnected` when there is no such device; `Configuration` for a camera without an
    /// uncompressed grey or YUYV format, of another size or rate than asked for, or without one of
    /// the controls.
    pub fn open(
        path: &str,
        wanted: &V4l2Settings,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Self, DeviceError> {
        let name = format!("camera {path}");
        let io = |action: &'static str| {
            let name = name.clone();
            move |e: std::io::Error| io_error(&name, action, &e)
        };
        let refuse = |action: &str, expected: String, found: String| {
            DeviceError::new(
                DeviceErrorKind::Configuration,
                &name,
                action,
                expected,
                found,
            )
        };
        let device = Device::with_path(path).map_err(io("open"))?;
        let caps = device
            .query_caps()
            .map_err(|e| refuse("open", "a video device".to_owned(), e.to_string()))?;
        // A UVC camera has a second node that carries no pictures.
        if !caps
            .capabilities
            .contains(Able::VIDEO_CAPTURE | Able::STREAMING)
        {
            return Err(refuse(
                "open",
                "a node that gives pictures".to_owned(),
                caps.capabilities.to_string(),
            ));
        }
        let offered = device.enum_formats().map_err(io("list the formats"))?;
        let chosen = LAYOUTS
            .iter()
            .find(|(code, _)| offered.iter().any(|f| f.fourcc == FourCC::new(code)));
        let Some((code, layout)) = chosen else {
            let found: Vec<String> = offered.iter().map(|f| f.fourcc.to_string()).collect();
            return Err(refuse(
                "choose a format",
                "GREY or YUYV, uncompressed".to_owned(),
                found.join(", "),
            ));
        };
        let mut format = device.format().map_err(io("read the format"))?;
        format.fourcc = FourCC::new(code);
        [format.width, format.height] = wanted.size_px.unwrap_or([format.width, format.height]);
        let asked = [format.width, format.height];
        let format = device.set_format(&format).map_err(io("set the format"))?;
        // The kernel changes a format that the camera does not have in place of refusing it.
        if [format.width, format.height] != asked || format.fourcc != FourCC::new(code) {
            let found = format!("{}x{} {}", format.width, format.height, format.fourcc);
            return Err(refuse(
                "set the format",
                format!("{}x{}", asked[0], asked[1]),
                found,
            ));
        }
        let mut settings = vec![("format".to_owned(), format.fourcc.to_string())];
        if let Some(rate_hz) = wanted.rate_hz {
            let mut parameters = device.params().map_err(io("read the rate"))?;
            parameters.interval = moq_v4l::Fraction::new(1000, (rate_hz * 1000.0).round() as u32);
            let got = device
                .set_params(&parameters)
                .map_err(io("set the rate"))?
                .interval;
            let got_hz = f64::from(got.denominator) / f64::from(got.numerator.max(1));
            // A rate, too, is changed to one that the camera has.
            if (got_hz - rate_hz).abs() > 0.01 * rate_hz {
                return Err(refuse(
                    "set the rate",
                    format!("{rate_hz} Hz"),
                    format!("{got_hz} Hz"),
                ));
            }
            settings.push(("rate_hz".to_owned(), got_hz.to_string()));
        }
        let known = device.query_controls().map_err(io("list the controls"))?;
        for (control, value) in &wanted.controls {
            let Some(description) = known.iter().find(|d| d.name.eq_ignore_ascii_case(control))
            else {
                let names: Vec<&str> = known.iter().map(|d| d.name.as_str()).collect();
                return Err(refuse(
                    "set a control",
                    format!("one of {}", names.join(", ")),
                    control.clone(),
                ));
            };
            let setting = Control {
                id: description.id,
                value: Value::Integer(*value),
            };
            let range = format!(
                "{control} of {} to {}",
                description.minimum, description.maximum
            );
            device
                .set_control(setting)
                .map_err(|e| refuse("set a control", range, format!("{value}: {e}")))?;
            settings.push((control.clone(), value.to_string()));
        }
        let mut stream = Stream::with_buffers(&device, Type::VideoCapture, BUFFERS)
            .map_err(io("map its buffers"))?;
        // `next` gives the buffer in hand (the first) back before it takes another: only the others
        // are queued here.
        let queued = (1..BUFFERS as usize)
            .take_while(|i| stream.queue(*i).is_ok())
            .count();
        if queued == 0 {
            return Err(refuse(
                "queue its buffers",
                "at least 2 buffers".to_owned(),
                "1".to_owned(),
            ));
        }
        stream.start().map_err(io("start"))?;
        Ok(Self {
            name,
            stream,
            clock,
            layout: *layout,
            size_px: asked,
            stride: format.stride as usize,
            settings,
            commanded_exposure_ms: None,
            interrupt: interrupt.clone(),
            device,
        })
    }

    fn measured_exposure_ms(&self) -> Option<f64> {
        match self.device.control(EXPOSURE_ABSOLUTE).ok()?.value {
            Value::Integer(tenths) => Some(tenths as f64 / 10.0),
            _ => None,
        }
    }
}

impl Camera for V4l2Camera {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let caps = self
            .device
            .query_caps()
            .map_err(|e| io_error(&self.name, "identify", &e))?;
        Ok(DeviceIdentity {
            driver: "v4l2".to_owned(),
            model: caps.card,
            // V4L2 has no serial number: the bus distinguishes two cameras of one model.
            serial: caps.bus,
            settings: self.settings.clone(),
            ..DeviceIdentity::default()
        })
    }

    fn configure(
        &mut self,
        exposure_ms: Option<f64>,
        gain_db: Option<f64>,
    ) -> Result<(), DeviceError> {
        if gain_db.is_some() {
            let (kind, expected) = (
                DeviceErrorKind::Unsupported,
                "the gain among the controls: V4L2 has no dB",
            );
            return Err(DeviceError::new(
                kind,
                &self.name,
                "configure",
                expected,
                "gain_db",
            ));
        }
        let Some(exposure_ms) = exposure_ms else {
            return Ok(());
        };
        let set = |id: u32, value: i64| {
            self.device.set_control(Control {
                id,
                value: Value::Integer(value),
            })
        };
        let refuse = |expected: &str| {
            let (name, expected) = (self.name.clone(), expected.to_owned());
            move |e: std::io::Error| {
                DeviceError::new(
                    DeviceErrorKind::Configuration,
                    name,
                    "set the exposure",
                    expected,
                    e.to_string(),
                )
            }
        };
        set(EXPOSURE_AUTO, MANUAL).map_err(refuse("a manual mode"))?;
        // Not every driver has it; where it is missing the rate does not depend on the light.
        let _ = set(EXPOSURE_AUTO_PRIORITY, 0);
        let tenths = (exposure_ms * 10.0).round() as i64;
        set(EXPOSURE_ABSOLUTE, tenths).map_err(refuse(&format!(
            "{exposure_ms} ms within the camera's range"
        )))?;
        self.commanded_exposure_ms = Some(exposure_ms);
        Ok(())
    }

    fn grab(&mut self, timeout: Duration) -> Result<CameraFrame, DeviceError> {
        let deadline = Deadline::after(timeout, &self.interrupt);
        let measured_exposure_ms = self.measured_exposure_ms();
        loop {
            // Damaged pictures that come one after the other do not prolong the wait.
            if deadline.is_over() {
                return Err(deadline.error(&self.name, "grab", "a whole picture", "none"));
            }
            let slice_ms = deadline.slice().as_millis().max(1) as i32;
            match self
                .device
                .handle()
                .poll(PollFlags::IN.bits() as i16, slice_ms)
            {
                Ok(0) => continue,
                Err(e) if e.kind() == ErrorKind::Interrupted => continue,
                Err(e) => return Err(io_error(&self.name, "grab", &e)),
                Ok(_) => {}
            }
            // Asked only when a picture waits: a wait that fails inside `next` would give its
            // buffer back twice.
            let (bytes, about) = self
                .stream
                .next()
                .map_err(|e| io_error(&self.name, "grab", &e))?;
            // A damaged picture keeps its sequence number: the pair finds the gap.
            if about.flags.contains(Flags::ERROR) {
                continue;
            }
            let used = &bytes[..bytes.len().min(about.bytesused as usize)];
            let Some(grey) = luminance(used, self.layout, self.size_px, self.stride) else {
                let expected = format!("a picture of {}x{} px", self.size_px[0], self.size_px[1]);
                let kind = DeviceErrorKind::Protocol;
                return Err(DeviceError::new(
                    kind,
                    &self.name,
                    "grab",
                    expected,
                    format!("{} bytes", used.len()),
                ));
            };
            // Stamps of the machine's monotonic clock are common to all cameras of one machine;
            // others cannot be compared.
            let monotonic = about.flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC;
            let stamp_s = about.timestamp.sec as f64 + about.timestamp.usec as f64 * 1e-6;
            return Ok(CameraFrame {
                trigger: u64::from(about.sequence),
                commanded_exposure_ms: self.commanded_exposure_ms,
                measured_exposure_ms,
                width_px: self.size_px[0],
                height_px: self.size_px[1],
                grey,
                clocks: Clocks {
                    host_s: self.clock.now_s(),
                    device_s: monotonic.then_some(stamp_s),
                },
            });
        }
    }
}

/// Grey values of a picture in lines of `stride` bytes; `None` where it is too short.
fn luminance(bytes: &[u8], layout: Layout, size_px: [u32; 2], stride: usize) -> Option<Vec<u8>> {
    let [width, height] = size_px.map(|p| p as usize);
    let step = match layout {
        Layout::Grey => 1,
        Layout::Yuyv => 2,
    };
    let stride = stride.max(width * step);
    let mut grey = Vec::with_capacity(width * height);
    for line in 0..height {
        let start = line * stride;
        grey.extend(bytes.get(start..start + width * step)?.iter().step_by(step));
    }
    Some(grey)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_values_are_taken_line_by_line_without_padding_or_colour() {
        let grey = [1, 2, 9, 3, 4, 9];
        assert_eq!(
            luminance(&grey, Layout::Grey, [2, 2], 3),
            Some(vec![1, 2, 3, 4])
        );
        let yuyv = [1, 90, 2, 91, 0, 0, 3, 92, 4, 93];
        assert_eq!(
            luminance(&yuyv, Layout::Yuyv, [2, 2], 6),
            Some(vec![1, 2, 3, 4])
        );
        assert_eq!(
            luminance(&yuyv[..9], Layout::Yuyv, [2, 2], 6),
            None,
            "cut off"
        );
    }

    #[test]
    fn a_missing_or_foreign_device_is_named() {
        let open = |path: &str| {
            let settings = V4l2Settings::default();
            V4l2Camera::open(
                path,
                &settings,
                HostClock::start(1.0),
                &Interrupt::default(),
            )
            .err()
        };
        let missing = open("/dev/video-none").unwrap();
        assert_eq!(missing.kind, DeviceErrorKind::Disconnected);
        assert!(missing.to_string().contains("/dev/video-none"), "{missing}");
        assert!(open("/dev/null").is_some(), "no camera");
    }
}
