//! From `rig.toml` to open devices.

use crate::cameras::{CameraPair, FolderCamera, NetCamera, V4l2Camera, V4l2Settings};
use crate::host::HostClock;
use crate::hyperion::Hyperion;
use crate::replay::ReplayInterrogator;
use crate::sm130::Sm130;
use crate::zaber::units::Microsteps;
use crate::zaber::{Chain, Port, ZaberBinary, ZaberStage};
use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::device::{Camera, DeviceError, DeviceErrorKind, Interrogator, Stage};
use wcal_session::recording::rig::{CameraRig, InterrogatorRig, MountRig, Rig, StageRig};
use wcal_session::recording::sweep::Mount;

/// An open stage and, for ASCII units, its chain.
pub type OpenStage = (Box<dyn Stage>, Option<Rc<RefCell<Chain>>>);

fn unknown(what: &str, expected: &str, found: &str) -> DeviceError {
    DeviceError::new(DeviceErrorKind::Configuration, what, "open", expected, found)
}

fn port(rig: &StageRig, default_baud: u32) -> Port {
    match rig.port.strip_prefix("tcp://") {
        Some(address) => Port::Tcp(address.to_owned()),
        None => Port::Serial(rig.port.clone(), rig.baud.unwrap_or(default_baud)),
    }
}

/// Opens the stage of a rig; without a baud rate the line's speed is probed.
///
/// # Errors
/// `Configuration` for an unknown driver or a travel that is not the rig's, else what the unit reports.
pub fn open_stage(rig: &StageRig, clock: HostClock) -> Result<OpenStage, DeviceError> {
    let unit = Microsteps { size_um: rig.microstep_um };
    let (mut stage, chain): OpenStage = match rig.driver.as_str() {
        "zaber-ascii" => {
            let serial = !rig.port.starts_with("tcp://");
            let chain = if serial && rig.baud.is_none() {
                Chain::probe(&rig.port)?.0
            } else {
                Chain::open(&port(rig, 115_200))?
            };
            let chain = Rc::new(RefCell::new(chain));
            let stage = ZaberStage::new(Rc::clone(&chain), rig.address, rig.axis, unit, clock)?;
            (Box::new(stage), Some(chain))
        }
        "zaber-binary" => (Box::new(ZaberBinary::open(&port(rig, 9600), rig.address, unit, clock)?), None),
        other => return Err(unknown("stage", "driver zaber-ascii or zaber-binary", other)),
    };
    let travel = stage.travel_mm()?;
    // A wrong microstep size would scale every position.
    if (travel[1] - rig.travel_mm).abs() > 0.01 * rig.travel_mm {
        let expected = format!("the rig's travel of {} mm", rig.travel_mm);
        return Err(unknown("stage", &expected, &format!("{:.3} mm by the unit's limit", travel[1])));
    }
    Ok((stage, chain))
}

/// Opens the interrogator of a rig.
///
/// # Errors
/// `Configuration` for an unknown driver, else what the unit reports.
pub fn open_interrogator(
    rig: &InterrogatorRig,
    clock: HostClock,
) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
    match rig.driver.as_str() {
        "sm130" => Ok(Box::new(Sm130::connect(&rig.address, rig.rate_hz, clock)?)),
        "hyperion" => {
            let peaks = rig.peaks_address.as_deref();
            let peaks = peaks.ok_or_else(|| unknown("interrogator", "peaks_address", "none"))?;
            Ok(Box::new(Hyperion::connect(&rig.address, peaks, rig.rate_hz, clock)?))
        }
        "replay" => Ok(Box::new(ReplayInterrogator::open(Path::new(&rig.address))?)),
        other => Err(unknown("interrogator", "driver sm130, hyperion or replay", other)),
    }
}

/// Opens the camera pair of a rig, if it has one.
///
/// # Errors
/// `Configuration` for an unknown driver, else what a camera reports.
pub fn open_cameras(rig: &Rig, clock: HostClock) -> Result<Option<CameraPair>, DeviceError> {
    let open = |camera: &CameraRig| -> Result<Box<dyn Camera + Send>, DeviceError> {
        let mut opened: Box<dyn Camera + Send> = match camera.driver.as_str() {
            "net" => Box::new(NetCamera::connect(&camera.source, clock)?),
            "folder" => {
                let period_s = 1.0 / camera.rate_hz.unwrap_or(10.0);
                Box::new(FolderCamera::open(Path::new(&camera.source), period_s)?)
            }
            "v4l2" => {
                let settings = V4l2Settings {
                    size_px: camera.image_size_px,
                    rate_hz: camera.rate_hz,
                    controls: camera.controls.clone().into_iter().collect(),
                };
                Box::new(V4l2Camera::open(&camera.source, &settings, clock)?)
            }
            other => {
                let name = format!("camera {}", camera.name);
                return Err(unknown(&name, "driver v4l2, net or folder", other));
            }
        };
        opened.configure(camera.exposure_ms, camera.gain_db)?;
        Ok(opened)
    };
    match rig.camera.as_slice() {
        [first, second] => {
            let cameras = [open(first)?, open(second)?];
            // V4L2 counts the frames of each camera from its own start.
            let own_numbers = first.driver == "v4l2" || second.driver == "v4l2";
            let pair = if own_numbers { CameraPair::by_time } else { CameraPair::new };
            Ok(Some(pair(cameras, rig.camera_skew_limit_ms)))
        }
        _ => Ok(None),
    }
}

/// A motorised mount on the stage's chain.
pub struct ZaberMount {
    stage: ZaberStage,
    steps_per_trajectory: i64,
    unit: Microsteps,
    speed_mm_s: f64,
    /// Longest a turn may take.
    patience: Duration,
}

impl ZaberMount {
    /// The mount of a rig on an open chain; homed when it has no reference.
    ///
    /// # Errors
    /// What the unit reports.
    pub fn open(
        rig: &MountRig,
        chain: Rc<RefCell<Chain>>,
        clock: HostClock,
    ) -> Result<Option<Self>, DeviceError> {
        let MountRig::Zaber { address, steps_per_trajectory, microstep_um, speed_mm_s } = rig else {
            return Ok(None);
        };
        let unit = Microsteps { size_um: *microstep_um };
        let mut stage = ZaberStage::new(chain, *address, 1, unit, clock)?;
        let patience = Duration::from_secs(60);
        if stage.read().is_err_and(|e| e.kind == DeviceErrorKind::NotHomed) {
            stage.start_home()?;
        }
        let mut mount = Self {
            stage,
            steps_per_trajectory: *steps_per_trajectory,
            unit,
            speed_mm_s: *speed_mm_s,
            patience,
        };
        mount.until_standing()?;
        Ok(Some(mount))
    }

    fn until_standing(&mut self) -> Result<(), DeviceError> {
        let end = std::time::Instant::now() + self.patience;
        while self.stage.read()?.moving {
            if std::time::Instant::now() > end {
                let kind = DeviceErrorKind::Timeout;
                return Err(DeviceError::new(kind, "mount", "turn", "standstill", "still moving"));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }
}

impl Mount for ZaberMount {
    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        let steps = i64::from(trajectory) * self.steps_per_trajectory;
        self.stage.start_move(self.unit.to_mm(steps as f64), self.speed_mm_s)?;
        self.until_standing()
    }
}
