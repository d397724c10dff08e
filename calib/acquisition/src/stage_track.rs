//! Where the stage was, in the interrogator's time, from its answers.

use crate::clocks::ClockFit;
use crate::message::StagePosition;
use crate::plan::ARRIVAL_MM;
use std::ops::Range;

/// Answers of the stage this near to a time tell its place and speed then, s; and how many do.
const NEAR_S: f64 = 0.025;
const MIN_NEAR: usize = 4;
/// The next move may begin at the end of a window, and answers are stamped some milliseconds off:
/// its last part shows nothing, s.
const NEXT_MOVE_S: f64 = 0.05;

/// Stage depth (mm) in device time.
pub(crate) struct Track {
    points: Vec<(f64, f64)>,
    /// Whether each answer said that the stage moves.
    moving: Vec<bool>,
}

impl Track {
    pub(crate) fn new(stage: &[StagePosition], fit: &ClockFit, zero_mm: f64) -> Self {
        // A file has its messages in any order.
        let mut stage: Vec<&StagePosition> = stage.iter().collect();
        stage.sort_by(|a, b| a.host_s.total_cmp(&b.host_s));
        // A stage has no clock of its own: its answers are stamped by the host.
        let points = stage
            .iter()
            .map(|r| (fit.device_s(r.host_s), r.measured_mm - zero_mm))
            .collect();
        Self {
            points,
            moving: stage.iter().map(|r| r.moving).collect(),
        }
    }

    /// The answers that tell where the stage was in a settled window: those inside, or where it did
    /// not answer the two around it.
    fn answers(&self, begin_s: f64, end_s: f64) -> Option<Range<usize>> {
        let end_s = end_s - NEXT_MOVE_S.min((end_s - begin_s) / 4.0);
        let from = self.points.partition_point(|p| p.0 < begin_s);
        // A damaged window may end before it begins.
        let to = self.points.partition_point(|p| p.0 <= end_s).max(from);
        let answers = if from < to {
            from..to
        } else {
            from.checked_sub(1)?..to + 1
        };
        (answers.end <= self.points.len()).then_some(answers)
    }

    /// Whether the stage moved in a settled window, or stood elsewhere than at `target_mm`, mm from
    /// its zero.
    pub(crate) fn has_left(&self, target_mm: f64, begin_s: f64, end_s: f64) -> bool {
        let Some(answers) = self.answers(begin_s, end_s) else {
            return true;
        };
        let mut depths_mm = self.points[answers.clone()].iter().map(|p| p.1);
        self.moving[answers].contains(&true)
            || depths_mm.any(|mm| (mm - target_mm).abs() > ARRIVAL_MM)
    }

    /// Depth (mm) and speed (mm/s): the line through the answers around it, or between its
    /// neighbours where there are few; `None` outside the recording.
    pub(crate) fn at(&self, t_s: f64) -> Option<(f64, f64)> {
        let before = |limit_s: f64| self.points.partition_point(|p| p.0 <= limit_s);
        let after = before(t_s);
        let (a, b) = (
            self.points.get(after.checked_sub(1)?)?,
            self.points.get(after)?,
        );
        let near = &self.points[before(t_s - NEAR_S)..before(t_s + NEAR_S)];
        if near.len() < MIN_NEAR {
            let speed = (b.1 - a.1) / (b.0 - a.0);
            return Some((a.1 + speed * (t_s - a.0), speed));
        }
        // Answers are stamped some milliseconds late, now more, now less: two of them 8 ms apart
        // give a speed that is 15 % off.
        let n = near.len() as f64;
        let (mean_s, mean_mm) = (
            near.iter().map(|p| p.0 - t_s).sum::<f64>() / n,
            near.iter().map(|p| p.1).sum::<f64>() / n,
        );
        let sum = |f: &dyn Fn(f64, f64) -> f64| {
            near.iter()
                .map(|p| f(p.0 - t_s - mean_s, p.1 - mean_mm))
                .sum::<f64>()
        };
        // Least squares about the mean: slope sum(s mm) / sum(s^2).
        let speed = sum(&|s, mm| s * mm) / sum(&|s, _| s * s);
        Some((mean_mm - speed * mean_s, speed))
    }

    /// Mean depth in a settled window, mm.
    pub(crate) fn mean(&self, begin_s: f64, end_s: f64) -> Option<f64> {
        let answers = &self.points[self.answers(begin_s, end_s)?];
        Some(answers.iter().map(|p| p.1).sum::<f64>() / answers.len() as f64)
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
                .map(|k| {
                    (
                        every_s * f64::from(k) + late_s(k),
                        2.0 * every_s * f64::from(k),
                    )
                })
                .collect(),
            moving: vec![true; 200],
        };
        let worst = |track: &Track| {
            let all = (10..130)
                .map(|k| 0.01 * f64::from(k))
                .filter_map(|t| Some((t, track.at(t)?)));
            let off = all.map(|(t, (mm, speed))| [(mm - 2.0 * t).abs(), (speed / 2.0 - 1.0).abs()]);
            off.fold([0.0_f64; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])])
        };
        let [mm, speed] = worst(&points(0.008));
        assert!(mm < 1e-3 && speed < 0.03, "{mm} {speed}");
        // Control: of answers that are far apart two have to do, and their stamps are all in the
        // place.
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
        assert!(
            !standing.has_left(3.0, 0.5, 1.5),
            "control: within what an arrival may be off"
        );
        assert!(standing.has_left(2.9, 0.5, 1.5), "it stands elsewhere");
        let moved = track(&|t| if t < 1.0 { (3.0, false) } else { (3.2, false) });
        assert!(moved.has_left(3.0, 0.5, 1.5) && !moved.has_left(3.0, 0.0, 0.9));
        // It goes on to the next pose while the window's last scans come in.
        let next = track(&|t| if t < 1.48 { (3.0, false) } else { (3.1, true) });
        assert!(!next.has_left(3.0, 0.5, 1.5));
    }

    /// A busy computer does not get to ask the stage: what it last said is of the pose before.
    #[test]
    fn a_window_without_an_answer_is_judged_by_the_answers_around_it() {
        // A second at each of 1, 2, 3 ... mm, an answer every 20 ms but for some time; the last
        // tenth of a second is the next move.
        let track = |silent: std::ops::Range<f64>| {
            let times = (0..500)
                .map(|k| 0.02 * f64::from(k))
                .filter(|t| !silent.contains(t));
            let at = |t: f64| {
                (
                    1.0 + t.floor() + 10.0 * (t.fract() - 0.9).max(0.0),
                    t.fract() > 0.9,
                )
            };
            let (points, moving) = times.map(|t| ((t, at(t).0), at(t).1)).unzip();
            Track { points, moving }
        };
        // Window of the pose at 4 mm.
        let judged = |silent| {
            let track = track(silent);
            (track.has_left(4.0, 3.3, 3.8), track.mean(3.3, 3.8))
        };
        let near = |mm: Option<f64>| mm.is_some_and(|mm| (mm - 4.0).abs() < 1e-9);
        for (name, silent) in [
            ("before and in it", 2.7..3.85),
            ("in it and the next move", 3.2..3.95),
            ("to the end", 3.2..11.0),
        ] {
            assert!(judged(silent).0, "{name}");
        }
        let (left, mm) = judged(3.2..3.85);
        assert!(
            !left && near(mm),
            "negative control: it stands there before and after: {mm:?}"
        );
        let (left, mm) = judged(9.0..9.0);
        assert!(!left && near(mm), "negative control: it always answers");
    }
}
