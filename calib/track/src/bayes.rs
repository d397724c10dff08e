//! Bayes filter on a grid of arc lengths (and base speeds, where they are not known): the physical baseline.
//!
//! A body is rigid and no wire enters it: along the direction of the force the touched point moves as the object does. Each pair of
//! candidates, before and now, breaks that rule by some distance, and the filter weighs it. Friction, bending of the object and
//! several contacts are outside its model.

use crate::{Candidate, StaticInverse};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// What the filter assumes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BayesSettings {
    /// Moment above which there is a contact, N mm.
    pub onset_nmm: f64,
    /// Spread of the rule: a constant part, mm, and a part of the base's step.
    pub rule_mm: f64,
    /// See `rule_mm`.
    pub rule_share: f64,
    /// Mean way of the contact on the object's surface: a constant part, mm, and a part of the base's step.
    pub slide_mm: f64,
    /// See `slide_mm`.
    pub slide_share: f64,
    /// Probability that the contact springs to anywhere on the wire within one step.
    pub spring: f64,
    /// Speeds considered where the base's is not known, mm/s, and their number.
    pub speed_mm_s: [f64; 2],
    /// See `speed_mm_s`.
    pub speeds: usize,
    /// Share of the speed's weight that moves to each neighbour in one second.
    pub speed_change_per_s: f64,
}

impl Default for BayesSettings {
    fn default() -> Self {
        Self {
            onset_nmm: 0.01,
            rule_mm: 0.02,
            rule_share: 0.05,
            slide_mm: 0.2,
            slide_share: 0.3,
            spring: 0.002,
            speed_mm_s: [2.5, 7.5],
            speeds: 11,
            speed_change_per_s: 0.05,
        }
    }
}

/// Ways on the surface beyond so many times the mean one are left to springs.
const REACH: f64 = 6.0;

/// Space in which a sprung contact may be anywhere, mm^3.
const SPRING_MM3: f64 = 2e4;
/// Probability that a sprung contact is the tip's, and moments that it may then have, (N mm)^2.
const TIP_SHARE: f64 = 0.3;
const SPRING_NMM2: f64 = 10.0;
/// Norm of a Gauss across times an exponential of the distance along the surface: (2 pi)^-3/2.
const FLAT: f64 = 0.063_494;

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
    /// Weights by speed, then arc length; empty without contact.
    weights: Vec<Vec<f64>>,
    before: Vec<Candidate>,
    now: Vec<Candidate>,
    /// Variance of the rule by the rounding to nodes, before and now, mm^2.
    rounding_before: Vec<f64>,
    rounding: Vec<f64>,
}

