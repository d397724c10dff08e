//! The three device roles of a bench. Real, virtual and replayed devices are the same to every
//! caller.
//!
//! A reading carries what was commanded (where a device can be commanded), what was measured, and
//! two clocks.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use thiserror::Error;

/// What went wrong, coarse enough for a caller to decide between retry, stop and refuse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceErrorKind {
    /// No answer in time; a retry may help.
    Timeout,
    /// The link is gone; reconnect before anything else.
    Disconnected,
    /// An answer that does not follow the protocol.
    Protocol,
    /// The device refused the command.
    Rejected,
    /// The position has no reference.
    NotHomed,
    /// The motor stalled.
    Stalled,
    /// The carriage was moved from outside.
    Displaced,
    /// The motor driver is off.
    DriverOff,
    /// A fault that only the device's maker can explain.
    CriticalFault,
    /// A target outside the travel or the limits of the rig.
    OutOfRange,
    /// The device marks its own data as invalid.
    DataInvalid,
    /// A grating has no peak, or two gratings cannot be distinguished.
    PeakLost,
    /// The device says that it is too hot, too cold or out of calibration.
    Health,
    /// The device's clock stepped or stands still.
    Clock,
    /// The device cannot do this.
    Unsupported,
    /// The user stopped the run.
    Interrupted,
    /// Names, ports or files that do not fit.
    Configuration,
}

impl DeviceErrorKind {
    /// The name used in sessions and reports, e.g. `not-homed`: as it is written to files.
    pub fn name(self) -> String {
        serde_json::to_value(self)
            .ok()
            .and_then(|name| name.as_str().map(str::to_owned))
            .unwrap_or_default()
    }

    /// Whether the same request may succeed when it is sent again.
    pub const fn may_retry(self) -> bool {
        matches!(self, Self::Timeout | Self::Protocol)
    }
}

/// Failure of one action on one device.
#[derive(Debug, Clone, PartialEq, Eq, Error, Serialize, Deserialize)]
#[error("{}", self.sentence())]
pub struct DeviceError {
    /// Class of the failure.
    pub kind: DeviceErrorKind,
    /// Device, e.g. `stage /dev/ttyUSB0`.
    pub device: String,
    /// What was being done.
    pub action: String,
    /// What the caller needed.
    pub expected: String,
    /// What came instead.
    pub found: String,
}

impl DeviceError {
    fn sentence(&self) -> String {
        let Self {
            kind,
            device,
            action,
            expected,
            found,
        } = self;
        match kind {
            // Nothing failed: somebody wanted it so.
            DeviceErrorKind::Interrupted => format!("{device}: interrupted by {found}"),
            _ => {
                let class = format!(" [{}]", kind.name());
                // What was found may be a failure of the same class, with its own.
                let found = found.strip_suffix(&class).unwrap_or(found);
                format!("{device}: {action}: expected {expected}, found {found}{class}")
            }
        }
    }

    /// A failure with all its parts.
    pub fn new(
        kind: DeviceErrorKind,
        device: impl Into<String>,
        action: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self {
            kind,
            device: device.into(),
            action: action.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }
}

/// When a reading was made, by the two clocks that saw it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Clocks {
    /// Host time at arrival, s since the Unix epoch (times the clock scale of a virtual bench).
    pub host_s: f64,
    /// The device's own time, s on its own scale; absent where it has none.
    pub device_s: Option<f64>,
}

/// What a unit says of itself.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub struct DeviceIdentity {
    /// Driver that spoke to it, e.g. `zaber-ascii`.
    pub driver: String,
    /// Model or device number.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
    /// Settings read from the unit, in the order read.
    pub settings: Vec<(String, String)>,
}

impl DeviceIdentity {
    /// Whether the unit is one of the virtual bench: its interrogators and cameras say so in their
    /// model.
    pub fn is_virtual(&self) -> bool {
        self.model.split_whitespace().any(|word| word == "virtual")
    }
}

/// Position of a stage at one instant.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StageReading {
    /// Target of the last move, mm; absent before the first.
    pub commanded_mm: Option<f64>,
    /// Position read back, mm.
    pub measured_mm: f64,
    /// Whether the stage says that it moves.
    pub moving: bool,
    /// Warning flags that the unit shows, e.g. `NC`.
    pub flags: Vec<String>,
    /// Clocks.
    pub clocks: Clocks,
}

