//! Opens the devices that a rig names.

use crate::cameras::{FolderCamera, NetCamera, V4l2Camera, V4l2Settings};
use crate::hyperion::Hyperion;
use crate::sm130::Sm130;
use crate::zaber::units::Microsteps;
use crate::zaber::{Chain, Port, ZaberBinary, ZaberStage};
use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt, move_allowance};
use wcal_core::device::{Camera, DeviceError, DeviceErrorKind, Interrogator, Mount, Stage};
use wcal_core::rig_devices::{CameraRig, DeviceOpener, InterrogatorRig, MountRig, StageRig};

/// The drivers of this crate by their names.
#[derive(Debug, Default)]
pub struct Drivers {
    /// The serial line of an ASCII stage; a mount may be connected to it, too.
    chain: Option<Rc<RefCell<Chain>>>,
    /// Ends every wait of the devices.
    interrupt: Interrupt,
}

impl Drivers {
    /// Devices whose waits end when the user wants an end.
    #[must_use]
    pub fn new(interrupt: &Interrupt) -> Self {
        Self { chain: None, interrupt: interrupt.clone() }
    }
}

fn unknown(what: &str, expected: &str, found: &str) -> DeviceError {
    DeviceError::new(DeviceErrorKind::Configuration, what, "open", expected, found)
}

fn port(rig: &StageRig, default_baud: u32) -> Port {
    match rig.port.strip_prefix("tcp://") {
        Some(address) => Port::Tcp(address.to_owned()),
        None => Port::Serial(rig.port.clone(), rig.baud.unwrap_or(default_baud)),
    }
}

impl DeviceOpener for Drivers {
    /// Without a baud rate the line's speed is probed.
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        let unit = Microsteps { size_um: rig.microstep_um };
        let mut stage: Box<dyn Stage> = match rig.driver.as_str() {
            "zaber-ascii" => {
                let serial = !rig.port.starts_with("tcp://");
                let chain = if serial && rig.baud.is_none() {
                    Chain::probe(&rig.port, &self.interrupt)?.0
                } else {
                    Chain::open(&port(rig, 115_200), &self.interrupt)?
                };
                let chain = Rc::new(RefCell::new(chain));
                // Questions are counted on the line of the first opening.
                self.chain.get_or_insert_with(|| Rc::clone(&chain));
                Box::new(ZaberStage::new(chain, rig.address, rig.axis, unit, clock)?)
            }
            "zaber-binary" => {
                let port = port(rig, 9600);
                Box::new(ZaberBinary::open(&port, rig.address, unit, clock, &self.interrupt)?)
            }
            other => return Err(unknown("stage", "driver zaber-ascii or zaber-binary", other)),
        };
        let travel = stage.travel_mm()?;
        // A wrong microstep size would scale every position.
        if (travel[1] - rig.travel_mm).abs() > 0.01 * rig.travel_mm {
            let expected = format!("the rig's travel of {} mm", rig.travel_mm);
            return Err(unknown("stage", &expected, &format!("{:.3} mm by the unit's limit", travel[1])));
        }
        Ok(stage)
    }

    /// On the stage's line; homed when it has no reference.
    fn mount(&mut self, rig: &MountRig, clock: HostClock) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        let Some(chain) = &self.chain else { return Ok(None) };
        let mount = ZaberMount::open(rig, Rc::clone(chain), clock, &self.interrupt)?;
        Ok(mount.map(|m| Box::new(m) as Box<dyn Mount>))
    }

    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        match rig.driver.as_str() {
            "sm130" => Ok(Box::new(Sm130::connect(&rig.address, rig.rate_hz, clock, &self.interrupt)?)),
            "hyperion" => {
                let peaks = rig.peaks_address.as_deref();
                let peaks = peaks.ok_or_else(|| unknown("interrogator", "peaks_address", "none"))?;
                let commands = &rig.address;
                Ok(Box::new(Hyperion::connect(commands, peaks, rig.rate_hz, clock, &self.interrupt)?))
            }
            other => Err(unknown("interrogator", "driver sm130, hyperion or replay", other)),
        }
    }

    fn camera(&mut self, rig: &CameraRig, clock: HostClock) -> Result<Box<dyn Camera + Send>, DeviceError> {
        let mut camera: Box<dyn Camera + Send> = match rig.driver.as_str() {
            "net" => Box::new(NetCamera::connect(&rig.source, clock, &self.interrupt)?),
            "folder" => {
                let period_s = 1.0 / rig.rate_hz.unwrap_or(10.0);
                Box::new(FolderCamera::open(Path::new(&rig.source), period_s)?)
            }
            "v4l2" => {
                let settings = V4l2Settings {
                    size_px: rig.image_size_px,
                    rate_hz: rig.rate_hz,
                    controls: rig.controls.clone().into_iter().collect(),
                };
                Box::new(V4l2Camera::open(&rig.source, &settings, clock, &self.interrupt)?)
            }
            other => {
                let name = format!("camera {}", rig.name);
                return Err(unknown(&name, "driver v4l2, net or folder", other));
            }
        };
        camera.configure(rig.exposure_ms, rig.gain_db)?;
        Ok(camera)
    }

    fn repeats(&self) -> u64 {
        self.chain.as_ref().map_or(0, |c| c.borrow().repeats())
    }
}

