//! Before the first move toward the wire: what stands in the way is found out while nothing has
//! moved yet, and put right in the order that is safe.
//!
//! ```text
//! stage: flags cleared, reference searched -> stage retracted -> mount: flags cleared, reference searched
//! ```

use crate::plan::Step;
use crate::steps::Sweep;
use wcal_core::device::{DeviceError, DeviceErrorKind, Mount, Permission, Stage};

/// A reference search is allowed a move over this many travels: it is slow at its end, and may
/// begin with the wrong direction.
const HOME_TRAVELS: f64 = 4.0;

/// Whether the sweep can begin with what the user allows; asks, moves nothing.
pub(crate) fn check(
    stage: &mut dyn Stage,
    mount: &mut dyn Mount,
    steps: &[Step],
    allowed: Permission,
) -> Result<(), DeviceError> {
    if let Err(e) = stage.read()
        && !allowed.covers(&e)
    {
        return Err(e);
    }
    let trajectories: Vec<u32> = steps
        .iter()
        .filter_map(|step| match step {
            Step::Mount { trajectory } => Some(*trajectory),
            _ => None,
        })
        .collect();
    mount.check(&trajectories, allowed)
}

impl Sweep<'_, '_, '_> {
    /// The stage's flags and reference, as far as the user allows.
    pub(crate) fn reference(&mut self, allowed: Permission) -> Result<(), DeviceError> {
        // A flag that the unit keeps makes every reading an error: it goes first.
        let cleared = match allowed.clear_flags {
            true => {
                let cleared = self.bench.stage.clear_flags();
                self.of_stage(cleared)?
            }
            false => Vec::new(),
        };
        let lost = match self.bench.stage.read() {
            Err(e) if e.kind == DeviceErrorKind::NotHomed && allowed.home => true,
            reading => {
                let reading = self.of_stage(reading)?;
                self.note(reading)?;
                false
            }
        };
        // After a stall the unit may count from a place where it is not.
        if lost || !cleared.is_empty() {
            let started = self.bench.stage.start_home();
            self.of_stage(started)?;
            let rig = &self.rig.stage;
            self.until_standing(
                "search the reference",
                HOME_TRAVELS * rig.travel_mm,
                rig.speed_mm_s,
            )?;
        }
        Ok(())
    }
}
