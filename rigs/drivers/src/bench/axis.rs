//! One stepper axis of the virtual bench: motion, reference, flags. Independent of protocols.

use super::motion::Motion;
use crate::zaber::units::Microsteps;
use std::collections::BTreeSet;

/// Flags in the order in which a unit reports them: faults before warnings before notices.
const PRIORITY: [&str; 17] = [
    "FF", "FN", "FZ", "FO", "FD", "FQ", "FS", "FE", "WR", "WH", "WL", "WV", "WT", "WM", "WS", "NC",
    "NI",
];
/// Flags that only a reference search takes away.
const UNTIL_HOME: [&str; 2] = ["WR", "WH"];

/// Fixed properties of an axis.
#[derive(Debug, Clone)]
pub struct AxisSpec {
    /// Microstep size.
    pub unit: Microsteps,
    /// Highest position, microsteps.
    pub limit_steps: i64,
    /// Default and highest speed, mm/s.
    pub max_speed_mm_s: f64,
    /// Acceleration, mm/s^2.
    pub acceleration_mm_s2: f64,
}

/// Why a command was refused, in the protocol's words.
type Refusal = &'static str;

/// State of one axis at bench time.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Fixed properties.
    pub spec: AxisSpec,
    pub(super) motion: Motion,
    /// Speed of moves that name none, mm/s.
    pub speed_mm_s: f64,
    homing_until_s: Option<f64>,
    sticky: BTreeSet<&'static str>,
    stall_armed: bool,
    /// The next motion never ends; the present one does not.
    endless: [bool; 2],
    busy_seen: bool,
}

impl Axis {
    /// At `x_mm`, with or without a reference.
    pub fn new(spec: AxisSpec, x_mm: f64, homed: bool) -> Self {
        let motion = Motion::at_rest(x_mm, spec.acceleration_mm_s2);
        let mut sticky = BTreeSet::from(["WR"]);
        sticky.retain(|_| !homed);
        Self {
            speed_mm_s: spec.max_speed_mm_s,
            spec,
            motion,
            homing_until_s: None,
            sticky,
            stall_armed: false,
            endless: [false; 2],
            busy_seen: false,
        }
    }

    /// Brings the state to `t_s`; true when a motion ended since the last call.
    pub fn update(&mut self, t_s: f64) -> bool {
        if self.homing_until_s.is_some_and(|end| t_s >= end) {
            self.homing_until_s = None;
            self.sticky.retain(|f| !UNTIL_HOME.contains(f));
        }
        // Only what moves can stall: an armed stall waits for the motion.
        if self.stall_armed && self.busy(t_s) {
            self.stall_armed = false;
            self.stop_dead(t_s, "FS");
        }
        if self.endless[0] && self.busy(t_s) {
            self.endless = [false, true];
        }
        let busy = self.busy(t_s);
        let ended = self.busy_seen && !busy;
        self.busy_seen = busy;
        ended
    }

    /// True position (mm) and speed (mm/s), also for the recent past.
    pub fn at(&self, t_s: f64) -> (f64, f64) {
        self.motion.at(t_s)
    }

    /// Position as the unit counts it, microsteps.
    pub fn steps(&self, t_s: f64) -> i64 {
        self.spec.unit.from_mm(self.at(t_s).0)
    }

    /// Whether it moves.
    pub fn busy(&self, t_s: f64) -> bool {
        self.endless[1] || t_s < self.motion.end_s()
    }

    /// Whether the position has a reference.
    pub fn homed(&self) -> bool {
        !UNTIL_HOME.iter().any(|f| self.sticky.contains(f))
    }

