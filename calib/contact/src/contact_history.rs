//! Results over all rows of a whisker: contact intervals, and the contacts on the object.

use crate::estimator::ContactEstimate;
use nalgebra::{Isometry3, Translation3, Vector3};
use wcal_track::segments::{Segment, SegmentFinder};
use wcal_track::stream::BasePose;

/// Results over the rows of one whisker.
#[derive(Debug, Default)]
pub struct ContactHistory {
    segments: SegmentFinder,
    contacts_mm: Vec<Vector3<f64>>,
    last_s: Option<f64>,
    /// Travel of the base along its +z since the first row by its speed, mm.
    way_mm: f64,
}

impl ContactHistory {
    /// For a whisker.
    pub fn new(whisker: &str) -> Self {
        Self { segments: SegmentFinder::new(whisker), ..Self::default() }
    }

    /// Takes a row and returns the number of its segment; `on_object`: its place is a point of the object.
    pub fn row(
        &mut self,
        t_s: f64,
        estimate: Option<&ContactEstimate>,
        on_object: bool,
        base: Option<BasePose>,
        base_mm_s: Option<f64>,
    ) -> Option<u64> {
        let step_s = self.last_s.replace(t_s).map_or(0.0, |last| t_s - last);
        let step_mm = base_mm_s.unwrap_or(0.0) * step_s;
        self.way_mm += step_mm;
        let Some(p) = estimate else {
            self.segments.gap();
            return None;
        };
        let (point_mm, covariance) = (p.place_mm, p.covariance_mm2);
        let known_way = base.map(|b| b.world_from_base).or_else(|| {
            base_mm_s.map(|_| {
                Isometry3::from_parts(
                    Translation3::new(0.0, 0.0, self.way_mm),
                    nalgebra::UnitQuaternion::identity(),
                )
            })
        });
        if let (Some(world_from_base), true) = (known_way, on_object) {
            self.contacts_mm.push(world_from_base.transform_point(&point_mm.into()).coords);
        }
        self.segments.push(t_s, p.probability, point_mm, covariance, step_mm)
    }

    /// Probable contacts where the motion of the base is known, in the frame in which it moves, mm.
    pub fn contacts_mm(&self) -> &[Vector3<f64>] {
        &self.contacts_mm
    }

    /// Readings are missing before the next row.
    pub fn gap(&mut self) {
        self.segments.gap();
    }

    /// Contact intervals for track.json.
    pub fn segments(&self) -> Vec<Segment> {
        self.segments.all()
    }
}
