//! A motorised mount: a second axis on the stage's chain, whose microsteps count trajectories.

use super::POLL;
use super::axis::check_travel;
use super::chain::Chain;
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
        let stage = ZaberStage::new(chain, *address, 1, unit, clock);
        let mut stage = stage.map_err(of_mount)?;
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
        let steps = i64::from(trajectory) * self.steps_per_trajectory;
        self.unit.to_mm(steps as f64)
    }

    /// Waits for the end of a motion and gives back where it ended; a mount that does not get there
    /// is stopped.
    fn until_standing(&mut self, allowed: Duration) -> Result<f64, DeviceError> {
        let deadline = Deadline::after(allowed, &self.interrupt);
        let failure = loop {
            match self.stage.read() {
                Ok(reading) if !reading.moving => return Ok(reading.measured_mm),
                Ok(reading) if deadline.is_over() => {
                    let found = format!("still moving (BUSY) at {:.3} mm", reading.measured_mm);
                    break deadline.error("mount", "turn", "standstill", &found);
                }
                Ok(_) => self.stage.pause(POLL, &deadline),
                Err(e) => break of_mount(e),
            }
        };
        // The error on its way to the user says more than one of the stop.
        let _ = self.stage.stop();
        Err(failure)
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
        // All turns of the plan before the first one: the mount does not end a sweep halfway.
        let [low_mm, high_mm] = self.stage.travel_mm()?;
        for trajectory in trajectories {
            let target_mm = self.target_mm(*trajectory);
            if !(low_mm..=high_mm).contains(&target_mm) {
                return Err(DeviceError::new(
                    DeviceErrorKind::OutOfRange,
                    "mount",
                    format!("turn to trajectory {trajectory}"),
                    format!("a target in {low_mm:.3}..{high_mm:.3} mm"),
                    format!("{target_mm:.3} mm"),
                ));
            }
        }
        match self.stage.read() {
            Err(e) if !allowed.covers(&e) => Err(of_mount(e)),
            _ => Ok(()),
        }
    }

    fn prepare(&mut self, allowed: Permission) -> Result<(), DeviceError> {
        let mut search = false;
        if allowed.clear_flags {
            search = !self.stage.clear_flags().map_err(of_mount)?.is_empty();
        }
        match self.stage.read() {
            Err(e) if e.kind == DeviceErrorKind::NotHomed && allowed.home => search = true,
            reading => drop(reading.map_err(of_mount)?),
        }
        if search {
            self.stage.start_home().map_err(of_mount)?;
        }
        // In any case: a mount may still turn from an earlier run.
        self.until_standing(HOME).map(drop)
    }

    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        let target_mm = self.target_mm(trajectory);
        // From where it stands, so that the time allowed fits the turn.
        let way_mm = target_mm - self.stage.read().map_err(of_mount)?.measured_mm;
        let started = self.stage.start_move(target_mm, self.speed_mm_s);
        started.map_err(of_mount)?;
        let allowed = move_allowance(way_mm, self.speed_mm_s, self.clock_scale);
        let found_mm = self.until_standing(allowed)?;
        // A mount that stands elsewhere presents another trajectory.
        if (self.unit.from_mm(found_mm) - self.unit.from_mm(target_mm)).abs() <= ARRIVAL_STEPS {
            return Ok(());
        }
        Err(DeviceError::new(
            DeviceErrorKind::Stalled,
            "mount",
            format!("turn to trajectory {trajectory}"),
            format!("{target_mm:.4} mm"),
            format!("{found_mm:.4} mm"),
        ))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.stage.stop().map_err(of_mount)
    }
}
