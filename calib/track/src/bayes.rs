//! Bayes filter on a grid of arc lengths (of coefficients of friction, and of base speeds where they are not known): the physical baseline.
//!
//! A body is rigid and no wire enters it: along its normal the touched point moves as the object does. The moments tell the force, which
//! friction leans against the slide across the wire by a constant share (Coulomb). Each pair of candidates, before and now, breaks that rule by
//! some distance, and the filter weighs it. At the first touch the wire cannot have bent further than the base went. Friction along the
//! wire, bending of the object and several contacts are outside its model.

mod cell;
mod rule;
mod settings;
mod side;

use crate::{Candidate, StaticInverse};
use cell::Cell;
use nalgebra::{Matrix3, Vector3};
use rule::Rule;
pub use settings::{BayesSettings, Filters};

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
