//! Relative motion of base and object from a log: pose and velocity at a time, and the intervals in
//! which the motion is unknown.
//!
//! Between two rows a and b the translation is linear in time and the rotation follows the shortest
//! arc at constant rate:
//!
//! ```text
//! u = (t - t_a) / (t_b - t_a),   d(t) = (1 - u) d_a + u d_b,   Q(t) = Q_a exp(u log(Q_a^T Q_b))
//! v = (Q_b q + d_b - Q_a q - d_a) / (t_b - t_a),   q = Q(t)^T (p - d(t))      of the object's point at p
//! ```
//!
//! Source of the rotation: K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985,
//! 245.

use crate::error::InputError;
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};
use wcal_core::order_statistics::median;

/// Longest interval between rows over which the motion is interpolated: this many times the log's
/// median step, at least this many s.
const GAP_STEPS: f64 = 5.0;
const GAP_S: f64 = 0.5;
/// A step is a jump where its speed exceeds the median of the moving steps by this factor and its
/// length exceeds this many mm.
const JUMP_RATIO: f64 = 20.0;
const JUMP_MM: f64 = 1.0;
/// Times closer than this are equal: rounding error, s.
const SAME_S: f64 = 1e-6;
/// Steps below this count as standstill, mm.
const STILL_MM: f64 = 1e-3;
/// Rotations are converted to displacements at this lever arm, mm: the length of a whisker.
const ARM_MM: f64 = 60.0;
/// Clocks whose spans differ by so much are not in the same unit.
const SPANS: f64 = 100.0;

/// A row of a log: a point of the object at p in a fixed frame is at `turn p + moved` in the base
/// frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogRow {
    /// Line in its file.
    pub line: usize,
    /// Time, s.
    pub t_s: f64,
    /// Rotation.
    pub turn: Rotation3<f64>,
    /// Translation, mm.
    pub moved_mm: Vector3<f64>,
}

/// Motion at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// See [`LogRow::turn`].
    pub turn: Rotation3<f64>,
    /// See [`LogRow::moved_mm`].
    pub moved_mm: Vector3<f64>,
    /// Velocity of the requested point of the object, base frame, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Index of the piece, incremented at every jump: the motion across a jump is unknown.
    pub piece: u32,
}

impl Motion {
    /// Pose of the base in the frame in which the object rests.
    pub fn world_from_base(&self) -> Isometry3<f64> {
        let back = self.turn.inverse();
        let place = Translation3::from(back * -self.moved_mm);
        Isometry3::from_parts(place, UnitQuaternion::from_rotation_matrix(&back))
    }
}

/// Why the motion at a time is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum MotionUnknown {
    /// Before the first or after the last row.
    Outside,
    /// Between rows more than the longest interval apart in time.
    Gap,
    /// Between the two rows of a jump.
    Jump,
    /// Nothing says how base and object move.
    Unknown,
}

impl MotionUnknown {
    /// Name as in track.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::Outside => "outside",
            Self::Gap => "gap",
            Self::Jump => "jump",
            Self::Unknown => "unknown",
        }
    }
}

/// A log in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionLog {
    rows: Vec<LogRow>,
    pieces: Vec<u32>,
    max_gap_s: f64,
}

/// Length of a step, mm.
fn step_mm(a: &LogRow, b: &LogRow) -> f64 {
    // Frobenius norm / sqrt(2) = 2 sin(angle / 2): unlike an arc cosine exact to rounding near zero
    // rotation.
    let turned = (b.turn.matrix() - a.turn.matrix()).norm() / std::f64::consts::SQRT_2;
    (b.moved_mm - a.moved_mm).norm() + ARM_MM * turned
}

impl MotionLog {
    /// From rows with strictly increasing times.
    ///
    /// # Errors
    /// Fewer than two rows, or times that do not increase, by line.
    pub fn new(rows: Vec<LogRow>) -> Result<Self, InputError> {
        if rows.len() < 2 {
            let found = rows.len().to_string();
            return Err(InputError::new("motion", "at least two rows", found));
        }
        if let Some(w) = rows.windows(2).find(|w| !(w[1].t_s > w[0].t_s)) {
            let expected = format!("a later time than {} s", w[0].t_s);
            let error = InputError::new("motion", expected, w[1].t_s.to_string());
            return Err(error.at(w[1].line).field("t_s"));
        }
        let speeds = |w: &[LogRow]| step_mm(&w[0], &w[1]) / (w[1].t_s - w[0].t_s);
        let moving = rows
            .windows(2)
            .filter(|w| step_mm(&w[0], &w[1]) > STILL_MM)
            .map(speeds);
        let median_mm_s = median(moving).unwrap_or(0.0);
        let step_s = median(rows.windows(2).map(|w| w[1].t_s - w[0].t_s)).unwrap_or(0.0);
        let max_gap_s = (GAP_STEPS * step_s).max(GAP_S);
        let mut pieces = vec![0];
        for w in rows.windows(2) {
            let jumped = step_mm(&w[0], &w[1]) > JUMP_MM && speeds(w) > JUMP_RATIO * median_mm_s;
            pieces.push(pieces[pieces.len() - 1] + u32::from(jumped));
        }
        Ok(Self {
            rows,
            pieces,
            max_gap_s,
        })
    }

