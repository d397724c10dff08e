//! Bayes filter on a grid of arc lengths (of coefficients of friction, and of base speeds where they are not known): the physical baseline.
//!
//! A body is rigid and no wire enters it: along its normal the touched point moves as the object does. The moments tell the force, which
//! friction leans against the slide across the wire by a constant share (Coulomb). Each pair of candidates, before and now, breaks that rule by
//! some distance, and the filter weighs it. At the first touch the wire cannot have bent further than the base went. Friction along the
//! wire, bending of the object and several contacts are outside its model.

mod cell;
mod rule;
mod side;

use crate::{Candidate, StaticInverse};
use cell::Cell;
use nalgebra::{Matrix3, Vector3};
use rule::Rule;
use serde::{Deserialize, Serialize};

/// Coefficients of friction that the filter weighs against each other at most.
const FRICTIONS: usize = 3;

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
    /// Coefficients of friction considered, in rising order (the last one again where there are fewer), and the standard deviation of those
    /// that each above 0 stands for.
    pub friction: [f64; FRICTIONS],
    /// See `friction`.
    pub friction_sd: f64,
    /// Spread by a turn of the force, as a part of it times the way on the surface.
    pub edge: f64,
    /// Share of steps that break the rule otherwise (several contacts, contact along a line), and by how much: a constant part, mm, and a part
    /// of the way on the surface.
    pub wide: f64,
    /// See `wide`.
    pub wide_mm: f64,
    /// See `wide`.
    pub wide_share: f64,
    /// Standard deviation of the way along the wire about the one foretold: a constant part, mm, and a part of the base's step; where it goes
    /// on as before, where it does roughly, and where it is another one, of mean `changed_mean` by the base's way.
    pub steady: [f64; 2],
    /// See `steady`.
    pub unsteady: [f64; 2],
    /// See `steady`.
    pub changed: [f64; 2],
    /// See `steady`.
    pub changed_mean: f64,
    /// Shares of such steps.
    pub unsteady_share: f64,
    /// See `unsteady_share`.
    pub changed_share: f64,
    /// The same of the force's turn at the tip: rad, and rad/mm.
    pub tip_steady: [f64; 2],
    /// See `tip_steady`.
    pub tip_unsteady: [f64; 2],
    /// See `tip_steady`.
    pub tip_changed: [f64; 2],
    /// Probability that the force at the tip turns to anywhere (an edge).
    pub turn_any: f64,
    /// Mean turn of the force about the wire over a step: a constant part, rad, and one by the base's way, rad/mm.
    pub bend: [f64; 2],
    /// The same where the object is sharp, and the share of such steps.
    pub sharp: [f64; 2],
    /// See `sharp`.
    pub sharp_share: f64,
    /// Where wires are touched first: mean and standard deviation of the arc length, as shares of the wire's length.
    pub touch_at: [f64; 2],
    /// Probability that the contact springs, by the base's way, 1/mm.
    pub spring_per_mm: f64,
    /// Mean way of a spring along the wire, toward the root and toward the tip, mm.
    pub spring_mm: [f64; 2],
    /// Mean way of a spring against the force, where short and where long, mm; share of springs along it.
    pub spring_off_mm: [f64; 2],
    /// See `spring_off_mm`.
    pub spring_back: f64,
    /// Mean turn of the force about the wire, rad.
    pub spring_turn: f64,
    /// Share of springs to anywhere on the wire.
    pub spring_anywhere: f64,
    /// Share of springs to the tip: from the wire, and from the tip.
    pub spring_to_tip: f64,
    /// See `spring_to_tip`.
    pub spring_at_tip: f64,
    /// Speeds considered where the base's is not known, mm/s, and their number.
    pub speed_mm_s: [f64; 2],
    /// See `speed_mm_s`.
    pub speeds: usize,
    /// Share of the speed's weight that moves to each neighbour in one second.
    pub speed_change_per_s: f64,
}

impl BayesSettings {
    /// For objects with friction: three coefficients are weighed against each other, and rule and moments, which friction along the wire
    /// breaks, are taken for less exact. The default is a wire that slides freely.
    #[must_use]
    pub fn rough() -> Self {
        Self {
            noise_nmm: 0.0007,
            friction: [0.0, 0.15, 0.3],
            wide: 0.7,
            wide_mm: 0.03,
            wide_share: 0.1,
            bend: [0.003, 0.03],
            ..Self::default()
        }
    }

    /// The same beside one that slides freely (`Filters`): objects without friction are left to that one.
    #[must_use]
    pub fn dragged() -> Self {
        Self { friction: [0.1, 0.25, 0.25], ..Self::rough() }
    }

    /// Coefficients considered, each once.
    fn frictions(&self) -> &[f64] {
        let distinct = 1 + self.friction.windows(2).filter(|pair| pair[0] < pair[1]).count();
        &self.friction[..distinct]
    }

