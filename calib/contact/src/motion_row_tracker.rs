//! The rows of one whisker of a stream along a known motion: moments and motion in, contacts out; no network.
//!
//! ```text
//! moments -> zero (Tare) -> episodes and recursive posterior (ContactStream) -> known groove, contact intervals and cloud -> TrackedRow
//! ```
//!
//! Noise: a row's own is that of the no-contact prefix through the filter; the calibration's noise from pose to pose is a draw that rows of
//! one pose share, forgotten over half a millimetre; the zero may be off by half of that, another two unknowns of all rows. Assumptions, as
//! for tables.

use crate::ContactError;
use crate::arc::{arclength_regions, moments_alone};
use crate::contact_history::ContactHistory;
use crate::known_groove::KnownGroove;
use crate::known_motion::contact_stream::FinishedEpisode;
use crate::known_motion::{
    ContactStream, Lost, MomentField, MotionRow, Place, PoseNoise, RecursiveSettings, Settings,
};
use crate::row_tracker::TrackedRow;
use nalgebra::{Matrix2, Rotation3, Vector3};
use std::collections::BTreeMap;
use std::sync::Arc;
use wcal_core::observation::WhiskerSpec;
use wcal_core::stream::{Flags, MomentSpread, StreamMoments};
use wcal_track::Tare;
use wcal_track::inverse::{InverseGrid, StaticInverse};
use wcal_track::network::Prediction;
use wcal_track::stream::BasePose;

/// Displacement over which a draw of the noise from pose to pose is forgotten, mm. An assumption.
const POSE_MM: f64 = 0.5;
/// Share of the noise from pose to pose by which the zero may be off. An assumption, as for tables.
const ZERO: f64 = 0.5;
/// Share of the noise from pose to pose that a row has for itself where no prefix was measured. An assumption, as for the filters.
const WHITE: f64 = 0.2;
/// A contact goes on over rows without moments or motion for so long, s: the displacement is known again after them.
const MAX_LOST_S: f64 = 1.0;
/// A wire that is loaded by so many standard deviations touches something.
const LOADED_SDS: f64 = 4.0;

/// Motion of the object with respect to the base at a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowMotion {
    /// Displacement, base frame, mm, up to a constant in the piece: a point is at `turn p + moved`.
    pub moved_mm: Vector3<f64>,
    /// Rotation.
    pub turn: Rotation3<f64>,
    /// Velocity, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Counts up where the motion before says nothing about the one after.
    pub piece: u32,
    /// Direction of the push, where it is known.
    pub push: Option<Vector3<f64>>,
}

/// What is known at a time.
#[derive(Debug, Clone)]
pub struct MotionInput {
    /// Time of validity, s.
    pub t_s: f64,
    /// Moments of the calibration; none where the reading cannot be used.
    pub moments: Option<StreamMoments>,
    /// What their spread is made of.
    pub spread: MomentSpread,
    /// Covariance of the row's own noise, where it was measured, (N mm)^2.
    pub noise_nmm2: Option<Matrix2<f64>>,
    /// In the prefix that must be free of contact, before the noise is known.
    pub in_prefix: bool,
    /// Motion, or why it is not known.
    pub motion: Result<RowMotion, Lost>,
    /// Pose of the base.
    pub base: Option<BasePose>,
    /// Speed of the base along +z, mm/s.
    pub base_mm_s: Option<f64>,
}

/// What is assumed of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionAccuracy {
    /// Standard deviation of the displacement in each coordinate, mm.
    pub moved_sd_mm: f64,
    /// Standard deviation of the clock's offset, s.
    pub clock_sd_s: f64,
}

/// The tracker of one whisker.
pub struct MotionRowTracker {
    field: Arc<MomentField>,
    whisker: WhiskerSpec,
    accuracy: MotionAccuracy,
    /// From the first moments on: they say what their noise is.
    stream: Option<ContactStream>,
    /// Made where the motion of a loaded row is not known.
    inverse: Option<StaticInverse>,
    tare: Tare,
    /// Contact intervals and cloud.
    pub history: ContactHistory,
    /// The groove that the answers are compared with, where it is known.
    pub groove: Option<KnownGroove>,
    /// Rows whose motion is not known, by why.
    lost: BTreeMap<&'static str, u64>,
    disagreeing: u64,
    /// The last row with moments and motion, s.
    last_s: Option<f64>,
}

impl MotionRowTracker {
    /// Of a whisker whose wire has the moments of `field`; `tare_s`: time at the beginning whose mean moments are the zero.
    #[must_use]
    pub fn new(
        name: &str,
        field: Arc<MomentField>,
        whisker: &WhiskerSpec,
        accuracy: MotionAccuracy,
        tare_s: f64,
    ) -> Self {
        Self {
            field,
            whisker: whisker.clone(),
            accuracy,
            stream: None,
            inverse: None,
            tare: Tare::new(tare_s),
            history: ContactHistory::new(name),
            groove: None,
            lost: BTreeMap::new(),
            disagreeing: 0,
            last_s: None,
        }
    }

