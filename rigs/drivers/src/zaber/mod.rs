//! Zaber stages: the ASCII protocol through `zproto`, the binary protocol of T-series units.

pub mod binary;
pub mod chain;
pub mod checksum;
pub mod flags;
pub mod mount;
pub mod stage;
pub mod units;
pub mod wire;

use wcal_core::device::{DeviceError, DeviceErrorKind};

pub use binary::{BinaryLine, ZaberBinary};
pub use chain::Chain;
pub(crate) use mount::ZaberMount;
pub use stage::ZaberStage;
pub use wire::Port;

/// Largest difference between a travel that is stated and that of the unit's limit: a microstep
/// size that is wrong by 0.2 % scales every position.
const TRAVEL_TOLERANCE: f64 = 1e-3;

/// Refuses a travel that is not the one stated.
pub(crate) fn check_travel(device: &str, stated_mm: f64, limit_mm: f64) -> Result<(), DeviceError> {
    if (limit_mm - stated_mm).abs() <= TRAVEL_TOLERANCE * stated_mm {
        return Ok(());
    }
    let expected = format!("the rig's travel of {stated_mm} mm");
    let found = format!(
        "{limit_mm:.3} mm by the unit's limit and the rig's microstep_um ({:+.2} %)",
        100.0 * (limit_mm / stated_mm - 1.0)
    );
    Err(DeviceError::new(
        DeviceErrorKind::Configuration,
        device,
        "open",
        expected,
        found,
    ))
}