    /// The same for moments with this white noise, and with a zero that is off by so much, N mm.
    #[must_use]
    pub fn told(self, noise_nmm: f64, zero_nmm: f64) -> Self {
        Self {
            noise_nmm: self.noise_nmm.max(noise_nmm),
            onset_nmm: self.onset_nmm.max(5.0 * noise_nmm).max(2.0 * zero_nmm),
            ..self
        }
    }
}

impl Default for BayesSettings {
    fn default() -> Self {
        Self {
            onset_nmm: 0.0015,
            noise_nmm: 0.0001,
            rule_mm: 0.0015,
            rule_share: 0.008,
            friction: [0.0; FRICTIONS],
            friction_sd: 0.04,
            edge: 0.25,
            wide: 0.05,
            wide_mm: 0.1,
            wide_share: 0.3,
            steady: [0.002, 0.02],
            unsteady: [0.02, 0.3],
            changed: [0.2, 0.8],
            changed_mean: 0.4,
            unsteady_share: 0.3,
            changed_share: 0.2,
            tip_steady: [0.0005, 0.004],
            tip_unsteady: [0.005, 0.1],
            tip_changed: [0.02, 0.5],
            turn_any: 0.01,
            bend: [0.001, 0.012],
            sharp: [0.015, 0.2],
            sharp_share: 0.25,
            touch_at: [0.73, 0.15],
            spring_per_mm: 0.045,
            spring_mm: [1.5, 4.0],
            spring_off_mm: [0.4, 3.0],
            spring_back: 0.15,
            spring_turn: 0.25,
            spring_anywhere: 0.041,
            spring_to_tip: 0.17,
            spring_at_tip: 0.95,
            speed_mm_s: [2.5, 7.5],
            speeds: 11,
            speed_change_per_s: 0.05,
        }
    }
}

/// The filters below a network, which weighs them against each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filters {
    /// The one for all objects, or for those with friction.
    pub first: BayesSettings,
    /// One beside it, for objects without friction.
    pub beside: Option<BayesSettings>,
}

impl Filters {
    /// Both for moments with this white noise, and with a zero that is off by so much, N mm.
    #[must_use]
    pub fn told(self, noise_nmm: f64, zero_nmm: f64) -> Self {
        let told = |s: BayesSettings| s.told(noise_nmm, zero_nmm);
        Self { first: told(self.first), beside: self.beside.map(told) }
    }
}

