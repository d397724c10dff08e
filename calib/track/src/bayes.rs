//! Bayes filter on a grid of arc lengths (and base speeds, where they are not known): the physical baseline.
//!
//! A body is rigid and no wire enters it: along the direction of the force the touched point moves as the object does. Each pair of
//! candidates, before and now, breaks that rule by some distance, and the filter weighs it. At the first touch the wire cannot have
//! bent further than the base went. Friction, bending of the object and several contacts are outside its model.

mod rule;

use crate::{Candidate, StaticInverse};
use nalgebra::{Matrix3, Vector3};
use rule::Rule;
use serde::{Deserialize, Serialize};

/// What the filter assumes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BayesSettings {
    /// Moment above which there is a contact, N mm.
    pub onset_nmm: f64,
    /// Standard deviation of the moments' noise, N mm.
    pub noise_nmm: f64,
    /// Spread of the rule: a constant part, mm, and a part of the base's step.
    pub rule_mm: f64,
    /// See `rule_mm`.
    pub rule_share: f64,
    /// Share of steps that may pass an edge of the object.
    pub edge: f64,
    /// Share of steps that break the rule otherwise (several contacts, contact along a line), and by how much: a constant part, mm, and a part
    /// of the way on the surface.
    pub wide: f64,
    /// See `wide`.
    pub wide_mm: f64,
    /// See `wide`.
    pub wide_share: f64,
    /// Mean way of the contact on the object's surface: a constant part, mm, and a part of the base's step.
    pub slide_mm: f64,
    /// See `slide_mm`.
    pub slide_share: f64,
    /// Mean turn of the force at the tip over a step: a constant part, rad, and one by the base's way, rad/mm.
    pub turn: f64,
    /// See `turn`.
    pub turn_per_mm: f64,
    /// Probability that it turns to anywhere (an edge).
    pub turn_any: f64,
    /// Probability that the contact springs to anywhere on the wire within one step.
    pub spring: f64,
    /// Speeds considered where the base's is not known, mm/s, and their number.
    pub speed_mm_s: [f64; 2],
    /// See `speed_mm_s`.
    pub speeds: usize,
    /// Share of the speed's weight that moves to each neighbour in one second.
    pub speed_change_per_s: f64,
}

impl BayesSettings {
    /// For moments with this white noise, and with a zero that is off by so much, N mm.
    #[must_use]
    pub fn stated(noise_nmm: f64, zero_nmm: f64) -> Self {
        let clean = Self::default();
        Self {
            noise_nmm: clean.noise_nmm.max(noise_nmm),
            onset_nmm: clean.onset_nmm.max(5.0 * noise_nmm).max(2.0 * zero_nmm),
            ..clean
        }
    }
}

impl Default for BayesSettings {
    fn default() -> Self {
        Self {
            onset_nmm: 0.0015,
            noise_nmm: 0.0005,
            rule_mm: 0.005,
            rule_share: 0.02,
            edge: 0.2,
            wide: 0.03,
            wide_mm: 0.1,
            wide_share: 0.2,
            slide_mm: 0.4,
            slide_share: 0.3,
            turn: 0.04,
            turn_per_mm: 0.1,
            turn_any: 0.02,
            spring: 0.002,
            speed_mm_s: [2.5, 7.5],
            speeds: 11,
            speed_change_per_s: 0.05,
        }
    }
}

/// Weights below this share of all are dropped.
const SMALL: f64 = 1e-7;

/// Where the contact is believed to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// Mean, base frame, mm.
    pub point_mm: Vector3<f64>,
    /// Covariance, mm^2.
    pub covariance_mm2: Matrix3<f64>,
    /// Mean arc length, mm.
    pub arclength_mm: f64,
}

/// The filter of one whisker.
#[derive(Debug, Clone)]
pub struct BayesFilter<'a> {
    inverse: &'a StaticInverse,
    settings: BayesSettings,
    /// Weights by speed, then node; empty without contact.
    weights: Vec<Vec<f64>>,
    before: Vec<Candidate>,
    now: Vec<Candidate>,
    /// Logarithm of the density that the filter gave the last sample, 1/(N mm)^2; 0 where it foretold none.
    log_evidence: f64,
}

impl<'a> BayesFilter<'a> {
    /// Without contact so far.
    #[must_use]
    pub fn new(inverse: &'a StaticInverse, settings: BayesSettings) -> Self {
        Self {
            inverse,
            settings,
            weights: Vec::new(),
            before: Vec::new(),
            now: Vec::new(),
            log_evidence: 0.0,
        }
    }

    /// Candidates of the last sample.
    #[must_use]
    pub fn candidates(&self) -> &[Candidate] {
        &self.now
    }

    /// Posterior over the nodes at the last sample; empty without contact.
    #[must_use]
    pub fn posterior(&self) -> Vec<f64> {
        let nodes = self.inverse.nodes.len();
        let mut sum = vec![0.0; if self.weights.is_empty() { 0 } else { nodes }];
        for row in &self.weights {
            sum.iter_mut().zip(row).for_each(|(a, b)| *a += b);
        }
        sum
    }

