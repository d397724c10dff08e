//! The status of rows whose motion the network was never trained on, and their count.

use nalgebra::Vector3;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use wcal_core::stream::{Flags, StreamMoments};
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

    /// Flag of a row; `velocity_mm_s` is that of the base past what it touches, where it is known.
    pub fn flag(
        &mut self,
        t_s: f64,
        m: &StreamMoments,
        answer: &Prediction,
        velocity_mm_s: Option<Vector3<f64>>,
    ) -> Flags {
        let contact = f64::from(answer.contact);
        let sample = MotionSample { t_s, moment_nmm: m.moment_nmm, sd_nmm: m.sd_nmm, contact, velocity_mm_s };
        let Some(motion) = self.check.push(&sample) else { return Flags::default() };
        *self.rows.entry(motion.name()).or_default() += 1;
        Flags::UNTRAINED_MOTION
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
                "warning: {whose}{} of {rows} rows are contact in a motion that the model was never trained on ({}): their places and stated \
                 regions are not to be trusted; marked untrained-motion in status",
                self.count(),
                by.join(", ")
            );
        }
    }
}
