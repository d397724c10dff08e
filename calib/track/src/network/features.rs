//! What the network sees of a sample, made the same way for training and for a stream.

use super::NetworkConfig;
use crate::bayes::{BayesFilter, BayesSettings};
use crate::{Candidate, StaticInverse};
use nalgebra::Vector3;

/// Scales that bring inputs near one: N mm, mm, mm/s.
const MOMENT_NMM: f64 = 0.5;
const SMALL_MOMENT_NMM: f64 = 0.02;
const LENGTH_MM: f64 = 30.0;
const SPEED_MM_S: f64 = 5.0;
/// Time step that counts as none special, s.
const STEP_S: f64 = 0.1;

/// Inputs that do not belong to a node; they come first.
pub const COMMON: usize = 9;
/// Inputs of what the filter makes of the sample: its evidence, and the speed that it believes.
const OF_FILTER: usize = 2;
/// Inputs a knot.
const PER_KNOT: usize = 7;
/// Scale of the logarithm of the evidence, and what a contact that goes on has.
const EVIDENCE: f64 = 4.0;
const GOES_ON: f64 = 8.0;
/// Nodes of the curve from one knot, of which the network sees and says something, to the next.
const STRIDE: usize = 4;
/// Logarithm of the doubt in the filter that the network starts with: the weight of what it says nothing about.
pub const DOUBT: f32 = -4.0;

/// Nodes of the curve at which the network's knots lie: every fourth, and the last.
#[must_use]
pub fn knots(nodes: usize) -> Vec<usize> {
    let last = nodes.saturating_sub(1);
    (0..last).step_by(STRIDE).chain([last]).collect()
}

/// For each node the knot at or before it and the share of the next one.
#[must_use]
pub fn between(nodes: usize) -> Vec<(usize, f32)> {
    let knots = knots(nodes);
    let one = |node: usize| {
        let k = (node / STRIDE).min(knots.len().saturating_sub(2));
        match knots.get(k + 1) {
            Some(next) if *next > knots[k] => (k, (node - knots[k]) as f32 / (next - knots[k]) as f32),
            _ => (k, 0.0),
        }
    };
    (0..nodes).map(one).collect()
}

/// A sample as the network takes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Token {
    /// `FeatureMaker::width` numbers.
    pub inputs: Vec<f32>,
    /// Time step since the token before, s.
    pub dt_s: f32,
    /// Where the contact would be, a node of the static inverse, mm.
    pub points_mm: Vec<[f32; 3]>,
    /// Direction of the force at each node.
    pub normals: Vec<[f32; 3]>,
    /// What the Bayes filter believes of each node: the network mends its physics and its springs.
    pub believed: Vec<f32>,
}

/// Makes tokens out of samples in order of time.
#[derive(Debug, Clone)]
pub struct FeatureMaker<'a> {
    filter: BayesFilter<'a>,
    knots: Vec<usize>,
    between: Vec<(usize, f32)>,
    before: Option<([f64; 2], Vec<Candidate>)>,
    /// The network takes nothing of the rod and the filter: neither is asked.
    plain: bool,
}

impl<'a> FeatureMaker<'a> {
    /// At the beginning of a recording.
    #[must_use]
    pub fn new(inverse: &'a StaticInverse, settings: BayesSettings) -> Self {
        let nodes = inverse.nodes.len();
        let filter = BayesFilter::new(inverse, settings);
        Self { filter, knots: knots(nodes), between: between(nodes), before: None, plain: false }
    }

    /// For a network of these sizes.
    #[must_use]
    pub fn of(config: &NetworkConfig, inverse: &'a StaticInverse, settings: BayesSettings) -> Self {
        Self { plain: config.plain(), ..Self::new(inverse, settings) }
    }

    /// Inputs of a token on a curve of so many nodes.
    #[must_use]
    pub fn width(nodes: usize) -> usize {
        COMMON + OF_FILTER + PER_KNOT * knots(nodes).len()
    }