    /// Takes the next row in order of time.
    ///
    /// # Errors
    /// For a row that cannot be used, and where the wire cannot be bent.
    pub fn push(&mut self, row: &MotionInput) -> Result<TrackedRow, ContactError> {
        let MotionInput { t_s, base, base_mm_s, .. } = *row;
        let moments =
            row.moments.map(|m| StreamMoments { moment_nmm: self.tare.zeroed(t_s, m.moment_nmm), ..m });
        let nothing = TrackedRow {
            moments,
            answer: None,
            flags: Flags::default(),
            regions: Vec::new(),
            segment: None,
            several: None,
        };
        let tracked = match (moments, &row.motion) {
            (None, _) => nothing,
            (Some(_), Err(_)) if row.in_prefix => nothing,
            (Some(m), Err(why)) => self.by_moments_alone(&m, row.noise_nmm2, *why, nothing)?,
            (Some(m), Ok(motion)) => self.along(row, &m, motion, nothing)?,
        };
        if let (Some(groove), Some(answer)) = (&mut self.groove, &tracked.answer) {
            groove.push(t_s, answer);
        }
        let segment = self.history.row(t_s, tracked.answer.as_ref(), base, base_mm_s);
        Ok(TrackedRow { segment, ..tracked })
    }

    /// The motion is known.
    fn along(
        &mut self,
        row: &MotionInput,
        m: &StreamMoments,
        motion: &RowMotion,
        nothing: TrackedRow,
    ) -> Result<TrackedRow, ContactError> {
        let pose_nmm2 = row.spread.noise_nmm2;
        let stream = self.stream.get_or_insert_with(|| {
            let common = Settings { clock_sd_s: self.accuracy.clock_sd_s, ..Settings::default() };
            let pose = Some(PoseNoise { covariance_nmm2: pose_nmm2, length_mm: POSE_MM });
            ContactStream::new(Arc::clone(&self.field), RecursiveSettings { common, pose })
        });
        if self.last_s.replace(row.t_s).is_some_and(|last| row.t_s - last > MAX_LOST_S) {
            stream.interrupt();
        }
        let zero = pose_nmm2.cholesky().map_or_else(Matrix2::zeros, |c| c.l() * ZERO);
        let mut shared_nmm = row.spread.shared_nmm.clone();
        shared_nmm.extend(zero.column_iter().map(|c| [c[0], c[1]]));
        let reading = MotionRow {
            t_s: row.t_s,
            moment_nmm: m.moment_nmm,
            noise_nmm2: row.noise_nmm2.unwrap_or(pose_nmm2 * WHITE * WHITE),
            shared_nmm,
            shared_way_mm: Vec::new(),
            moved_mm: motion.moved_mm,
            turn: motion.turn,
            velocity_mm_s: motion.velocity_mm_s,
            moved_sd_mm: self.accuracy.moved_sd_mm,
            free: row.in_prefix,
            visit: 0,
        };
        let found = stream.push(&reading, motion.piece, motion.push)?;
        let flags = if found.disagrees { Flags::MOTION_DISAGREES } else { Flags::default() };
        self.disagreeing += u64::from(found.disagrees);
        let answer = found.place.as_ref().and_then(answer);
        Ok(TrackedRow { answer, flags, regions: found.regions, ..nothing })
    }

    /// The motion is not known: a loaded wire has the arc that its moments allow.
    fn by_moments_alone(
        &mut self,
        m: &StreamMoments,
        noise_nmm2: Option<Matrix2<f64>>,
        why: Lost,
        nothing: TrackedRow,
    ) -> Result<TrackedRow, ContactError> {
        // The row's own noise may be larger than that from pose to pose, which is one of averages.
        let own = noise_nmm2.map_or(0.0, |n| n.trace());
        let sd_nmm = (m.sd_nmm[0].powi(2) + m.sd_nmm[1].powi(2) + own).sqrt();
        if m.moment_nmm[0].hypot(m.moment_nmm[1]) <= LOADED_SDS * sd_nmm {
            return Ok(nothing);
        }
        *self.lost.entry(why.name()).or_default() += 1;
        let inverse = match self.inverse.take() {
            Some(inverse) => inverse,
            None => StaticInverse::new(&self.whisker, InverseGrid::coarse())?,
        };
        let unknown = Prediction { contact: 1.0, ..no_answer() };
        let answer = moments_alone(&inverse, m.moment_nmm, m.sd_nmm, &unknown);
        let regions = arclength_regions(&inverse.nodes, &answer.weights);
        self.inverse = Some(inverse);
        Ok(TrackedRow { answer: Some(answer), flags: Flags::MOTION_LOST, regions, ..nothing })
    }

    /// Loaded rows whose motion is not known, by why.
    #[must_use]
    pub fn lost(&self) -> &BTreeMap<&'static str, u64> {
        &self.lost
    }

    /// Rows at which moments and motion do not belong together.
    #[must_use]
    pub fn disagreeing(&self) -> u64 {
        self.disagreeing
    }

    /// Ends the contact at hand.
    pub fn finish(&mut self) -> Vec<FinishedEpisode> {
        self.stream.as_mut().map_or_else(Vec::new, |s| s.finish().to_vec())
    }
}

fn no_answer() -> Prediction {
    Prediction {
        contact: 0.0,
        several: 0.0,
        point_mm: [0.0; 3],
        covariance_mm2: [[0.0; 3]; 3],
        weights: Vec::new(),
        normal: [0.0; 3],
    }
}

/// A place as a row of the track has it; none where nothing was found.
#[must_use]
pub fn answer(place: &Place) -> Option<Prediction> {
    let at = place.place_mm?;
    let c = place.covariance_mm2;
    Some(Prediction {
        contact: place.contact as f32,
        point_mm: [0, 1, 2].map(|k| at[k] as f32),
        covariance_mm2: [0, 1, 2].map(|i| [0, 1, 2].map(|j| c[(i, j)] as f32)),
        ..no_answer()
    })
}