impl From<BayesSettings> for Filters {
    fn from(first: BayesSettings) -> Self {
        Self { first, beside: None }
    }
}

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
    /// Weights by friction, speed, then node; empty without contact.
    weights: Vec<Vec<Cell>>,
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
        for (k, cell) in self.weights.iter().flat_map(|row| row.iter().enumerate()) {
            // A place between two nodes is shared out among them; the mean stays.
            let beside = if cell.at < 0.0 { k.checked_sub(1) } else { Some(k + 1) };
            let share = match beside {
                Some(beside) if beside < nodes => {
                    sum[beside] += cell.weight * cell.at.abs();
                    cell.at.abs()
                }
                _ => 0.0,
            };
            sum[k] += cell.weight * (1.0 - share);
        }
        sum
    }

    /// Mean way of the contact along the curve by the base's way, at each node; empty without contact.
    #[must_use]
    pub fn paces(&self) -> Vec<f64> {
        let nodes = if self.weights.is_empty() { 0 } else { self.inverse.nodes.len() };
        let mean = |k: usize| {
            let (weight, sum) = self.weights.iter().fold((0.0, 0.0), |(weight, sum), row| {
                (weight + row[k].weight, sum + row[k].weight * row[k].pace)
            });
            if weight > 0.0 { sum / weight } else { 0.0 }
        };
        (0..nodes).map(mean).collect()
    }

    /// Mean speed of the base that is believed, of those considered; none without contact or where it is known.
    #[must_use]
    pub fn speed_mm_s(&self) -> Option<f64> {
        if self.weights.len() <= self.settings.frictions().len() {
            return None;
        }
        let speeds = self.speeds();
        let sum: f64 = speeds.iter().cycle().zip(&self.weights).map(|(v, row)| v * weight(row)).sum();
        let total = self.total();
        (total > 0.0).then(|| sum / total)
    }

    /// Logarithm of the density that the filter gave the last sample out of those before, 1/(N mm)^2: low where one contact on a rigid
    /// body explains the way of the moments badly. 0 without contact and at a first touch.
    #[must_use]
    pub fn log_evidence(&self) -> f64 {
        self.log_evidence
    }

    /// Puts all belief on one node of the last sample: what would follow if the contact were known there.
    pub fn know(&mut self, node: usize) {
        for row in &mut self.weights {
            let all = weight(row);
            row.fill(Cell::default());
            row[node] = Cell::evenly(all);
        }
    }

    /// Takes a sample `dt_s` after the one before; `base_mm_s` is the base's speed along +z where it is known.
    pub fn step(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Option<Belief> {
        let inverse = self.inverse;
        self.step_on(dt_s, moment_nmm, base_mm_s, |moment_nmm, now| inverse.candidates(moment_nmm, now))
    }

    /// The same with the candidates of a filter that has taken the sample, of the same onset.
    pub fn step_beside(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>, other: &Self) {
        self.step_on(dt_s, moment_nmm, base_mm_s, |_, now| now.clone_from(&other.now));
    }

    fn step_on(
        &mut self,
        dt_s: f64,
        moment_nmm: [f64; 2],
        base_mm_s: Option<f64>,
        candidates: impl FnOnce([f64; 2], &mut Vec<Candidate>),
    ) -> Option<Belief> {
        std::mem::swap(&mut self.before, &mut self.now);
        let size = moment_nmm[0].hypot(moment_nmm[1]);
        if size < self.settings.onset_nmm {
            // What is left of a free wire's moments has no direction: what is seen of it depends on none.
            candidates(FREE_NMM, &mut self.now);
            self.weights.clear();
            self.log_evidence = 0.0;
            return None;
        }
        candidates(moment_nmm, &mut self.now);
        let speeds = base_mm_s.map_or_else(|| self.speeds(), |v| vec![v]);
        self.log_evidence = 0.0;
        // Each speed stands for those around it.
        let way_sd_mm = if speeds.len() > 1 { (speeds[1] - speeds[0]) * dt_s / 12.0_f64.sqrt() } else { 0.0 };
        let frictions = self.settings.frictions().len();
        let followed =
            self.weights.len() == frictions * speeds.len() && self.follow(dt_s, &speeds, way_sd_mm);
        if !followed {
            let felt_before = !self.weights.is_empty() || self.before.is_empty();
            if !felt_before {
                // The wire at rest, seen from where it is touched now.
                self.inverse.candidates(moment_nmm.map(|m| m / size * REST_NMM), &mut self.before);
            }
            let rule = Rule::new(&self.settings, self.inverse, &self.before, &self.now);
            let touched = |v: &f64| rule.touched((!felt_before).then_some(v * dt_s), way_sd_mm);
            let rows: Vec<Vec<Cell>> = speeds.iter().map(touched).collect();
            self.weights = std::iter::repeat_n(rows, frictions).flatten().collect();
            self.normalise();
        }
        self.belief()
    }

    fn speeds(&self) -> Vec<f64> {
        let ([low, high], n) = (self.settings.speed_mm_s, self.settings.speeds.max(2));
        (0..n).map(|k| low + (high - low) * k as f64 / (n - 1) as f64).collect()
    }

    /// Whether anything is left that explains the sample.
    fn follow(&mut self, dt_s: f64, speeds: &[f64], way_sd_mm: f64) -> bool {
        let rule = Rule::new(&self.settings, self.inverse, &self.before, &self.now);
        let total = self.total();
        let rows = self.settings.frictions().iter().flat_map(|f| speeds.iter().map(move |v| (*f, *v)));
        let mut next: Vec<Vec<Cell>> = rows
            .zip(&self.weights)
            .map(|((friction, speed), row)| rule.moved(row, total, [speed * dt_s, way_sd_mm], friction))
            .collect();
        let share = (self.settings.speed_change_per_s * dt_s).min(0.25);
        next.chunks_mut(speeds.len()).for_each(|rows| spread(rows, share));
        self.weights = next;
        let total = self.total();
        self.log_evidence = total.max(f64::MIN_POSITIVE).ln();
        self.normalise()
    }

    fn total(&self) -> f64 {
        self.weights.iter().map(|row| weight(row)).sum()
    }

    fn normalise(&mut self) -> bool {
        let total = self.total();
        if total > 0.0 {
            self.weights.iter_mut().flatten().for_each(|c| c.weight /= total);
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
/// Moments (y, z) that stand for none: those of a push against the base's way.
const FREE_NMM: [f64; 2] = [REST_NMM, 0.0];

fn weight(row: &[Cell]) -> f64 {
    row.iter().map(|c| c.weight).sum()
}

/// Speeds change little by little: a share of each row's weights goes to each neighbour.
fn spread(rows: &mut [Vec<Cell>], share: f64) {
    let n = rows.len();
    if n < 2 {
        return;
    }
    let old = rows.to_vec();
    for (v, row) in rows.iter_mut().enumerate() {
        let (low, high) = (v.saturating_sub(1), (v + 1).min(n - 1));
        for (j, cell) in row.iter_mut().enumerate() {
            let parts = [(&old[v][j], 1.0 - 2.0 * share), (&old[low][j], share), (&old[high][j], share)];
            *cell = Cell::mixed(&parts);
        }
    }
}
