//! What the network sees of a sample, made the same way for training and for a stream.

use super::NetworkConfig;
use crate::bayes::{BayesFilter, Filters};
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
/// Inputs a knot; those of the filter beside come after all others: its evidence, and its belief at each knot.
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
    /// The same of the filter beside it; empty where there is none.
    pub beside: Vec<f32>,
}

/// Makes tokens out of samples in order of time.
#[derive(Debug, Clone)]
pub struct FeatureMaker<'a> {
    filter: BayesFilter<'a>,
    beside: Option<BayesFilter<'a>>,
    knots: Vec<usize>,
    between: Vec<(usize, f32)>,
    before: Option<([f64; 2], Vec<Candidate>)>,
    /// The network takes nothing of the rod and the filter: neither is asked.
    plain: bool,
}

impl<'a> FeatureMaker<'a> {
    /// At the beginning of a recording.
    #[must_use]
    pub fn new(inverse: &'a StaticInverse, filters: Filters) -> Self {
        let nodes = inverse.nodes.len();
        let filter = |settings| BayesFilter::new(inverse, settings);
        Self {
            filter: filter(filters.first),
            beside: filters.beside.map(filter),
            knots: knots(nodes),
            between: between(nodes),
            before: None,
            plain: false,
        }
    }

    /// For a network of these sizes.
    #[must_use]
    pub fn of(config: &NetworkConfig, inverse: &'a StaticInverse, filters: Filters) -> Self {
        Self { plain: config.plain(), ..Self::new(inverse, filters) }
    }

    /// Inputs of a token on a curve of so many nodes, by one filter or two.
    #[must_use]
    pub fn width(nodes: usize, two_filters: bool) -> usize {
        let knots = knots(nodes).len();
        COMMON + OF_FILTER + PER_KNOT * knots + if two_filters { 1 + knots } else { 0 }
    }

    /// Takes transverse moments (N mm) `dt_s` after those before, and the base's speed along +z where it is known.
    pub fn push(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Token {
        let dt = dt_s.max(1e-4);
        let mut inputs = self.common(dt, moment_nmm, base_mm_s);
        if self.plain {
            self.before = Some((moment_nmm, Vec::new()));
            return Token::new(dt_s, &inputs, &[], [&[], &[]]);
        }
        self.filter.step(dt_s, moment_nmm, base_mm_s);
        let all = self.filter.candidates();
        let posterior = believed(&self.filter);
        let mut paces = self.filter.paces();
        paces.resize(all.len(), 0.0);
        let shared = |at_nodes: &[f64]| at_knots(&self.between, self.knots.len(), at_nodes);
        let at_knots = shared(&posterior);
        let pace = shared(&posterior.iter().zip(&paces).map(|(w, p)| w * p).collect::<Vec<_>>());
        let now: Vec<Candidate> = self.knots.iter().map(|k| all[*k]).collect();
        inputs.push(evidence(&self.filter));
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
        let mut posterior_beside = Vec::new();
        if let Some(beside) = &mut self.beside {
            beside.step_beside(dt_s, moment_nmm, base_mm_s, &self.filter);
            posterior_beside = believed(beside);
            inputs.push(evidence(beside));
            inputs.extend(shared(&posterior_beside).iter().map(|w| w.sqrt() * 2.0));
        }
        let token = Token::new(dt_s, &inputs, all, [&posterior, &posterior_beside]);
        self.before = Some((moment_nmm, now));
        token
    }

    /// Inputs that do not belong to a node.
    fn common(&self, dt: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Vec<f64> {
        let mut inputs = Vec::with_capacity(Self::width(self.between.len(), self.beside.is_some()));
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

/// A token's inputs on a curve of so many nodes, mirrored at the plane y = 0: places change their y, moments the part about z.
pub(crate) fn mirror(inputs: &mut [f32], nodes: usize) {
    let knots = if nodes > 0 { knots(nodes).len() } else { 0 };
    let places = (0..knots).map(|k| COMMON + OF_FILTER + PER_KNOT * k + 1);
    // The moment, small ones, and its rate.
    for at in [1, 3, 5].into_iter().chain(places) {
        inputs[at] = -inputs[at];
    }
}

/// What a filter believes of each node; without contact nothing.
fn believed(filter: &BayesFilter<'_>) -> Vec<f64> {
    let (posterior, nodes) = (filter.posterior(), filter.candidates().len());
    if posterior.is_empty() { vec![1.0 / nodes as f64; nodes] } else { posterior }
}

/// A filter's evidence as an input; 0 where it foretold nothing.
fn evidence(filter: &BayesFilter<'_>) -> f64 {
    let evidence = filter.log_evidence();
    if evidence == 0.0 { 0.0 } else { ((evidence - GOES_ON) / EVIDENCE).max(-8.0) }
}

/// What lies at nodes, shared out among the knots before and after each.
fn at_knots(between: &[(usize, f32)], knots: usize, at_nodes: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; knots];
    for (weight, (k, u)) in at_nodes.iter().zip(between) {
        sums[*k] += weight * f64::from(1.0 - u);
        if let Some(next) = sums.get_mut(k + 1) {
            *next += weight * f64::from(*u);
        }
    }
    sums
}

impl Token {
    fn new(dt_s: f64, inputs: &[f64], all: &[Candidate], [believed, beside]: [&[f64]; 2]) -> Self {
        let three = |v: &Vector3<f64>| [v.x, v.y, v.z].map(|x| x as f32);
        Self {
            inputs: inputs.iter().map(|x| *x as f32).collect(),
            dt_s: dt_s as f32,
            points_mm: all.iter().map(|c| three(&c.point_mm)).collect(),
            normals: all.iter().map(|c| three(&c.normal)).collect(),
            believed: believed.iter().map(|w| *w as f32).collect(),
            beside: beside.iter().map(|w| *w as f32).collect(),
        }
    }
}