    /// Takes transverse moments (N mm) `dt_s` after those before, and the base's speed along +z where it is known.
    pub fn push(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Token {
        let dt = dt_s.max(1e-4);
        let mut inputs = self.common(dt, moment_nmm, base_mm_s);
        if self.plain {
            self.before = Some((moment_nmm, Vec::new()));
            return Token::new(dt_s, &inputs, &[], &[]);
        }
        self.filter.step(dt_s, moment_nmm, base_mm_s);
        let all = self.filter.candidates();
        let mut posterior = self.filter.posterior();
        if posterior.is_empty() {
            posterior = vec![1.0 / all.len() as f64; all.len()];
        }
        let mut paces = self.filter.paces();
        paces.resize(all.len(), 0.0);
        let (mut at_knots, mut pace) = (vec![0.0; self.knots.len()], vec![0.0; self.knots.len()]);
        for ((weight, p), (k, u)) in posterior.iter().zip(&paces).zip(&self.between) {
            at_knots[*k] += weight * f64::from(1.0 - u);
            pace[*k] += weight * p * f64::from(1.0 - u);
            if let Some(next) = at_knots.get_mut(k + 1) {
                *next += weight * f64::from(*u);
                pace[k + 1] += weight * p * f64::from(*u);
            }
        }
        let now: Vec<Candidate> = self.knots.iter().map(|k| all[*k]).collect();
        let evidence = self.filter.log_evidence();
        inputs.push(if evidence == 0.0 { 0.0 } else { ((evidence - GOES_ON) / EVIDENCE).max(-8.0) });
        inputs.push(self.filter.speed_mm_s().or(base_mm_s).unwrap_or(0.0) / SPEED_MM_S);
        let base = Vector3::z() * base_mm_s.unwrap_or(0.0);
        for (k, c) in now.iter().enumerate() {
            // Along the force the touched point moves as the object does: what breaks that rule speaks against the node.
            let off = self.before.as_ref().map_or(0.0, |(_, before)| {
                let moved = (c.point_mm - before[k].point_mm) / dt + base;
                (c.normal.dot(&moved) / SPEED_MM_S).clamp(-4.0, 4.0)
            });
            inputs.extend(c.point_mm.iter().map(|x| x / LENGTH_MM));
            let pace = if at_knots[k] > 1e-3 { (pace[k] / at_knots[k]).clamp(-4.0, 4.0) } else { 0.0 };
            inputs.extend([off, c.normal.z, at_knots[k].sqrt() * 2.0, pace]);
        }
        let token = Token::new(dt_s, &inputs, all, &posterior);
        self.before = Some((moment_nmm, now));
        token
    }

    /// Inputs that do not belong to a node.
    fn common(&self, dt: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Vec<f64> {
        let mut inputs = Vec::with_capacity(Self::width(self.between.len()));
        inputs.extend(moment_nmm.map(|m| m / MOMENT_NMM));
        inputs.extend(moment_nmm.map(|m| (m / SMALL_MOMENT_NMM).asinh() / 4.0));
        let rate =
            self.before.as_ref().map_or([0.0; 2], |(m, _)| [0, 1].map(|k| (moment_nmm[k] - m[k]) / dt));
        inputs.extend(rate.map(|r| (r / MOMENT_NMM).clamp(-8.0, 8.0)));
        inputs.push((dt / STEP_S).ln());
        inputs.push(f64::from(u8::from(base_mm_s.is_some())));
        inputs.push(base_mm_s.unwrap_or(0.0) / SPEED_MM_S);
        inputs
    }
}

impl Token {
    fn new(dt_s: f64, inputs: &[f64], all: &[Candidate], posterior: &[f64]) -> Self {
        let three = |v: &Vector3<f64>| [v.x, v.y, v.z].map(|x| x as f32);
        Self {
            inputs: inputs.iter().map(|x| *x as f32).collect(),
            dt_s: dt_s as f32,
            points_mm: all.iter().map(|c| three(&c.point_mm)).collect(),
            normals: all.iter().map(|c| three(&c.normal)).collect(),
            believed: posterior.iter().map(|w| *w as f32).collect(),
        }
    }
}
