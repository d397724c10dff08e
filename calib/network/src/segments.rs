//! Contact intervals: from touch to release, split where the contact jumps.
//!
//! ```text
//! begin   P(contact) >= 0.6,   end   P(contact) < 0.4                          hysteresis: noise near one limit splits nothing
//! jump    |p_t - p_{t-1} + z e_z| > |z| + 3 mm  and  > 3 sqrt(tr C_t + tr C_{t-1})
//! ```
//!
//! p, C: contact with covariance in the base frame; z: travel of the base along its +z since the
//! row before. On one rigid body at rest a contact slides about as far as the base travels.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::Serialize;

/// Probability at which a segment begins, and below which it ends.
const START_PROBABILITY: f64 = 0.6;
const END_PROBABILITY: f64 = 0.4;
/// A contact that moved this much farther than the base's travel, mm, and by this many standard
/// deviations of both ends, is another one.
const JUMP_MM: f64 = 3.0;
const JUMP_SDS: f64 = 3.0;

/// Why a segment begins or ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SegmentBoundary {
    /// The recording begins or ends.
    Recording,
    /// From free to contact, or from contact to free.
    Touch,
    /// The contact jumps.
    Jump,
    /// Readings are missing.
    Gap,
}

/// An interval with one contact that moves without a break.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Segment {
    /// Number, from 1, a whisker.
    pub number: u64,
    /// Whisker; empty where there is one.
    pub whisker: String,
    /// First and last row, s.
    pub from_s: f64,
    /// See `from_s`.
    pub to_s: f64,
    /// How it begins and ends.
    pub begins: SegmentBoundary,
    /// See `begins`.
    pub ends: SegmentBoundary,
    /// Rows.
    pub rows: u64,
    /// First and last contact, base frame, mm.
    pub first_mm: [f64; 3],
    /// See `first_mm`.
    pub last_mm: [f64; 3],
}

/// Finds the segments of one whisker, row by row.
#[derive(Debug, Clone, Default)]
pub struct SegmentFinder {
    whisker: String,
    open: Option<(Segment, Vector3<f64>, Matrix3<f64>)>,
    done: Vec<Segment>,
    /// What a segment that begins now begins with; none before the first row.
    next: Option<SegmentBoundary>,
}

impl SegmentFinder {
    /// Of a whisker.
    pub fn new(whisker: &str) -> Self {
        Self {
            whisker: whisker.to_owned(),
            ..Self::default()
        }
    }

    /// Takes a row: time (s), probability of contact, contact (base frame, mm) with covariance, and
    /// the base's travel along its +z since the row before, mm. Returns the number of the row's
    /// segment.
    pub fn push(
        &mut self,
        t_s: f64,
        probability: f64,
        point_mm: Vector3<f64>,
        covariance_mm2: Matrix3<f64>,
        base_way_mm: f64,
    ) -> Option<u64> {
        if let Some((segment, last, spread)) = &self.open {
            if probability < END_PROBABILITY {
                self.close(SegmentBoundary::Touch);
                return None;
            }
            // In the base frame the object moves by -z: the path on the object is the difference
            // plus z e_z.
            let moved = (point_mm - last + Vector3::z() * base_way_mm).norm();
            // Independent errors of both places add.
            let sd = (covariance_mm2.trace() + spread.trace()).sqrt();
            if moved > base_way_mm.abs() + JUMP_MM && moved > JUMP_SDS * sd {
                self.close(SegmentBoundary::Jump);
            } else {
                let mut segment = segment.clone();
                (segment.to_s, segment.last_mm) = (t_s, point_mm.into());
                segment.rows += 1;
                let number = segment.number;
                self.open = Some((segment, point_mm, covariance_mm2));
                return Some(number);
            }
        }
        let begins = self
            .next
            .replace(SegmentBoundary::Touch)
            .unwrap_or(SegmentBoundary::Recording);
        // After a jump the wire is still held: the limit of an open segment counts.
        if probability < START_PROBABILITY && begins != SegmentBoundary::Jump {
            return None;
        }
        let number = self.done.len() as u64 + 1;
        let segment = Segment {
            number,
            whisker: self.whisker.clone(),
            from_s: t_s,
            to_s: t_s,
            begins,
            ends: SegmentBoundary::Recording,
            rows: 1,
            first_mm: point_mm.into(),
            last_mm: point_mm.into(),
        };
        self.open = Some((segment, point_mm, covariance_mm2));
        Some(number)
    }

    /// Readings are missing here.
    pub fn gap(&mut self) {
        self.close(SegmentBoundary::Gap);
        self.next = Some(SegmentBoundary::Gap);
    }

    fn close(&mut self, ends: SegmentBoundary) {
        if let Some((segment, ..)) = self.open.take() {
            self.done.push(Segment { ends, ..segment });
        }
        self.next = Some(ends);
    }

    /// All segments; an open one ends with the recording.
    pub fn all(&self) -> Vec<Segment> {
        self.done
            .iter()
            .cloned()
            .chain(self.open.iter().map(|o| o.0.clone()))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(points: &[(f64, f64)], sd_mm: f64) -> Vec<Segment> {
        let mut segments = SegmentFinder::new("a");
        for (k, (probability, x)) in points.iter().enumerate() {
            let covariance = Matrix3::identity() * sd_mm * sd_mm;
            let point = Vector3::new(*x, 0.0, -0.4 * k as f64);
            segments.push(0.1 * k as f64, *probability, point, covariance, 0.4);
        }
        segments.all()
    }

    #[test]
    fn a_touch_a_jump_and_a_release_make_two_segments() {
        let series = [
            (0.0, 30.0),
            (0.9, 30.0),
            (0.5, 30.1),
            (0.9, 30.2),
            (0.9, 40.0),
            (0.9, 40.1),
            (0.1, 40.2),
            (0.5, 40.0),
        ];
        let found = run(&series, 0.2);
        let edges: Vec<_> = found
            .iter()
            .map(|s| (s.begins, s.ends, s.rows, s.number))
            .collect();
        assert_eq!(
            edges,
            [
                (SegmentBoundary::Touch, SegmentBoundary::Jump, 3, 1),
                (SegmentBoundary::Jump, SegmentBoundary::Touch, 2, 2)
            ],
            "{found:?}"
        );
        assert!((found[0].from_s - 0.1).abs() < 1e-9 && (found[1].to_s - 0.5).abs() < 1e-9);
        // Negative control: with answers that are only good to 5 mm the step says nothing.
        assert_eq!(run(&series, 5.0).len(), 1);
    }

    #[test]
    fn a_gap_breaks_a_segment_and_an_open_one_ends_with_the_recording() {
        let mut segments = SegmentFinder::new("");
        let push = |s: &mut SegmentFinder, t: f64| {
            s.push(t, 0.9, Vector3::x(), Matrix3::identity() * 0.01, 0.0)
        };
        assert_eq!(push(&mut segments, 0.0), Some(1));
        segments.gap();
        assert_eq!(push(&mut segments, 1.0), Some(2));
        let all = segments.all();
        assert_eq!(
            (all[0].begins, all[0].ends),
            (SegmentBoundary::Recording, SegmentBoundary::Gap)
        );
        assert_eq!(
            (all[1].begins, all[1].ends),
            (SegmentBoundary::Gap, SegmentBoundary::Recording)
        );
    }
}