    /// First and last time, s.
    pub fn span_s(&self) -> [f64; 2] {
        [self.rows[0].t_s, self.rows[self.rows.len() - 1].t_s]
    }

    /// Lines at which the log jumped.
    pub fn jumps(&self) -> impl Iterator<Item = usize> {
        let after = self.pieces.windows(2).zip(&self.rows[1..]);
        after.filter(|(p, _)| p[0] != p[1]).map(|(_, r)| r.line)
    }

    /// Checks the log's clock against that of readings (first and last time, s).
    ///
    /// # Errors
    /// Where they have nothing in common, or spans that only another unit of time explains.
    pub fn check_clock(&self, readings_s: [f64; 2]) -> Result<(), InputError> {
        let ([a, b], [first, last]) = (self.span_s(), readings_s);
        let ratio = (b - a) / (last - first).max(f64::MIN_POSITIVE);
        let found = format!("{a} to {b} s");
        if last > first && !(1.0 / SPANS..=SPANS).contains(&ratio) {
            let expected = format!("seconds by the readings' clock ({first} to {last} s)");
            return Err(InputError::new("clock of the motion", expected, found));
        }
        if b < first || a > last {
            let expected =
                format!("times that overlap those of the readings ({first} to {last} s)");
            return Err(InputError::new("clock of the motion", expected, found));
        }
        Ok(())
    }

    /// Motion at a time (s), with the velocity of the object's point that is at `point_mm` (base
    /// frame) then.
    ///
    /// # Errors
    /// Where the motion is unknown at this time.
    pub fn at(&self, t_s: f64, point_mm: &Vector3<f64>) -> Result<Motion, MotionUnknown> {
        let after = self.rows.partition_point(|r| r.t_s < t_s - SAME_S);
        // At a row's own time the pose is known; the velocity is that of an adjoining interval that
        // is known.
        let own = self.rows.get(after).is_some_and(|r| r.t_s <= t_s + SAME_S);
        let sides = [after.checked_sub(1), own.then_some(after)]
            .into_iter()
            .flatten();
        let mut why = MotionUnknown::Outside;
        for k in sides.filter(|k| k + 1 < self.rows.len()) {
            match self.between(k) {
                Ok(()) => return Ok(self.on(k, t_s, point_mm)),
                Err(lost) => why = lost,
            }
        }
        let row = self.rows.get(after).filter(|_| own).ok_or(why)?;
        let (turn, moved_mm, piece) = (row.turn, row.moved_mm, self.pieces[after]);
        Ok(Motion {
            turn,
            moved_mm,
            velocity_mm_s: Vector3::zeros(),
            piece,
        })
    }

    /// Motion averaged over a filter's times and weights around a time (s), with the rotation at
    /// that time.
    ///
    /// # Errors
    /// Where the motion is unknown within the filter.
    pub fn averaged(
        &self,
        t_s: f64,
        point_mm: &Vector3<f64>,
        kernel: &[(f64, f64)],
    ) -> Result<Motion, MotionUnknown> {
        let here = self.at(t_s, point_mm)?;
        let fixed = here.turn.inverse() * (point_mm - here.moved_mm);
        let (mut place, mut velocity_mm_s) = (Vector3::zeros(), Vector3::zeros());
        for (offset_s, weight) in kernel {
            let m = self.at(t_s + offset_s, point_mm)?;
            if m.piece != here.piece {
                return Err(MotionUnknown::Jump);
            }
            place += (m.turn * fixed + m.moved_mm) * *weight;
            velocity_mm_s += m.velocity_mm_s * *weight;
        }
        Ok(Motion {
            moved_mm: place - here.turn * fixed,
            velocity_mm_s,
            ..here
        })
    }

    /// Whether the motion between a row and the next is known.
    fn between(&self, k: usize) -> Result<(), MotionUnknown> {
        let (a, b) = (&self.rows[k], &self.rows[k + 1]);
        if self.pieces[k + 1] != self.pieces[k] {
            return Err(MotionUnknown::Jump);
        }
        // A logger that writes only on change leaves intervals at standstill: equal poses at both
        // ends are no gap.
        if b.t_s - a.t_s > self.max_gap_s && step_mm(a, b) > STILL_MM {
            return Err(MotionUnknown::Gap);
        }
        Ok(())
    }

