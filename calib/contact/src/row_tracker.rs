//! The rows of one whisker, of a table or of a stream alike: moments in, judged contacts out.
//!
//! ```text
//! moments -> zero (Tare) -> filters and network (TrackerStream) -> what the motion allows (MotionJudge)
//!         -> a known groove, contact intervals and cloud (KnownGroove, ContactHistory) -> TrackedRow
//! ```

use crate::contact_history::ContactHistory;
use crate::known_groove::KnownGroove;
use crate::known_motion::Region;
use crate::motion_judge::{JudgedRow, MotionJudge, UnjudgedRow};
use nalgebra::Vector3;
use wcal_core::stream::{Flags, StreamMoments};
use wcal_track::Tare;
use wcal_track::filter::FilterBank;
use wcal_track::network::Prediction;
use wcal_track::stream::BasePose;
use wcal_track::tracker::{Sample, Tracker, TrackerStream};
use wcal_track::train::TrainSettings;

/// What is known at a time.
#[derive(Debug, Clone, Copy)]
pub struct RowInput {
    /// Time of validity, s.
    pub t_s: f64,
    /// Moments of the calibration; none where the reading cannot be used.
    pub moments: Option<StreamMoments>,
    /// Pose of the base.
    pub base: Option<BasePose>,
    /// Speed of the base along +z, mm/s.
    pub base_mm_s: Option<f64>,
    /// Velocity of the base past what it touches, base frame, mm/s.
    pub velocity_mm_s: Option<Vector3<f64>>,
}

/// What is made of it.
#[derive(Debug, Clone)]
pub struct TrackedRow {
    /// Moments from the zero on.
    pub moments: Option<StreamMoments>,
    /// The answer that stands; none without moments.
    pub answer: Option<Prediction>,
    /// What the motion leaves in doubt.
    pub flags: Flags,
    /// 95 % regions along the wire.
    pub regions: Vec<Region>,
    /// Probability of several contacts; none without contact, or in a motion of which the network knows nothing.
    pub several: Option<f64>,
    /// Contact interval that the row belongs to.
    pub segment: Option<u64>,
}

/// The tracker of one whisker.
#[derive(Debug)]
pub struct RowTracker<'a> {
    tracker: &'a Tracker,
    filters: FilterBank,
    stream: TrackerStream<'a>,
    tare: Tare,
    /// Judge of the motion, with its counts.
    pub motion: MotionJudge,
    /// Contact intervals and cloud.
    pub history: ContactHistory,
    /// The groove that the answers are compared with, where it is known.
    pub groove: Option<KnownGroove>,
    /// Rows with a probability of several contacts, and those at which several are more probable than one.
    pub several_rows: [u64; 2],
}

/// Probability from which on a contact, or a second one, is more probable than not.
const PROBABLE: f32 = 0.5;

impl<'a> RowTracker<'a> {
    /// Of a whisker's model with filters that know the noise of its moments; `vouched`: a motion that is not known is as in training;
    /// `tare_s`: time at the beginning whose mean moments are the zero.
    #[must_use]
    pub fn new(
        whisker: &str,
        (tracker, training): (&'a Tracker, &TrainSettings),
        filters: FilterBank,
        vouched: bool,
        tare_s: f64,
    ) -> Self {
        Self {
            tracker,
            filters,
            stream: tracker.stream_with(filters),
            tare: Tare::new(tare_s),
            motion: MotionJudge::new(training, vouched),
            history: ContactHistory::new(whisker),
            groove: None,
            several_rows: [0; 2],
        }
    }

    /// Forgets the past: filters, network and judge are reset.
    pub fn restart(&mut self) {
        self.stream = self.tracker.stream_with(self.filters);
        self.motion.restart();
    }

    /// Takes the next row in order of time.
    pub fn push(&mut self, row: &RowInput) -> TrackedRow {
        let RowInput { t_s, base, base_mm_s, velocity_mm_s, .. } = *row;
        let moments =
            row.moments.map(|m| StreamMoments { moment_nmm: self.tare.zeroed(t_s, m.moment_nmm), ..m });
        let judged = moments.map(|moments| {
            let answer = self.stream.push(&Sample { t_s, moment_nmm: moments.moment_nmm, base_mm_s });
            let log_evidence = self.stream.log_evidence();
            let unjudged = UnjudgedRow { t_s, moments, answer, log_evidence, velocity_mm_s };
            self.motion.judge(unjudged, &self.tracker.inverse)
        });
        if let (Some(groove), Some(judged)) = (&mut self.groove, &judged) {
            groove.push(t_s, &judged.answer);
        }
        let answer = judged.as_ref().map(|j| &j.answer);
        let segment = self.history.row(t_s, answer, base, base_mm_s);
        let several = judged.as_ref().and_then(several);
        self.several_rows[0] += u64::from(several.is_some());
        self.several_rows[1] += u64::from(several.is_some_and(|p| p > f64::from(PROBABLE)));
        let (answer, flags, regions) = match judged {
            Some(j) => (Some(j.answer), j.flags, j.regions),
            None => (None, Flags::default(), Vec::new()),
        };
        TrackedRow { moments, answer, flags, regions, segment, several }
    }
}

/// The network's probability of several contacts where it sees contact in a motion that it may know.
fn several(row: &JudgedRow) -> Option<f64> {
    let knows = row.answer.contact >= PROBABLE && !row.flags.has(Flags::UNTRAINED_MOTION);
    knows.then_some(f64::from(row.answer.several))
}
