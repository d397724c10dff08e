//! A motorised mount: a second axis on the stage's chain, whose microsteps count trajectories.

use super::chain::Chain;
use super::check_travel;
use super::stage::ZaberStage;
use super::units::Microsteps;
use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt, move_allowance};
use wcal_core::device::{DeviceError, DeviceErrorKind, Mount, Permission, Stage};
use wcal_core::rig_devices::MountRig;

/// Longest reference search of a mount (wall time).
const HOME: Duration = Duration::from_secs(60);
/// Farthest that it may stand from its target, microsteps: above the play of a closed loop, below
/// any angle that matters.
const ARRIVAL_STEPS: i64 = 50;
/// Pause between polls while it turns.
const POLL: Duration = Duration::from_millis(5);

/// The mount of a rig. Moved by [`Mount::prepare`] and [`Mount::select`] only.
pub(crate) struct ZaberMount {
    stage: ZaberStage,
    steps_per_trajectory: i64,
    unit: Microsteps,
    speed_mm_s: f64,
    clock_scale: f64,
    interrupt: Interrupt,
}

impl ZaberMount {
    /// The mount of a rig on an open chain; `None` where the whisker is turned by hand. Moves
    /// nothing.
    ///
    /// # Errors
    /// What the unit reports, or a travel that is not the one stated.
    pub(crate) fn open(
        rig: &MountRig,
        chain: Rc<RefCell<Chain>>,
        clock: HostClock,
        interrupt: &Interrupt,
    ) -> Result<Option<Self>, DeviceError> {
        let MountRig::Zaber {
            address,
            steps_per_trajectory,
            microstep_um,
            speed_mm_s,
            travel_mm,
        } = rig
        else {
            return Ok(None);
        };
        let unit = Microsteps {
            size_um: *microstep_um,
        };
        let mut stage = ZaberStage::new(chain, *address, 1, unit, clock).map_err(of_mount)?;
        if let Some(stated_mm) = travel_mm {
            check_travel("mount", *stated_mm, stage.travel_mm()?[1])?;
        }
        Ok(Some(Self {
            stage,
            steps_per_trajectory: *steps_per_trajectory,
            unit,
            speed_mm_s: *speed_mm_s,
            clock_scale: clock.scale(),
            interrupt: interrupt.clone(),
        }))
    }

    /// Where a trajectory is presented, mm of the mount's own scale.
    fn target_mm(&self, trajectory: u32) -> f64 {
        self.unit
            .to_mm(i64::from(trajectory) as f64 * self.steps_per_trajectory as f64)
    }

    /// Waits for the end of a motion and gives back where it ended; a mount that does not get there
    /// is stopped.
    fn until_standing(&mut self, allowed: Duration) -> Result<f64, DeviceError> {
        let deadline = Deadline::after(allowed, &self.interrupt);
        let result = loop {
            match self.stage.read() {
                Ok(reading) if !reading.moving => break Ok(reading.measured_mm),
                Ok(reading) if deadline.is_over() => {
                    let found = format!("still moving (BUSY) at {:.3} mm", reading.measured_mm);
                    break Err(deadline.error("mount", "turn", "standstill", &found));
                }
                Ok(_) => self.stage.pause(POLL, &deadline),
                Err(e) => break Err(e),
            }
        };
        result.inspect_err(|_| {
            // The error on its way to the user says more than one of the stop.
            let _ = self.stage.stop();
        })
    }
}

/// An error of the mount, which its unit takes for one of the stage: both hang on one line.
fn of_mount(error: DeviceError) -> DeviceError {
    DeviceError {
        device: "mount".to_owned(),
        ..error
    }
}

impl Mount for ZaberMount {
    fn check(&mut self, trajectories: &[u32], allowed: Permission) -> Result<(), DeviceError> {
        let [low_mm, high_mm] = self.stage.travel_mm()?;
        for trajectory in trajectories {
            let target_mm = self.target_mm(*trajectory);
            if !(low_mm..=high_mm).contains(&target_mm) {
                let action = format!("turn to trajectory {trajectory}");
                let expected = format!("a target in {low_mm:.3}..{high_mm:.3} mm");
                let (kind, found) = (DeviceErrorKind::OutOfRange, format!("{target_mm:.3} mm"));
                return Err(DeviceError::new(kind, "mount", action, expected, found));
            }
        }
        match self.stage.read() {
            Err(e) if !allowed.covers(&e) => Err(of_mount(e)),
            _ => Ok(()),
        }
    }

    fn prepare(&mut self, allowed: Permission) -> Result<(), DeviceError> {
        let cleared = if allowed.clear_flags {
            self.stage.clear_flags().map_err(of_mount)?
        } else {
            Vec::new()
        };
        let lost = match self.stage.read() {
            Err(e) if e.kind == DeviceErrorKind::NotHomed && allowed.home => true,
            reading => reading.map(|_| false).map_err(of_mount)?,
        };
        if lost || !cleared.is_empty() {
            self.stage.start_home().map_err(of_mount)?;
        }
        self.until_standing(HOME).map(|_| ()).map_err(of_mount)
    }

    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        let target_mm = self.target_mm(trajectory);
        let way_mm = target_mm - self.stage.read().map_err(of_mount)?.measured_mm;
        self.stage
            .start_move(target_mm, self.speed_mm_s)
            .map_err(of_mount)?;
        let allowed = move_allowance(way_mm, self.speed_mm_s, self.clock_scale);
        let found_mm = self.until_standing(allowed).map_err(of_mount)?;
        // A mount that stands elsewhere presents another trajectory.
        if (self.unit.from_mm(found_mm) - self.unit.from_mm(target_mm)).abs() <= ARRIVAL_STEPS {
            return Ok(());
        }
        let action = format!("turn to trajectory {trajectory}");
        let (expected, found) = (format!("{target_mm:.4} mm"), format!("{found_mm:.4} mm"));
        Err(DeviceError::new(
            DeviceErrorKind::Stalled,
            "mount",
            action,
            expected,
            found,
        ))
    }
    fn stop(&mut self) -> Result<(), DeviceError> {
        self.stage.stop().map_err(of_mount)
    }
}