    /// Motion between a row and the next.
    fn on(&self, k: usize, t_s: f64, point_mm: &Vector3<f64>) -> Motion {
        let (a, b) = (&self.rows[k], &self.rows[k + 1]);
        let dt_s = b.t_s - a.t_s;
        // A screw at constant rate in between.
        let u = (t_s - a.t_s) / dt_s;
        let turn = a.turn.slerp(&b.turn, u);
        let moved_mm = a.moved_mm + (b.moved_mm - a.moved_mm) * u;
        // The point in the object's own frame, in which it is fixed over the interval.
        let fixed = turn.inverse() * (point_mm - moved_mm);
        let of = |r: &LogRow| r.turn * fixed + r.moved_mm;
        Motion {
            turn,
            moved_mm,
            velocity_mm_s: (of(b) - of(a)) / dt_s,
            piece: self.pieces[k],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(rows: &[(f64, f64)]) -> MotionLog {
        let row = |(k, (t_s, z)): (usize, &(f64, f64))| LogRow {
            line: k + 2,
            t_s: *t_s,
            turn: Rotation3::identity(),
            moved_mm: Vector3::z() * *z,
        };
        MotionLog::new(rows.iter().enumerate().map(row).collect()).unwrap()
    }

    #[test]
    fn motion_is_known_between_rows_and_nowhere_else() {
        let even: Vec<(f64, f64)> = (0..20)
            .map(|k| (0.1 * f64::from(k), 0.4 * f64::from(k)))
            .collect();
        let at = |log: &MotionLog, t: f64| log.at(t, &Vector3::x());
        let known = at(&log(&even), 0.25).unwrap();
        assert!(
            (known.moved_mm.z - 1.0).abs() < 1e-12 && (known.velocity_mm_s.z - 4.0).abs() < 1e-9
        );
        assert_eq!(at(&log(&even), -0.1), Err(MotionUnknown::Outside));
        assert_eq!(at(&log(&even), 1.95), Err(MotionUnknown::Outside));
        assert!(at(&log(&even), 0.0).is_ok() && at(&log(&even), 1.9).is_ok());
        // A second without rows during motion, and during standstill.
        let mut gap = even.clone();
        gap[10..].iter_mut().for_each(|r| *r = (r.0 + 1.0, r.1));
        assert_eq!(at(&log(&gap), 1.5), Err(MotionUnknown::Gap));
        gap[10..].iter_mut().for_each(|r| r.1 -= 0.4);
        assert!((at(&log(&gap), 1.5).unwrap().moved_mm.z - 3.6).abs() < 1e-9);
        // A jump parts the log.
        let mut jumped = even.clone();
        jumped[10..].iter_mut().for_each(|r| r.1 += 30.0);
        let parted = log(&jumped);
        assert_eq!(
            (at(&parted, 0.95), parted.jumps().collect::<Vec<_>>()),
            (Err(MotionUnknown::Jump), vec![12])
        );
        assert_eq!([0.5, 1.5].map(|t| at(&parted, t).unwrap().piece), [0, 1]);
        assert_eq!(log(&even).jumps().count(), 0);
        // The rows on both sides of it are known.
        assert_eq!([0.9, 1.0].map(|t| at(&parted, t).unwrap().piece), [0, 1]);
    }

    #[test]
    fn a_turning_base_moves_the_point_it_is_asked_for() {
        let row = |k: u32| LogRow {
            line: 0,
            t_s: f64::from(k),
            turn: Rotation3::from_axis_angle(&Vector3::z_axis(), 0.01 * f64::from(k)),
            moved_mm: Vector3::new(0.5, 0.0, 0.0) * f64::from(k),
        };
        let log = MotionLog::new((0..5).map(row).collect()).unwrap();
        let point = Vector3::new(40.0, 0.0, 0.0);
        let v = log.at(2.5, &point).unwrap().velocity_mm_s;
        // w x (p - d) in addition to the translation's velocity.
        assert!(
            (v - Vector3::new(0.5, 0.01 * 38.75, 0.0)).norm() < 1e-3,
            "{v:?}"
        );
    }

    #[test]
    fn clocks_that_do_not_belong_together_are_named() {
        let rows: Vec<(f64, f64)> = (0..20).map(|k| (f64::from(k), f64::from(k))).collect();
        let said = |readings: [f64; 2]| log(&rows).check_clock(readings).unwrap_err().to_string();
        assert!(
            said([100.0, 110.0]).contains("overlap"),
            "{}",
            said([100.0, 110.0])
        );
        assert!(said([0.0, 0.02]).contains("seconds") && said([0.0, 19_000.0]).contains("seconds"));
        assert!(log(&rows).check_clock([5.0, 30.0]).is_ok());
        let rows = vec![
            LogRow {
                line: 7,
                t_s: 1.0,
                turn: Rotation3::identity(),
                moved_mm: Vector3::zeros()
            };
            2
        ];
        assert!(
            MotionLog::new(rows)
                .unwrap_err()
                .to_string()
                .contains("line 7")
        );
    }
}