/// How far the rule is off where a contact lies anywhere between a node's neighbours' middles, as variance, mm^2.
fn rounding(candidates: &[Candidate], out: &mut Vec<f64>) {
    out.clear();
    let last = candidates.len() - 1;
    out.extend((0..=last).map(|k| {
        let (low, high) = (k.saturating_sub(1), (k + 1).min(last));
        let pitch = (candidates[high].point_mm - candidates[low].point_mm) / (high - low) as f64;
        candidates[k].normal.dot(&pitch).powi(2) / 12.0
    }));
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
            rounding_before: Vec::new(),
            rounding: Vec::new(),
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

    /// Takes a sample `dt_s` after the one before; `base_mm_s` is the base's speed along +z where it is known.
    pub fn step(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Option<Belief> {
        std::mem::swap(&mut self.before, &mut self.now);
        std::mem::swap(&mut self.rounding_before, &mut self.rounding);
        self.inverse.candidates(moment_nmm, &mut self.now);
        rounding(&self.now, &mut self.rounding);
        if moment_nmm[0].hypot(moment_nmm[1]) < self.settings.onset_nmm {
            self.weights.clear();
            return None;
        }
        let speeds = match base_mm_s {
            Some(v) => vec![v],
            None => self.speeds(),
        };
        if self.weights.len() == speeds.len() {
            self.follow(dt_s, &speeds);
        } else {
            let reachable = self.now.iter().filter(|c| c.reachable).count().max(1);
            let each = 1.0 / (reachable * speeds.len()) as f64;
            let row: Vec<f64> = self.now.iter().map(|c| if c.reachable { each } else { 0.0 }).collect();
            self.weights = vec![row; speeds.len()];
        }
        self.belief()
    }

    fn at_tip(&self, node: usize) -> bool {
        self.inverse.nodes[node].slant > 0.0
    }

    fn speeds(&self) -> Vec<f64> {
        let ([low, high], n) = (self.settings.speed_mm_s, self.settings.speeds.max(2));
        (0..n).map(|k| low + (high - low) * k as f64 / (n - 1) as f64).collect()
    }

    fn follow(&mut self, dt_s: f64, speeds: &[f64]) {
        let s = &self.settings;
        let nodes = self.now.len();
        let tip_nodes = (0..nodes).filter(|k| self.at_tip(*k)).count().max(1) as f64;
        let mut next = Vec::with_capacity(speeds.len());
        for (speed, row) in speeds.iter().zip(&self.weights) {
            let way_mm = speed * dt_s;
            let rule = s.rule_mm.powi(2) + (s.rule_share * way_mm).powi(2);
            let total: f64 = row.iter().sum();
            let mut new = vec![0.0; nodes];
            for (k, weight) in row.iter().enumerate().filter(|(_, w)| **w > 1e-9 * total) {
                let from = &self.before[k];
                // A tip that is dragged stays where it is and the surface passes below it.
                let share = if self.at_tip(k) { 1.0 } else { s.slide_share };
                let slide = s.slide_mm + share * way_mm;
                let reach_mm = REACH * slide;
                let near = |c: &&Candidate| (c.point_mm - from.point_mm).norm() < way_mm + reach_mm;
                let on = self.now.iter().skip(k).take_while(near).count();
                let back = self.now.iter().take(k).rev().take_while(near).count();
                let within = k - back..k + on;
                for ((j, to), new) in within.clone().zip(&self.now[within.clone()]).zip(&mut new[within]) {
                    let way = to.point_mm - from.point_mm + Vector3::z() * way_mm;
                    let normal = (from.normal + to.normal).try_normalize(0.1).unwrap_or(to.normal);
                    let off = normal.dot(&way);
                    let slid = (way - normal * off).norm();
                    let variance = rule + self.rounding_before[k] + self.rounding[j];
                    let density = (-0.5 * off * off / variance - slid / slide).exp()
                        / (variance.sqrt() * slide * slide);
                    *new += weight * density * FLAT;
                }
            }
            for (j, (w, c)) in new.iter_mut().zip(&self.now).enumerate() {
                // After a spring the contact is anywhere in space, or at the tip with any moments.
                let anywhere = (1.0 - TIP_SHARE) * c.volume / SPRING_MM3;
                let tip = if self.at_tip(j) { TIP_SHARE / (tip_nodes * SPRING_NMM2) } else { 0.0 };
                *w = if c.reachable { *w * c.volume + s.spring * total * (anywhere + tip) } else { 0.0 };
            }
            next.push(new);
        }
        let moved = (s.speed_change_per_s * dt_s).min(0.25);
        let n = next.len();
        if n > 1 {
            let old = next.clone();
            for (v, row) in next.iter_mut().enumerate() {
                let (low, high) = (v.saturating_sub(1), (v + 1).min(n - 1));
                for (j, w) in row.iter_mut().enumerate() {
                    *w = (1.0 - 2.0 * moved) * old[v][j] + moved * (old[low][j] + old[high][j]);
                }
            }
        }
        let total: f64 = next.iter().flatten().sum();
        if total > 0.0 {
            next.iter_mut().flatten().for_each(|w| *w /= total);
        }
        self.weights = next;
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
