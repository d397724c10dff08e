//! What is known of an axis, whatever protocol its unit speaks.

use super::units::Microsteps;
use wcal_core::clock::HostClock;
use wcal_core::device::{Clocks, DeviceError, DeviceErrorKind, StageReading};

/// Largest difference between a travel that is stated and that of the unit's limit: a microstep
/// size that is wrong by 0.2 % scales every position.
const TRAVEL_TOLERANCE: f64 = 1e-3;

/// Microsteps, travel and target of an axis.
pub(super) struct Axis {
    pub unit: Microsteps,
    pub limit_steps: i64,
    pub clock: HostClock,
    pub commanded_mm: Option<f64>,
}

impl Axis {
    /// Lowest and highest position, mm.
    pub(super) fn travel_mm(&self) -> [f64; 2] {
        [0.0, self.unit.to_mm(self.limit_steps as f64)]
    }

    /// The microstep of a target, or what is allowed in its place.
    pub(super) fn steps_to(&self, target_mm: f64) -> Result<i64, String> {
        let steps = self.unit.from_mm(target_mm);
        // NaN rounds to microstep 0, which is within the travel: it is refused by itself.
        if (0..=self.limit_steps).contains(&steps) && target_mm.is_finite() {
            return Ok(steps);
        }
        let [low_mm, high_mm] = self.travel_mm();
        Err(format!("a target in {low_mm}..{high_mm:.3} mm"))
    }

    /// A reading that came at a host time, s.
    pub(super) fn reading(
        &self,
        host_s: f64,
        steps: f64,
        moving: bool,
        flags: Vec<String>,
    ) -> StageReading {
        StageReading {
            commanded_mm: self.commanded_mm,
            measured_mm: self.unit.to_mm(steps),
            moving,
            flags,
            // The protocols carry no time stamps: the host's time is all there is.
            clocks: Clocks {
                host_s,
                device_s: None,
            },
        }
    }
}

/// Refuses a travel that is not the one stated.
pub(super) fn check_travel(device: &str, stated_mm: f64, limit_mm: f64) -> Result<(), DeviceError> {
    if (limit_mm - stated_mm).abs() <= TRAVEL_TOLERANCE * stated_mm {
        return Ok(());
    }
    let expected = format!("the rig's travel of {stated_mm} mm");
    let found = format!(
        "{limit_mm:.3} mm by the unit's limit and the rig's microstep_um ({:+.2} %)",
        100.0 * (limit_mm / stated_mm - 1.0)
    );
    let kind = DeviceErrorKind::Configuration;
    Err(DeviceError::new(kind, device, "open", expected, found))
}