/// What the user allows before the first move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Permission {
    /// To search a missing reference: a motion to the home switch (`--home`).
    pub home: bool,
    /// To take back flags that a unit keeps until somebody has looked, of a stall for one, and to
    /// search the reference anew (`--home --resume`).
    pub clear_flags: bool,
}

impl Permission {
    /// Whether this failure is one that the user allows to be put right.
    pub fn covers(self, failure: &DeviceError) -> bool {
        match failure.kind {
            DeviceErrorKind::NotHomed => self.home,
            DeviceErrorKind::Stalled | DeviceErrorKind::Displaced | DeviceErrorKind::OutOfRange => {
                self.clear_flags
            }
            _ => false,
        }
    }
}

/// A linear axis. Moves start and return at once: the caller polls `read`, so that it can watch
/// other devices too.
pub trait Stage {
    /// Model, serial number, firmware and settings, read from the unit.
    ///
    /// # Errors
    /// [`DeviceError`] when the unit does not answer.
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError>;
    /// Travel, mm: lowest and highest position.
    ///
    /// # Errors
    /// [`DeviceError`] when the unit does not answer.
    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError>;
    /// Starts the reference search.
    ///
    /// # Errors
    /// [`DeviceError`] when the unit refuses.
    fn start_home(&mut self) -> Result<(), DeviceError>;
    /// Starts a move to an absolute position (mm) at a speed (mm/s).
    ///
    /// # Errors
    /// `NotHomed`, `OutOfRange`, or what the link reports.
    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError>;
    /// Position, motion and flags. A flag that forbids measuring is an error of its kind.
    ///
    /// # Errors
    /// `Stalled`, `Displaced`, `DriverOff`, `CriticalFault`, `NotHomed`, or what the link reports.
    fn read(&mut self) -> Result<StageReading, DeviceError>;
    /// Takes back the flags that the unit keeps until somebody has looked, and names those that had
    /// forbidden to measure. Only where the user says so ([`Permission::clear_flags`]); after it
    /// the reference is searched anew. Moves nothing.
    ///
    /// # Errors
    /// What the link reports.
    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError>;
    /// Decelerates to standstill; must be tried whatever happened before.
    ///
    /// # Errors
    /// [`DeviceError`] when the stop could not be confirmed.
    fn stop(&mut self) -> Result<(), DeviceError>;
}

/// Turns the whisker to a trajectory. Opening one moves nothing.
pub trait Mount {
    /// Whether these trajectories can be presented with what the user allows; asks, moves nothing.
    ///
    /// # Errors
    /// `OutOfRange` for a trajectory past the travel, `NotHomed`, or a flag that forbids to move.
    fn check(&mut self, _trajectories: &[u32], _allowed: Permission) -> Result<(), DeviceError> {
        Ok(())
    }
    /// Takes flags back and searches a missing reference, as far as the user allows. Moves: the
    /// stage is retracted before.
    ///
    /// # Errors
    /// `NotHomed`, a flag that forbids to move, or what the unit reports.
    fn prepare(&mut self, _allowed: Permission) -> Result<(), DeviceError> {
        Ok(())
    }
    /// Presents `trajectory`; returns when it stands.
    ///
    /// # Errors
    /// When it cannot be reached or the user declines.
    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError>;
    /// Decelerates to standstill, whatever happened before: a link that was lost while it turned
    /// stopped nothing.
    ///
    /// # Errors
    /// [`DeviceError`] when the stop could not be confirmed.
    fn stop(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// State bits that an interrogator sends with its data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct InterrogatorHealth {
    /// The internal wavelength reference failed.
    pub calibration_fault: bool,
    /// A fan stands still.
    pub fan_fault: bool,
    /// Light source over temperature.
    pub soa_thermal: bool,
    /// Light source over current.
    pub soa_current: bool,
    /// Thermo-electric cooler over temperature.
    pub tec_over: bool,
    /// Thermo-electric cooler under temperature.
    pub tec_under: bool,
    /// Error code of the unit, 0 when good, 9 when the data are invalid.
    pub error_code: u8,
    /// How full the unit's buffer is, percent.
    pub buffer_percent: u8,
}

impl InterrogatorHealth {
    /// Names of all faults shown; empty when the data can be used.
    pub fn faults(&self) -> Vec<&'static str> {
        let all = [
            (self.calibration_fault, "calibration-fault"),
            (self.fan_fault, "fan-fault"),
            (self.soa_thermal, "soa-thermal"),
            (self.soa_current, "soa-current"),
            (self.tec_over, "tec-over-temperature"),
            (self.tec_under, "tec-under-temperature"),
            (self.error_code != 0, "error-code"),
        ];
        all.iter()
            .filter(|(on, _)| *on)
            .map(|(_, name)| *name)
            .collect()
    }
}

