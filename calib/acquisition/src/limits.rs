//! Where the stage of a rig may be sent, and the one gate that every commanded move passes.
//!
//! ```text
//! max(soft low, unit's low) <= p <= min(soft high, unit's high)              p position, mm of the stage's own scale
//! ```

use crate::error::AcquisitionError;
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading};
use wcal_core::rig_devices::StageRig;

/// Positions that a stage may be sent to, mm of the stage's scale: the rig's soft limits within the
/// unit's travel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    low_mm: f64,
    high_mm: f64,
    zero_mm: f64,
}

impl Limits {
    /// The limits of a rig's stage on a unit with this travel, mm.
    pub fn new(rig: &StageRig, travel_mm: [f64; 2]) -> Self {
        // The narrower of both: the rig's file cannot widen what the unit itself can do.
        let [low, high] = rig.soft_limits_mm;
        Self {
            low_mm: low.max(travel_mm[0]),
            high_mm: high.min(travel_mm[1]),
            zero_mm: rig.zero_mm,
        }
    }

    /// The same as depths, mm from the stage's zero.
    pub fn depths_mm(&self) -> [f64; 2] {
        [self.low_mm - self.zero_mm, self.high_mm - self.zero_mm]
    }

    /// What is allowed, where `position_mm` is not.
    fn refusal(&self, position_mm: f64) -> Option<String> {
        let inside = (self.low_mm..=self.high_mm).contains(&position_mm);
        (!inside).then(|| {
            format!(
                "a stage position in {:.3}..{:.3} mm",
                self.low_mm, self.high_mm
            )
        })
    }

    /// Checks a depth, mm from the stage's zero.
    ///
    /// # Errors
    /// What is allowed and what was asked for; `what` names the move.
    pub fn check(&self, what: &str, depth_mm: f64) -> Result<(), AcquisitionError> {
        let position_mm = self.zero_mm + depth_mm;
        match self.refusal(position_mm) {
            None => Ok(()),
            Some(expected) => Err(AcquisitionError::input(
                what,
                expected,
                format!("{position_mm:.3} mm"),
            )),
        }
    }
}

/// A stage that takes no target outside its limits. A sweep has no other: whatever computes a
/// target, this is what sends it.
pub struct LimitedStage {
    /// None once its link is closed.
    stage: Option<Box<dyn Stage>>,
    limits: Limits,
}

impl LimitedStage {
    /// A stage behind its limits.
    pub fn new(stage: Box<dyn Stage>, limits: Limits) -> Self {
        Self {
            stage: Some(stage),
            limits,
        }
    }

    /// Closes the link: a serial port can be opened again only when nobody holds it. Every later
    /// call is refused.
    pub fn close(&mut self) {
        self.stage = None;
    }

    fn open(&mut self) -> Result<&mut dyn Stage, DeviceError> {
        let closed = || {
            let (kind, device) = (DeviceErrorKind::Disconnected, "stage");
            DeviceError::new(kind, device, "command", "an open link", "none: it was lost")
        };
        self.stage
            .as_deref_mut()
            .map(|s| s as &mut dyn Stage)
            .ok_or_else(closed)
    }
}

impl Stage for LimitedStage {
    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        match self.limits.refusal(target_mm) {
            None => self.open()?.start_move(target_mm, speed_mm_s),
            Some(expected) => {
                let (kind, found) = (DeviceErrorKind::OutOfRange, format!("{target_mm:.4} mm"));
                Err(DeviceError::new(kind, "stage", "move", expected, found))
            }
        }
    }

    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        self.open()?.identity()
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        self.open()?.travel_mm()
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        self.open()?.start_home()
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        self.open()?.read()
    }

    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        self.open()?.clear_flags()
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.open()?.stop()
    }
}
