//! Opens the devices that a rig names.

use crate::cameras::{FolderCamera, NetCamera, V4l2Camera, V4l2Settings};
use crate::hyperion::Hyperion;
use crate::sm130::Sm130;
use crate::zaber::ZaberLines;
use crate::zaber::wire::{Connect, connect};
use std::path::Path;
use std::rc::Rc;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{Camera, DeviceError, DeviceErrorKind, Interrogator, Mount, Stage};
use wcal_core::rig_devices::{
    CameraDriver, CameraRig, DeviceOpener, InterrogatorDriver, InterrogatorRig, MountRig,
    StageDriver, StageRig,
};

/// The drivers of this crate by their names. Dropped, they leave the units with the speeds that
/// they found.
pub struct Drivers {
    zaber: ZaberLines,
    /// Ends every wait of the devices.
    interrupt: Interrupt,
}

impl Default for Drivers {
    fn default() -> Self {
        Self::new(&Interrupt::default())
    }
}

impl Drivers {
    /// Devices whose waits end when the user wants an end.
    pub fn new(interrupt: &Interrupt) -> Self {
        Self::over(Rc::new(connect), interrupt)
    }

    /// As [`Self::new`], with links of the caller's for the ports of stage and mount.
    pub fn over(connect: Connect, interrupt: &Interrupt) -> Self {
        Self {
            zaber: ZaberLines::new(connect, interrupt),
            interrupt: interrupt.clone(),
        }
    }
}

impl DeviceOpener for Drivers {
    /// Moves nothing.
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        match rig.driver {
            StageDriver::ZaberAscii | StageDriver::ZaberBinary => self.zaber.stage(rig, clock),
        }
    }

    /// On the stage's line.
    fn mount(
        &mut self,
        rig: &MountRig,
        clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        self.zaber.mount(rig, clock)
    }

    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        let wrong = |expected: &str, found: &str| {
            let (kind, device) = (DeviceErrorKind::Configuration, "interrogator");
            DeviceError::new(kind, device, "open", expected, found)
        };
        let (address, rate_hz, interrupt) = (&rig.address, rig.rate_hz, &self.interrupt);
        Ok(match rig.driver {
            InterrogatorDriver::Sm130 => {
                Box::new(Sm130::connect(address, rate_hz, clock, interrupt)?)
            }
            InterrogatorDriver::Hyperion => {
                let peaks = rig.peaks_address.as_deref();
                let peaks = peaks.ok_or_else(|| wrong("peaks_address", "none"))?;
                Box::new(Hyperion::connect(
                    address, peaks, rate_hz, clock, interrupt,
                )?)
            }
            // Opened by the acquisition: a recording is no device.
            InterrogatorDriver::Replay => return Err(wrong("a device", "a recording")),
        })
    }

    fn camera(
        &mut self,
        rig: &CameraRig,
        clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError> {
        let (source, interrupt) = (&rig.source, &self.interrupt);
        let mut camera: Box<dyn Camera + Send> = match rig.driver {
            CameraDriver::Net => Box::new(NetCamera::connect(source, clock, interrupt)?),
            CameraDriver::Folder => {
                let period_s = 1.0 / rig.rate_hz.unwrap_or(10.0);
                Box::new(FolderCamera::open(Path::new(source), period_s)?)
            }
            CameraDriver::V4l2 => {
                let settings = V4l2Settings {
                    size_px: rig.image_size_px,
                    rate_hz: rig.rate_hz,
                    controls: rig.controls.clone().into_iter().collect(),
                };
                Box::new(V4l2Camera::open(source, &settings, clock, interrupt)?)
            }
        };
        camera.configure(rig.exposure_ms, rig.gain_db)?;
        Ok(camera)
    }

    fn repeats(&self) -> u64 {
        self.zaber.repeats()
    }
}
