//! Whether a network can know the motion behind a reading. It was trained on one kind: the base goes along its +z past an object that
//! stands still, at a few mm/s. With w the velocity of the base past what it touches (base frame, mm/s), a motion is trained where
//!
//! `v_low <= w_z <= v_high` and `|w - w_z z| <= ASIDE w_z`.
//!
//! Where w is not known the moments reveal two motions that no sweep has. An object that the base passes pushes the free wire against the
//! travel, toward -z, which gives M_y > 0 at the root; a first touch toward +z (M_y < 0) comes from an object that overtakes the wire. (Later in
//! a sweep the tip, which hangs below the base, may be pulled in that direction.) Moments that are constant for long are those of a base that
//! does not move. Whatever the motion, the filters predict each row from those before (p(m_t | m_1 .. m_{t-1})): where the mean logarithm of
//! the last rows is lower than in any sweep, the motion is outside training.

use crate::train::TrainSettings;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::VecDeque;

/// Probability of contact from which a row is judged, and below which the contact is over (as for `segments`).
const START_PROBABILITY: f64 = 0.6;
const END_PROBABILITY: f64 = 0.4;
/// A wire loaded by this much, and by this many standard deviations, is in contact whatever the network states, N mm.
const LOADED_NMM: f64 = 0.02;
const LOADED_SDS: f64 = 5.0;
/// Smallest moment whose direction is significant, N mm.
const DIRECTED_NMM: f64 = 0.05;
/// Largest ratio of the velocity across the base's +z to that along it in the trained motion.
const ASIDE: f64 = 0.2;
/// Part of the moment that a first touch toward +z must have to be one, and time for which the wire must have been free before it, s.
const TOWARD: f64 = 0.3;
const FREE_S: f64 = 0.5;
/// Rows over which the filters' predictive densities are averaged, the least that one row counts, and the mean logarithm below which no
/// sweep's rows lie (tests/track/untrained.rs), 1/(N mm)^2.
const EVIDENCE_ROWS: usize = 8;
const EVIDENCE_FLOOR: f64 = -20.0;
const EVIDENCE_LOW: f64 = 0.0;
/// Moments that change by less than this (N mm, and relative) for this long (s) are constant.
const STILL_NMM: f64 = 0.01;
const STILL_SHARE: f64 = 0.01;
const STILL_S: f64 = 20.0;

/// A motion that no training sweep has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum UntrainedMotion {
    /// The base stands or creeps past what it touches.
    Hold,
    /// The object overtakes the wire, or the base moves backward.
    Against,
    /// The base moves across its +z.
    Aside,
    /// Faster than any sweep.
    Fast,
    /// The filters' predictions fail.
    Unforeseen,
}

impl UntrainedMotion {
    /// Name as in track.json.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Against => "against",
            Self::Aside => "aside",
            Self::Fast => "fast",
            Self::Unforeseen => "unforeseen",
        }
    }
}

/// A row as the check sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionSample {
    /// Time, s.
    pub t_s: f64,
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviations of the moments, N mm.
    pub sd_nmm: [f64; 2],
    /// Probability of contact that the network states.
    pub contact: f64,
    /// Velocity of the base past what it touches, base frame, mm/s, where it is known.
    pub velocity_mm_s: Option<Vector3<f64>>,
    /// Logarithm of the filters' predictive density of the moments, 1/(N mm)^2; none where they predicted nothing.
    pub log_evidence: Option<f64>,
}

/// Judges the rows of one whisker. An untrained motion puts a contact in doubt until its end: the state of network and filters depends
/// on the whole path.
#[derive(Debug, Clone)]
pub struct MotionCheck {
    /// Speeds of the base in training, mm/s.
    trained_mm_s: [f64; 2],
    touching: bool,
    found: Option<UntrainedMotion>,
    /// Since when the wire has been free of load, and whether its next load is a first touch that is not judged yet.
    free_since: Option<f64>,
    first_touch: bool,
    /// Start time and value of constant moments.
    still: Option<(f64, [f64; 2])>,
    /// Predictive densities of the last rows of the contact.
    evidence: VecDeque<f64>,
}