/// A motorised mount on the stage's chain.
pub struct ZaberMount {
    stage: ZaberStage,
    steps_per_trajectory: i64,
    unit: Microsteps,
    speed_mm_s: f64,
    clock_scale: f64,
    interrupt: Interrupt,
}

/// Longest reference search of a mount (wall time).
const HOME: Duration = Duration::from_secs(60);

impl ZaberMount {
    /// The mount of a rig on an open chain; homed when it has no reference.
    ///
    /// # Errors
    /// What the unit reports.
    pub fn open(
        rig: &MountRig,
        chain: Rc<RefCell<Chain>>,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Option<Self>, DeviceError> {
        let MountRig::Zaber { address, steps_per_trajectory, microstep_um, speed_mm_s } = rig else {
            return Ok(None);
        };
        let unit = Microsteps { size_um: *microstep_um };
        let mut mount = Self {
            stage: ZaberStage::new(chain, *address, 1, unit, clock)?,
            steps_per_trajectory: *steps_per_trajectory,
            unit,
            speed_mm_s: *speed_mm_s,
            clock_scale: clock.scale(),
            interrupt: interrupt.clone(),
        };
        if mount.stage.read().is_err_and(|e| e.kind == DeviceErrorKind::NotHomed) {
            mount.stage.start_home()?;
        }
        mount.until_standing(HOME)?;
        Ok(Some(mount))
    }

    /// Waits for the end of a motion; a mount that does not get there is stopped.
    fn until_standing(&mut self, allowed: Duration) -> Result<(), DeviceError> {
        let deadline = Deadline::after(allowed, &self.interrupt);
        let result = loop {
            match self.stage.read() {
                Ok(reading) if !reading.moving => break Ok(()),
                Ok(reading) if deadline.is_over() => {
                    let found = format!("still moving (BUSY) at {:.3} mm", reading.measured_mm);
                    break Err(deadline.error("mount", "turn", "standstill", &found));
                }
                Ok(_) => deadline.pause(Duration::from_millis(5)),
                Err(e) => break Err(e),
            }
        };
        result.inspect_err(|_| {
            // The error on its way to the user says more than one of the stop.
            let _ = self.stage.stop();
        })
    }
}

impl Mount for ZaberMount {
    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        let steps = i64::from(trajectory) * self.steps_per_trajectory;
        let target_mm = self.unit.to_mm(steps as f64);
        let way_mm = target_mm - self.stage.read()?.measured_mm;
        self.stage.start_move(target_mm, self.speed_mm_s)?;
        self.until_standing(move_allowance(way_mm, self.speed_mm_s, self.clock_scale))
    }
}
