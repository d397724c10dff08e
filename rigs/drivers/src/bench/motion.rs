//! Exact motion of a stepper axis: constant-acceleration pieces, kept so that late readers can
//! evaluate the recent past.
//!
//! ```text
//! x(t) = x_0 + v_0 dt + a dt^2 / 2                                             within a piece
//! v_top = min(v_max, sqrt((v_0^2 + 2 a d) / 2))                                over a distance d to rest: trapezoid, or triangle if short
//! ```

use std::collections::VecDeque;

/// How long the past is kept, s.
const HISTORY_S: f64 = 60.0;

/// A piece of constant acceleration that starts at `t_s`.
#[derive(Debug, Clone, Copy)]
struct MotionSegment {
    t_s: f64,
    length_s: f64,
    x_mm: f64,
    v_mm_s: f64,
    a_mm_s2: f64,
}

impl MotionSegment {
    fn rest(t_s: f64, x_mm: f64) -> Self {
        Self {
            t_s,
            length_s: f64::INFINITY,
            x_mm,
            v_mm_s: 0.0,
            a_mm_s2: 0.0,
        }
    }

    fn at(&self, t_s: f64) -> (f64, f64) {
        let dt = (t_s - self.t_s).clamp(0.0, self.length_s);
        (
            self.x_mm + self.v_mm_s * dt + 0.5 * self.a_mm_s2 * dt * dt,
            self.v_mm_s + self.a_mm_s2 * dt,
        )
    }
}

/// Position of one axis as a function of time.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    pieces: VecDeque<MotionSegment>,
    /// Of later moves, mm/s^2.
    pub(super) acceleration_mm_s2: f64,
}

impl Motion {
    /// At rest at `x_mm`; every move uses `acceleration_mm_s2`.
    pub(super) fn at_rest(x_mm: f64, acceleration_mm_s2: f64) -> Self {
        Self {
            pieces: VecDeque::from([MotionSegment::rest(-1.0, x_mm)]),
            acceleration_mm_s2,
        }
    }

    /// Position (mm) and velocity (mm/s) at `t_s`; before the kept past, those at its start.
    pub(super) fn at(&self, t_s: f64) -> (f64, f64) {
        let piece = self
            .pieces
            .iter()
            .rev()
            .find(|p| p.t_s <= t_s)
            .or(self.pieces.front());
        piece.map_or((0.0, 0.0), |p| p.at(t_s))
    }

    /// When the motion ends, s; the start of the last rest.
    pub(super) fn end_s(&self) -> f64 {
        self.pieces.back().map_or(0.0, |p| p.t_s)
    }

    /// From the state at `t_s` to rest at `target_mm`, not faster than `speed_mm_s`.
    pub(super) fn go(&mut self, t_s: f64, target_mm: f64, speed_mm_s: f64) {
        let mut plan = self.cut(t_s);
        let (x, v, a) = (plan.x_mm, plan.v_mm_s, self.acceleration_mm_s2);
        // v^2 = 2 a d: the way to standstill.
        let braking_mm = v * v / (2.0 * a) * v.signum();
        // Moving away, or too fast to stop in time: come to rest first.
        if v != 0.0 && (target_mm - (x + braking_mm)) * v < 0.0 {
            self.push(&mut plan, v.abs() / a, -a * v.signum());
        }
        let side = (target_mm - plan.x_mm).signum();
        let (distance, v0) = ((target_mm - plan.x_mm).abs(), plan.v_mm_s.abs());
        // Highest speed of a triangle: v^2 = (v0^2 + 2 a d) / 2.
        let peak = ((v0 * v0 + 2.0 * a * distance) / 2.0).sqrt();
        let top = peak.min(speed_mm_s.max(1e-9));
        let ramp = (top - v0) / a;
        self.push(&mut plan, ramp.abs(), side * a * ramp.signum());
        // What is left between the two ramps goes at full speed.
        let ramps_mm = (top * top - v0 * v0).abs() / (2.0 * a) + top * top / (2.0 * a);
        self.push(&mut plan, ((distance - ramps_mm) / top).max(0.0), 0.0);
        self.push(&mut plan, top / a, -side * a);
        self.rest(plan.t_s, target_mm);
    }

