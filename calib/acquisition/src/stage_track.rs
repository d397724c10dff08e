//! Where the stage was, in the interrogator's time, from its answers.

use crate::clocks::ClockFit;
use crate::message::StagePosition;
use crate::plan::ARRIVAL_MM;

/// Answers of the stage this near to a time tell its place and speed then, s; and how many do.
const NEAR_S: f64 = 0.025;
const MIN_NEAR: usize = 4;
/// The next move may begin at the end of a window, and answers are stamped some milliseconds off: its last part shows nothing, s.
const NEXT_MOVE_S: f64 = 0.05;

/// Stage depth (mm) in device time.
pub(crate) struct Track {
    points: Vec<(f64, f64)>,
    /// Whether each answer said that the stage moves.
    moving: Vec<bool>,
}

impl Track {
    pub(crate) fn new(stage: &[StagePosition], fit: &ClockFit, zero_mm: f64) -> Self {
        let points = stage.iter().map(|r| (fit.device_s(r.host_s), r.measured_mm - zero_mm)).collect();
        Self { points, moving: stage.iter().map(|r| r.moving).collect() }
    }

    /// Whether the stage moved in a settled window, or stood elsewhere than at `target_mm`, mm from its zero.
    pub(crate) fn has_left(&self, target_mm: f64, begin_s: f64, end_s: f64) -> bool {
        let end_s = end_s - NEXT_MOVE_S.min((end_s - begin_s) / 4.0);
        let (from, to) =
            (self.points.partition_point(|p| p.0 < begin_s), self.points.partition_point(|p| p.0 <= end_s));
        // A damaged window may end before it begins.
        let inside = from..to.max(from);
        let mut answers = self.points[inside.clone()].iter().zip(&self.moving[inside]);
        answers.any(|((_, mm), moving)| *moving || (mm - target_mm).abs() > ARRIVAL_MM)
    }

    /// Depth (mm) and speed (mm/s): the line through the answers around it, or between its neighbours where there are few; `None` outside the
    /// recording.
    pub(crate) fn at(&self, t_s: f64) -> Option<(f64, f64)> {
        let before = |limit_s: f64| self.points.partition_point(|p| p.0 <= limit_s);
        let after = before(t_s);
        let (a, b) = (self.points.get(after.checked_sub(1)?)?, self.points.get(after)?);
        let near = &self.points[before(t_s - NEAR_S)..before(t_s + NEAR_S)];
        if near.len() < MIN_NEAR {
            let speed = (b.1 - a.1) / (b.0 - a.0);
            return Some((a.1 + speed * (t_s - a.0), speed));
        }
        // Answers are stamped some milliseconds late, now more, now less: two of them 8 ms apart give a speed that is 15 % off.
        let n = near.len() as f64;
        let (mean_s, mean_mm) =
            (near.iter().map(|p| p.0 - t_s).sum::<f64>() / n, near.iter().map(|p| p.1).sum::<f64>() / n);
        let sum = |f: &dyn Fn(f64, f64) -> f64| {
            near.iter().map(|p| f(p.0 - t_s - mean_s, p.1 - mean_mm)).sum::<f64>()
        };
        let speed = sum(&|s, mm| s * mm) / sum(&|s, _| s * s);
        Some((mean_mm - speed * mean_s, speed))
    }

    /// Mean depth over a window, or the nearest reading before its end, mm.
    pub(crate) fn mean(&self, begin_s: f64, end_s: f64) -> Option<f64> {
        let (from, to) =
            (self.points.partition_point(|p| p.0 < begin_s), self.points.partition_point(|p| p.0 <= end_s));
        if from < to {
            let inside = &self.points[from..to];
            return Some(inside.iter().map(|p| p.1).sum::<f64>() / inside.len() as f64);
        }
        self.points.get(to.saturating_sub(1)).map(|p| p.1)
    }
}

#[cfg(test)]
mod tests {
    use super::Track;

    #[test]
    fn stamps_that_come_now_earlier_now_later_leave_speed_and_place() {
        // 2 mm/s, an answer every 8 ms, stamped by up to 0.75 ms off.
        let late_s = |k: u32| 1.5e-3 * (f64::from(k * 37 % 101) / 100.0 - 0.5);
        let points = |every_s: f64| Track {
            points: (0..200)
                .map(|k| (every_s * f64::from(k) + late_s(k), 2.0 * every_s * f64::from(k)))
                .collect(),
            moving: vec![true; 200],
        };
        let worst = |track: &Track| {
            let all = (10..130).map(|k| 0.01 * f64::from(k)).filter_map(|t| Some((t, track.at(t)?)));
            let off = all.map(|(t, (mm, speed))| [(mm - 2.0 * t).abs(), (speed / 2.0 - 1.0).abs()]);
            off.fold([0.0_f64; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])])
        };
        let [mm, speed] = worst(&points(0.008));
        assert!(mm < 1e-3 && speed < 0.03, "{mm} {speed}");
        // Control: of answers that are far apart two have to do, and their stamps are all in the place.
        let [mm, _] = worst(&points(0.04));
        assert!(mm > 1e-3, "{mm}");
    }
    #[test]
    fn a_window_in_which_the_stage_moved_or_stood_elsewhere_is_seen() {
        let track = |at_mm: &dyn Fn(f64) -> (f64, bool)| {
            let times = (0..100).map(|k| 0.02 * f64::from(k));
            let (points, moving) = times.map(|t| ((t, at_mm(t).0), at_mm(t).1)).unzip();
            Track { points, moving }
        };
        let standing = track(&|_| (3.001, false));
        assert!(!standing.has_left(3.0, 0.5, 1.5), "control: within what an arrival may be off");
        assert!(standing.has_left(2.9, 0.5, 1.5), "it stands elsewhere");
        let moved = track(&|t| if t < 1.0 { (3.0, false) } else { (3.2, false) });
        assert!(moved.has_left(3.0, 0.5, 1.5) && !moved.has_left(3.0, 0.0, 0.9));
        // It goes on to the next pose while the window's last scans come in.
        let next = track(&|t| if t < 1.48 { (3.0, false) } else { (3.1, true) });
        assert!(!next.has_left(3.0, 0.5, 1.5));
    }
}
