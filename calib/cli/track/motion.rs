//! The status of rows whose motion the network was never trained on, and their count.

use nalgebra::Vector3;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use wcal_core::stream::{Flags, StreamMoments};
use wcal_track::StaticInverse;
use wcal_track::arc::moments_alone;
use wcal_track::network::Prediction;
use wcal_track::train::TrainSettings;
use wcal_track::untrained_motion::{MotionCheck, MotionSample};

/// The check of one whisker with its counts.
#[derive(Debug, Clone)]
pub struct Motions {
    check: MotionCheck,
    rows: BTreeMap<&'static str, u64>,
}

impl Motions {
    /// For a network that was trained so.
    pub fn new(training: &TrainSettings) -> Self {
        Self { check: MotionCheck::new(training), rows: BTreeMap::new() }
    }

    /// The tracker starts anew.
    pub fn restart(&mut self) {
        self.check.restart();
    }

    /// Judges a row: its flag, and its answer, which is what the moments alone tell where the network cannot know the motion. `velocity_mm_s`
    /// is that of the base past what it touches, where it is known; `log_evidence` how well the filters predicted the row.
    pub fn judge(
        &mut self,
        (t_s, m): (f64, &StreamMoments),
        answer: Prediction,
        log_evidence: Option<f64>,
        velocity_mm_s: Option<Vector3<f64>>,
        inverse: &StaticInverse,
    ) -> (Flags, Prediction) {
        let contact = f64::from(answer.contact);
        let (moment_nmm, sd_nmm) = (m.moment_nmm, m.sd_nmm);
        let sample = MotionSample { t_s, moment_nmm, sd_nmm, contact, velocity_mm_s, log_evidence };
        let Some(motion) = self.check.push(&sample) else { return (Flags::default(), answer) };
        *self.rows.entry(motion.name()).or_default() += 1;
        (Flags::UNTRAINED_MOTION, moments_alone(inverse, moment_nmm, sd_nmm, &answer))
    }

    /// Whether a row has the flag.
    pub fn any(&self) -> bool {
        !self.rows.is_empty()
    }

    /// For track.json: rows by what their motion is.
    pub fn summary(&self) -> Value {
        json!({"rows": self.count(), "by_motion": self.rows})
    }

    fn count(&self) -> u64 {
        self.rows.values().sum()
    }

    /// The same for people.
    pub fn say(&self, whose: &str, rows: u64) {
        if self.any() {
            let by: Vec<String> = self.rows.iter().map(|(name, n)| format!("{name} {n}")).collect();
            eprintln!(
                "warning: {whose}{} of {rows} rows are contact in a motion that the model was never trained on ({}): their places are what \
                 the moments alone tell, an arc of the wire; marked untrained-motion in status",
                self.count(),
                by.join(", ")
            );
        }
    }
}