    /// Logarithm of the density that the filter gave the last sample out of those before, 1/(N mm)^2: low where one contact on a rigid
    /// body explains the way of the moments badly. 0 without contact and at a first touch.
    #[must_use]
    pub fn log_evidence(&self) -> f64 {
        self.log_evidence
    }

    /// Puts all belief on one node of the last sample: what would follow if the contact were known there.
    pub fn know(&mut self, node: usize) {
        for (k, weight) in self.weights.iter_mut().flat_map(|row| row.iter_mut().enumerate()) {
            *weight = f64::from(u8::from(k == node));
        }
        self.normalise();
    }

    /// Takes a sample `dt_s` after the one before; `base_mm_s` is the base's speed along +z where it is known.
    pub fn step(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Option<Belief> {
        std::mem::swap(&mut self.before, &mut self.now);
        self.inverse.candidates(moment_nmm, &mut self.now);
        let size = moment_nmm[0].hypot(moment_nmm[1]);
        if size < self.settings.onset_nmm {
            self.weights.clear();
            self.log_evidence = 0.0;
            return None;
        }
        let speeds = base_mm_s.map_or_else(|| self.speeds(), |v| vec![v]);
        self.log_evidence = 0.0;
        let followed = self.weights.len() == speeds.len() && self.follow(dt_s, &speeds);
        if !followed {
            let felt_before = !self.weights.is_empty() || self.before.is_empty();
            self.weights = vec![Vec::new(); speeds.len()];
            if !felt_before {
                // The wire at rest, seen from where it is touched now.
                self.inverse.candidates(moment_nmm.map(|m| m / size * REST_NMM), &mut self.before);
            }
            let rule = Rule::new(&self.settings, self.inverse, &self.before, &self.now);
            for (speed, row) in speeds.iter().zip(&mut self.weights) {
                *row = rule.touched((!felt_before).then_some(speed * dt_s));
            }
            self.normalise();
        }
        self.belief()
    }

    fn speeds(&self) -> Vec<f64> {
        let ([low, high], n) = (self.settings.speed_mm_s, self.settings.speeds.max(2));
        (0..n).map(|k| low + (high - low) * k as f64 / (n - 1) as f64).collect()
    }

    /// Whether anything is left that explains the sample.
    fn follow(&mut self, dt_s: f64, speeds: &[f64]) -> bool {
        let rule = Rule::new(&self.settings, self.inverse, &self.before, &self.now);
        let least = SMALL * self.weights.iter().flatten().sum::<f64>();
        let mut next: Vec<Vec<f64>> = speeds
            .iter()
            .zip(&self.weights)
            .map(|(speed, row)| rule.moved(row, least, speed * dt_s))
            .collect();
        spread(&mut next, (self.settings.speed_change_per_s * dt_s).min(0.25));
        self.weights = next;
        let total: f64 = self.weights.iter().flatten().sum();
        self.log_evidence = total.max(f64::MIN_POSITIVE).ln();
        self.normalise()
    }

    fn normalise(&mut self) -> bool {
        let total: f64 = self.weights.iter().flatten().sum();
        if total > 0.0 {
            self.weights.iter_mut().flatten().for_each(|w| *w /= total);
        }
        total > 0.0
    }

    fn belief(&self) -> Option<Belief> {
        let posterior = self.posterior();
        let total: f64 = posterior.iter().sum();
        if !(total > 0.0) {
            return None;
        }
        let (mut point, mut arclength) = (Vector3::zeros(), 0.0);
        for ((w, c), s) in posterior.iter().zip(&self.now).zip(&self.inverse.nodes) {
            point += c.point_mm * (w / total);
            arclength += s.arclength_mm * w / total;
        }
        let mut covariance = Matrix3::identity() * self.settings.rule_mm.powi(2);
        for (w, c) in posterior.iter().zip(&self.now) {
            let off = c.point_mm - point;
            covariance += off * off.transpose() * (w / total);
        }
        Some(Belief { point_mm: point, covariance_mm2: covariance, arclength_mm: arclength })
    }
}

/// Moment of a wire that is as good as at rest, N mm.
const REST_NMM: f64 = 1e-5;

/// Speeds change little by little: a share of each row's weights goes to each neighbour.
fn spread(rows: &mut [Vec<f64>], share: f64) {
    let n = rows.len();
    if n < 2 {
        return;
    }
    let old = rows.to_vec();
    for (v, row) in rows.iter_mut().enumerate() {
        let (low, high) = (v.saturating_sub(1), (v + 1).min(n - 1));
        for (j, w) in row.iter_mut().enumerate() {
            *w = (1.0 - 2.0 * share) * old[v][j] + share * (old[low][j] + old[high][j]);
        }
    }
}