    /// Flags shown, highest priority first.
    pub fn flags(&self) -> Vec<&'static str> {
        let all = PRIORITY.into_iter();
        all.filter(|f| self.sticky.contains(f)).collect()
    }

    /// What `warnings clear` takes away.
    // References are searched, and FF and FD go with a power cycle alone.
    pub fn clear_flags(&mut self) {
        self.sticky
            .retain(|f| UNTIL_HOME.contains(f) || *f == "FF" || *f == "FD");
    }

    /// Shows a flag from now on.
    pub(crate) fn raise(&mut self, flag: &'static str) {
        self.sticky.insert(flag);
    }

    /// Reference search: to the home switch at 0.
    pub fn home(&mut self, t_s: f64) -> Result<(), Refusal> {
        self.begin(t_s)?;
        self.motion.go(t_s, 0.0, self.speed_mm_s);
        self.homing_until_s = Some(self.motion.end_s());
        Ok(())
    }

    /// Move to a position in microsteps, at the given speed or the set one (mm/s).
    pub fn move_to(
        &mut self,
        t_s: f64,
        steps: i64,
        speed_mm_s: Option<f64>,
    ) -> Result<(), Refusal> {
        if !(0..=self.spec.limit_steps).contains(&steps) {
            return Err("BADDATA");
        }
        self.begin(t_s)?;
        let speed = speed_mm_s
            .unwrap_or(self.speed_mm_s)
            .min(self.spec.max_speed_mm_s);
        self.motion
            .go(t_s, self.spec.unit.to_mm(steps as f64), speed);
        Ok(())
    }

    /// Constant speed (mm/s, signed) until a limit.
    pub(crate) fn move_velocity(&mut self, t_s: f64, speed_mm_s: f64) -> Result<(), Refusal> {
        // Speed data are whole numbers: the highest speed may come back rounded up.
        if speed_mm_s.abs() > self.spec.max_speed_mm_s * (1.0 + 1e-6) {
            return Err("BADDATA");
        }
        if speed_mm_s == 0.0 {
            self.stop(t_s);
            return Ok(());
        }
        self.begin(t_s)?;
        let end = if speed_mm_s > 0.0 {
            self.spec.unit.to_mm(self.spec.limit_steps as f64)
        } else {
            0.0
        };
        self.motion.go(t_s, end, speed_mm_s.abs());
        Ok(())
    }

    /// Decelerates to rest.
    pub fn stop(&mut self, t_s: f64) {
        if self.busy(t_s) {
            self.interrupt();
            self.endless[1] = false;
            self.motion.halt(t_s);
        }
    }

    /// Speed of moves that name none, mm/s.
    pub(crate) fn set_speed(&mut self, speed_mm_s: f64) -> Result<(), Refusal> {
        if !(speed_mm_s > 0.0 && speed_mm_s <= self.spec.max_speed_mm_s * 1.001) {
            return Err("BADDATA");
        }
        self.speed_mm_s = speed_mm_s;
        Ok(())
    }

    /// The next (or present) motion stalls.
    pub fn arm_stall(&mut self) {
        self.stall_armed = true;
    }

    /// The next (or present) motion never ends by itself.
    pub(crate) fn arm_endless(&mut self) {
        self.endless[0] = true;
    }

    /// Stops without a ramp and sets `flag`.
    pub(crate) fn stop_dead(&mut self, t_s: f64, flag: &'static str) {
        self.homing_until_s = None;
        self.endless = [false; 2];
        self.motion.freeze(t_s);
        self.sticky.insert(flag);
    }

    /// Power lost and back: standing where it was, reference gone.
    pub(crate) fn power_cycle(&mut self, t_s: f64) {
        self.stop_dead(t_s, "WR");
        self.sticky.retain(|f| *f == "WR");
        self.motion.acceleration_mm_s2 = self.spec.acceleration_mm_s2;
        self.speed_mm_s = self.spec.max_speed_mm_s;
    }

    fn begin(&mut self, t_s: f64) -> Result<(), Refusal> {
        if self.sticky.contains("FD") || self.sticky.contains("FF") {
            return Err("DRIVERDISABLED");
        }
        self.sticky.remove("NI");
        if self.busy(t_s) {
            self.interrupt();
        }
        Ok(())
    }

    fn interrupt(&mut self) {
        self.sticky.insert("NI");
        // A reference search that did not finish leaves no reference.
        if self.homing_until_s.take().is_some() {
            self.sticky.insert("WH");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(homed: bool) -> Axis {
        let unit = Microsteps { size_um: 0.047_625 };
        let spec = AxisSpec {
            unit,
            limit_steps: 2_133_333,
            max_speed_mm_s: 7.0,
            acceleration_mm_s2: 100.0,
        };
        Axis::new(spec, 10.0, homed)
    }

    #[test]
    fn an_endless_motion_is_busy_until_it_is_stopped() {
        let mut a = axis(true);
        a.arm_endless();
        a.move_to(0.0, 0, None).unwrap();
        a.update(0.1);
        assert!(a.busy(1000.0) && a.steps(1000.0) == 0);
        a.stop(1000.0);
        assert!(!a.busy(1001.0));
        // Control: the motion after it ends.
        a.move_to(1001.0, 210_000, None).unwrap();
        a.update(1001.1);
        assert!(a.busy(1001.1) && !a.busy(1100.0));
    }

    #[test]
    fn homing_gives_a_reference_only_when_it_ends() {
        let mut a = axis(false);
        a.home(0.0).unwrap();
        a.update(0.5);
        assert_eq!(a.flags(), ["WR"]);
        assert!(a.update(3.0));
        assert!(a.flags().is_empty() && a.steps(3.0) == 0);
        let mut interrupted = axis(false);
        interrupted.home(0.0).unwrap();
        interrupted.stop(0.5);
        interrupted.update(9.0);
        assert_eq!(interrupted.flags(), ["WR", "WH", "NI"]);
    }

    #[test]
    fn a_stall_a_limit_and_a_dead_driver_have_their_flags() {
        let mut a = axis(true);
        a.move_to(0.0, 1_000_000, None).unwrap();
        a.arm_stall();
        a.update(1.0);
        assert_eq!(a.flags(), ["FS"]);
        assert!(!a.busy(1.0));
        a.clear_flags();
        assert!(a.flags().is_empty());
        a.raise("FD");
        assert_eq!(a.move_to(2.0, 5, None), Err("DRIVERDISABLED"));
        assert_eq!(axis(true).move_to(0.0, 2_133_334, None), Err("BADDATA"));
        assert_eq!(axis(true).move_to(0.0, -1, None), Err("BADDATA"));
    }

    #[test]
    fn a_power_cut_in_the_middle_of_a_move_leaves_the_carriage_there_without_reference() {
        let mut a = axis(true);
        a.move_to(0.0, 1_000_000, None).unwrap();
        a.power_cycle(1.0);
        assert!(!a.homed() && (a.at(5.0).0 - 16.755).abs() < 0.1);
    }
}