impl MotionCheck {
    /// For a network with these settings of training, whose sweeps' times were stretched by `time_factor`.
    #[must_use]
    pub fn new(training: &TrainSettings) -> Self {
        let ([low, high], [short, long]) = (training.filter.speed_mm_s, training.time_factor);
        Self {
            trained_mm_s: [low / long, high / short],
            touching: false,
            found: None,
            free_since: None,
            first_touch: false,
            still: None,
            evidence: VecDeque::new(),
        }
    }

    /// Whether the last row was contact.
    #[must_use]
    pub fn touching(&self) -> bool {
        self.touching
    }

    /// Forgets the contact so far.
    pub fn restart(&mut self) {
        (self.touching, self.found, self.still) = (false, None, None);
        (self.free_since, self.first_touch) = (None, false);
        self.evidence.clear();
    }

    /// Takes a row; what its motion is where no sweep has it.
    pub fn push(&mut self, row: &MotionSample) -> Option<UntrainedMotion> {
        let [y, z] = row.moment_nmm;
        let loaded = y.hypot(z) >= LOADED_NMM.max(LOADED_SDS * row.sd_nmm[0].hypot(row.sd_nmm[1]));
        self.touching =
            loaded || row.contact >= if self.touching { END_PROBABILITY } else { START_PROBABILITY };
        if !loaded {
            let since_s = *self.free_since.get_or_insert(row.t_s);
            self.first_touch |= row.t_s - since_s >= FREE_S;
        } else {
            self.free_since = None;
        }
        if !self.touching {
            (self.found, self.still) = (None, None);
            self.evidence.clear();
            return None;
        }
        let now = match row.velocity_mm_s {
            Some(velocity) => self.of_velocity(&velocity),
            None => self.still(row).then_some(UntrainedMotion::Hold),
        };
        let now = now.or_else(|| self.touched_behind(row).then_some(UntrainedMotion::Against));
        let now = now.or(self.unforeseen(row).then_some(UntrainedMotion::Unforeseen));
        self.found = now.or(self.found);
        self.found
    }

    fn of_velocity(&self, w: &Vector3<f64>) -> Option<UntrainedMotion> {
        let [low, high] = self.trained_mm_s;
        if w.norm() < low {
            Some(UntrainedMotion::Hold)
        } else if w.z < 0.0 {
            Some(UntrainedMotion::Against)
        } else if w.xy().norm() > ASIDE * w.z {
            Some(UntrainedMotion::Aside)
        } else {
            (w.z > high).then_some(UntrainedMotion::Fast)
        }
    }

    /// Whether the moments have stood still for longer than a sweep lets them.
    fn still(&mut self, row: &MotionSample) -> bool {
        let (since_s, [y, z]) = *self.still.get_or_insert((row.t_s, row.moment_nmm));
        let noise_nmm = row.sd_nmm[0].hypot(row.sd_nmm[1]);
        let moved = (row.moment_nmm[0] - y).hypot(row.moment_nmm[1] - z);
        if moved > STILL_NMM.max(STILL_SHARE * y.hypot(z)).max(2.0 * noise_nmm) {
            self.still = Some((row.t_s, row.moment_nmm));
            return false;
        }
        row.t_s - since_s > STILL_S
    }

    /// Whether the last rows of the contact were predicted worse than in any sweep.
    fn unforeseen(&mut self, row: &MotionSample) -> bool {
        let Some(evidence) = row.log_evidence else { return false };
        self.evidence.push_back(evidence.max(EVIDENCE_FLOOR));
        if self.evidence.len() > EVIDENCE_ROWS {
            self.evidence.pop_front();
        }
        let sum: f64 = self.evidence.iter().sum();
        self.evidence.len() == EVIDENCE_ROWS && sum < EVIDENCE_LOW * EVIDENCE_ROWS as f64
    }

    /// Whether the first touch of the free wire pushes it toward +z: no object that the base passes does so.
    fn touched_behind(&mut self, row: &MotionSample) -> bool {
        let [y, z] = row.moment_nmm;
        let size = y.hypot(z);
        let first = size >= DIRECTED_NMM && std::mem::take(&mut self.first_touch);
        first && y < -TOWARD * size && y < -4.0 * row.sd_nmm[0]
    }
}