    /// Decelerates to standstill from `t_s` on.
    pub(super) fn halt(&mut self, t_s: f64) {
        let mut plan = self.cut(t_s);
        let (v, a) = (plan.v_mm_s, self.acceleration_mm_s2);
        self.push(&mut plan, v.abs() / a, -a * v.signum());
        self.rest(plan.t_s, plan.x_mm);
    }

    /// Stands still at once, as a stalled motor does.
    pub(super) fn freeze(&mut self, t_s: f64) {
        let plan = self.cut(t_s);
        self.rest(t_s, plan.x_mm);
    }

    /// State at `t_s`; drops what was planned after it and the distant past.
    fn cut(&mut self, t_s: f64) -> PlannedState {
        let (x_mm, v_mm_s) = self.at(t_s);
        while self.pieces.back().is_some_and(|p| p.t_s >= t_s) && self.pieces.len() > 1 {
            self.pieces.pop_back();
        }
        if let Some(last) = self.pieces.back_mut() {
            last.length_s = last.length_s.min((t_s - last.t_s).max(0.0));
        }
        while self.pieces.len() > 1 && self.pieces[1].t_s < t_s - HISTORY_S {
            self.pieces.pop_front();
        }
        PlannedState { t_s, x_mm, v_mm_s }
    }

    /// Adds a piece of constant acceleration, and goes on to its end.
    fn push(&mut self, plan: &mut PlannedState, length_s: f64, a_mm_s2: f64) {
        if length_s <= 0.0 {
            return;
        }
        let PlannedState { t_s, x_mm, v_mm_s } = *plan;
        let piece = MotionSegment {
            t_s,
            length_s,
            x_mm,
            v_mm_s,
            a_mm_s2,
        };
        plan.t_s += length_s;
        (plan.x_mm, plan.v_mm_s) = piece.at(plan.t_s);
        self.pieces.push_back(piece);
    }

    fn rest(&mut self, t_s: f64, x_mm: f64) {
        self.pieces.push_back(MotionSegment::rest(t_s, x_mm));
    }
}

/// Where the pieces planned so far end.
struct PlannedState {
    t_s: f64,
    x_mm: f64,
    v_mm_s: f64,
}

#[cfg(test)]
mod tests {
    use super::Motion;

    #[test]
    fn a_move_takes_the_time_of_a_trapezoid_and_ends_exactly() {
        let mut motion = Motion::at_rest(1.0, 100.0);
        motion.go(2.0, 11.0, 5.0);
        // 0.05 s ramps of 0.125 mm each, 9.75 mm at 5 mm/s.
        assert!((motion.end_s() - (2.0 + 0.1 + 1.95)).abs() < 1e-12);
        assert_eq!(motion.at(9.0), (11.0, 0.0));
        assert_eq!(motion.at(1.5).0, 1.0);
        assert!((motion.at(3.0).1 - 5.0).abs() < 1e-12);
    }

    #[test]
    fn position_and_speed_are_continuous_through_a_reversal_and_a_stop() {
        let mut motion = Motion::at_rest(0.0, 50.0);
        motion.go(0.0, 20.0, 8.0);
        motion.go(1.0, 2.0, 8.0);
        motion.halt(1.4);
        let mut last = motion.at(0.0);
        for k in 1..40_000 {
            let now = motion.at(f64::from(k) * 1e-4);
            assert!((now.0 - last.0).abs() < 9e-4, "jump at {k}");
            assert!(
                (now.1 - last.1).abs() < 50.1e-4,
                "speed jump at {k}: {last:?} {now:?}"
            );
            last = now;
        }
        assert_eq!(last.1, 0.0);
    }

    #[test]
    fn a_stall_stops_at_once_and_short_moves_never_reach_full_speed() {
        let mut motion = Motion::at_rest(0.0, 50.0);
        motion.go(0.0, 0.01, 8.0);
        let fastest = (0..1000)
            .map(|k| motion.at(f64::from(k) * 1e-4).1)
            .fold(0.0, f64::max);
        assert!(fastest < 0.75 && (fastest - (50.0_f64 * 0.01).sqrt()).abs() < 1e-2);
        motion.go(1.0, 5.0, 8.0);
        motion.freeze(1.2);
        assert_eq!(motion.at(1.3), motion.at(5.0));
        assert_eq!(motion.at(1.3).1, 0.0);
    }
}
