//! Status of an answer of the network. It was trained on one motion, and two moments cannot exclude another one: presses and sweeps give
//! the same moments (tests/track/untrained.rs). So a contact has one of three statuses:
//!
//! | motion | status | point | regions |
//! |---|---|---|---|
//! | known or vouched for, and one of training | `ok` | network's | network's |
//! | not known, no evidence against training | `motion-assumed` | network's | of the mixture of both others (`arc::any_motion`) |
//! | known or noticed to be another | `untrained-motion` | mean over the arc | what the moments alone allow (`arc::static_arc`) |

use crate::arc::{any_motion, arclength_regions, static_arc};
use crate::estimator::Message;
use crate::known_motion::Region;
use crate::track_document::UntrainedRows;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use wcal_core::stream::{Flags, StreamMoments};
use wcal_track::inverse::StaticInverse;
use wcal_track::network::Prediction;
use wcal_track::train::TrainSettings;
use wcal_track::untrained_motion::{MotionCheck, MotionSample};

/// A row of the network before it is judged.
#[derive(Debug, Clone)]
pub struct UnjudgedRow {
    /// Time, s.
    pub t_s: f64,
    /// Moments with their standard deviations.
    pub moments: StreamMoments,
    /// The network's answer.
    pub answer: Prediction,
    /// Logarithm of the filters' predictive density of the moments, 1/(N mm)^2 (`TrackerStream::log_evidence`).
    pub log_evidence: Option<f64>,
    /// Velocity of the base past what it touches, base frame, mm/s, where it is known.
    pub velocity_mm_s: Option<Vector3<f64>>,
}

/// What is stated of a row.
#[derive(Debug, Clone)]
pub struct JudgedRow {
    /// `UNTRAINED_MOTION`, `MOTION_ASSUMED` or none.
    pub flags: Flags,
    /// The answer that stands.
    pub answer: Prediction,
    /// 95 % regions along the wire.
    pub regions: Vec<Region>,
}

/// Judges the rows of one whisker, and counts.
#[derive(Debug, Clone)]
pub struct MotionJudge {
    check: MotionCheck,
    /// Whether the user vouches for a motion as in training where it is not known.
    vouched: bool,
    untrained: BTreeMap<&'static str, u64>,
    assumed: u64,
}

impl MotionJudge {
    /// For a network that was trained so; `vouched`: a motion that is not known is as in training.
    #[must_use]
    pub fn new(training: &TrainSettings, vouched: bool) -> Self {
        Self { check: MotionCheck::new(training), vouched, untrained: BTreeMap::new(), assumed: 0 }
    }

    /// The tracker starts anew.
    pub fn restart(&mut self) {
        self.check.restart();
    }

    /// Judges the next row.
    pub fn judge(&mut self, row: UnjudgedRow, inverse: &StaticInverse) -> JudgedRow {
        let UnjudgedRow { t_s, moments, answer, log_evidence, velocity_mm_s } = row;
        let StreamMoments { moment_nmm, sd_nmm, .. } = moments;
        let contact = f64::from(answer.contact);
        let sample = MotionSample { t_s, moment_nmm, sd_nmm, contact, velocity_mm_s, log_evidence };
        let untrained = self.check.push(&sample);
        let nodes = &inverse.nodes;
        if let Some(motion) = untrained {
            *self.untrained.entry(motion.name()).or_default() += 1;
            let answer = static_arc(inverse, moment_nmm, sd_nmm, &answer);
            let regions = arclength_regions(nodes, &answer.weights);
            return JudgedRow { flags: Flags::UNTRAINED_MOTION, answer, regions };
        }
        if self.check.touching() && velocity_mm_s.is_none() && !self.vouched {
            self.assumed += 1;
            let answer = any_motion(inverse, moment_nmm, sd_nmm, answer);
            let regions = arclength_regions(nodes, &answer.weights);
            return JudgedRow { flags: Flags::MOTION_ASSUMED, answer, regions };
        }
        let regions = arclength_regions(nodes, &answer.weights);
        JudgedRow { flags: Flags::default(), answer, regions }
    }

    /// For track.json: rows by what their motion is.
    #[must_use]
    pub fn document(&self) -> UntrainedRows {
        let rows = self.untrained.values().sum();
        UntrainedRows { rows, by_motion: self.untrained.clone(), assumed_rows: self.assumed }
    }

    /// The same for people; `rows`: all of them.
    #[must_use]
    pub fn messages(&self, rows: u64) -> Vec<Message> {
        let mut all = Vec::new();
        if !self.untrained.is_empty() {
            let by: Vec<String> = self.untrained.iter().map(|(name, n)| format!("{name} {n}")).collect();
            all.push(Message::warning(format!(
                "{} of {rows} rows are contact in a motion that the model was never trained on ({}): their places are what the \
                 moments alone tell, an arc of the wire; marked untrained-motion in status",
                self.untrained.values().sum::<u64>(),
                by.join(", ")
            )));
        }
        if self.assumed > 0 {
            all.push(Message::warning(format!(
                "{} of {rows} rows are contact in a motion that is not known: their places assume one as in training (the base along \
                 its +z past an object at rest), their regions hold for any; marked motion-assumed in status (--sweep vouches for the motion)",
                self.assumed
            )));
        }
        all
    }

    /// Whether a row is not what the network was trained for, or not known to be.
    #[must_use]
    pub fn any(&self) -> bool {
        self.assumed > 0 || !self.untrained.is_empty()
    }
}