/// One scan: the peaks of every optical channel. A passive sensor: nothing is commanded.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FbgReading {
    /// Running number of the scan; a jump means lost scans.
    pub serial: u64,
    /// Wavelengths, nm, ascending, one list an optical channel.
    pub peaks_nm: Vec<Vec<f64>>,
    /// State of the unit.
    pub health: InterrogatorHealth,
    /// Clocks.
    pub clocks: Clocks,
}

/// A source of wavelength scans.
pub trait Interrogator {
    /// Model, serial number, firmware and settings, read from the unit.
    ///
    /// # Errors
    /// [`DeviceError`] when the unit does not answer.
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError>;
    /// Scan rate, Hz.
    fn rate_hz(&self) -> f64;
    /// Starts streaming.
    ///
    /// # Errors
    /// [`DeviceError`] when the unit refuses.
    fn start(&mut self) -> Result<(), DeviceError>;
    /// Scans that arrived, waiting at most `timeout` for the first; empty when none came.
    ///
    /// # Errors
    /// [`DeviceError`] when the link broke or the frames cannot be understood.
    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError>;
    /// Stops streaming.
    ///
    /// # Errors
    /// [`DeviceError`] when the stop could not be confirmed.
    fn stop(&mut self) -> Result<(), DeviceError>;
}

/// One picture, 8-bit grey.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraFrame {
    /// Number of the trigger that made it; both frames of a pair carry the same.
    pub trigger: u64,
    /// Exposure that was asked for, ms; absent where it cannot be set.
    pub commanded_exposure_ms: Option<f64>,
    /// Exposure reported by the camera, ms.
    pub measured_exposure_ms: Option<f64>,
    /// Width, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
    /// Row-major grey values.
    pub grey: Vec<u8>,
    /// Clocks; the device clock is the start of exposure.
    pub clocks: Clocks,
}

/// A camera of a pair.
pub trait Camera {
    /// Model, serial number and settings.
    ///
    /// # Errors
    /// [`DeviceError`] when the unit does not answer.
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError>;
    /// Sets exposure (ms) and gain (dB); `None` leaves one alone.
    ///
    /// # Errors
    /// `Unsupported` where the camera cannot.
    fn configure(
        &mut self,
        exposure_ms: Option<f64>,
        gain_db: Option<f64>,
    ) -> Result<(), DeviceError> {
        if exposure_ms.is_none() && gain_db.is_none() {
            return Ok(());
        }
        let (kind, camera) = (DeviceErrorKind::Unsupported, self.identity()?.model);
        let expected = "no exposure and gain: this camera has none";
        Err(DeviceError::new(
            kind,
            camera,
            "configure",
            expected,
            "a setting",
        ))
    }
    /// The next picture, waiting at most `timeout`.
    ///
    /// # Errors
    /// `Timeout` when none came, `Disconnected` at the end of a folder.
    fn grab(&mut self, timeout: Duration) -> Result<CameraFrame, DeviceError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_states_action_expectation_and_finding() {
        let error = DeviceError::new(
            DeviceErrorKind::NotHomed,
            "stage",
            "move to 3 mm",
            "a homed axis",
            "WH",
        );
        assert_eq!(
            error.to_string(),
            "stage: move to 3 mm: expected a homed axis, found WH [not-homed]"
        );
        assert!(!error.kind.may_retry() && DeviceErrorKind::Timeout.may_retry());
        // A failure that was found in another one says its class once; another class stays.
        let within = |kind| {
            let outer = DeviceError::new(kind, "sweep", "run", "a stage", error.to_string());
            outer.to_string()
        };
        let twice = within(DeviceErrorKind::NotHomed);
        assert!(twice.ends_with("found WH [not-homed]"), "{twice}");
        let both = within(DeviceErrorKind::Timeout);
        assert!(both.ends_with("[not-homed] [timeout]"), "{both}");
    }

    #[test]
    fn health_lists_every_fault_and_nothing_when_good() {
        assert!(InterrogatorHealth::default().faults().is_empty());
        let bad = InterrogatorHealth {
            calibration_fault: true,
            error_code: 9,
            ..Default::default()
        };
        assert_eq!(bad.faults(), ["calibration-fault", "error-code"]);
    }
}
