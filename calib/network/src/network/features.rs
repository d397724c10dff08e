//! Inputs of the network at a sample, the same for training and for a stream.
//!
//! Of moments m, time step dt, base speed u, and at each knot k the inverse's point p_k, normal n_k
//! and the filter's posterior w_k and velocity v_k:
//!
//! ```text
//! m / 0.5,  asinh(m / 0.02) / 4,  (dm/dt) / 0.5,  ln(dt / 0.1),  u known,  u / 5
//! log evidence (shifted, scaled),  filter's speed / 5
//! per knot  p / 30,  n . (dp/dt + u e_z) / 5,  n_z,  2 sqrt(w),  v          the second is the rigid-body constraint: 0 at the true node
//! frictionless filter: its evidence,  2 sqrt(w) per knot
//! ```
//!
//! Knots are every fourth node; what lies between is shared by linear interpolation. N mm, mm, s.

use super::config::{COMMON_INPUTS, PLACE_SCALE_MM};
use crate::filter::{BayesFilter, FilterBank};
use crate::inverse::{InverseSolution, StaticInverse};
use nalgebra::Vector3;

/// Scales that bring inputs near one: N mm, mm/s.
const MOMENT_NMM: f64 = 0.5;
const SMALL_MOMENT_NMM: f64 = 0.02;
const SPEED_MM_S: f64 = 5.0;
/// Time step of the sweeps that networks are trained on, s; that of a series' first sample.
pub const SWEEP_STEP_S: f64 = 0.1;

/// Inputs from the filter: its evidence, and its posterior mean of the speed.
const FILTER_INPUTS: usize = 2;
/// Inputs a knot; those of the frictionless filter come after all others: its evidence, and its
/// posterior at each knot.
const KNOT_INPUTS: usize = 7;
/// Scale of the logarithm of the evidence, and its usual value during a contact.
const EVIDENCE_SCALE: f64 = 4.0;
const TYPICAL_LOG_EVIDENCE: f64 = 8.0;
/// Nodes of the curve from one knot, with the network's inputs and outputs, to the next.
const KNOT_STRIDE: usize = 4;
/// Initial logarithm of the network's floor under the filter's posterior: the weight of nodes that
/// the filter rules out.
pub const INITIAL_LOG_FLOOR: f32 = -4.0;

/// Nodes of the curve at which the network's knots lie: every fourth, and the last.
pub fn knots(nodes: usize) -> Vec<usize> {
    let last = nodes.saturating_sub(1);
    (0..last).step_by(KNOT_STRIDE).chain([last]).collect()
}

/// For each node the knot at or before it and the share of the next one.
pub fn knot_weights(nodes: usize) -> Vec<(usize, f32)> {
    let knots = knots(nodes);
    let one = |node: usize| {
        let k = (node / KNOT_STRIDE).min(knots.len().saturating_sub(2));
        match knots.get(k + 1) {
            Some(next) if *next > knots[k] => {
                (k, (node - knots[k]) as f32 / (next - knots[k]) as f32)
            }
            _ => (k, 0.0),
        }
    };
    (0..nodes).map(one).collect()
}

/// A sample as the network takes it.
#[derive(Debug, Clone)]
pub struct Token {
    /// `FeatureExtractor::width` numbers.
    pub inputs: Vec<f32>,
    /// Time step since the token before, s.
    pub dt_s: f32,
    /// Where the contact would be, a node of the static inverse, mm.
    pub points_mm: Vec<[f32; 3]>,
    /// Direction of the force at each node.
    pub normals: Vec<[f32; 3]>,
    /// Posterior of the Bayes filter over the nodes, which the network corrects.
    pub posterior: Vec<f32>,
    /// The same of the frictionless filter; empty where there is none.
    pub posterior_frictionless: Vec<f32>,
}

/// Makes tokens out of samples in order of time.
#[derive(Debug, Clone)]
pub struct FeatureExtractor<'a> {
    filter: BayesFilter<'a>,
    frictionless: Option<BayesFilter<'a>>,
    knots: Vec<usize>,
    knot_weights: Vec<(usize, f32)>,
    before: Option<([f64; 2], Vec<InverseSolution>)>,
}

impl<'a> FeatureExtractor<'a> {
    /// At the beginning of a recording.
    pub fn new(inverse: &'a StaticInverse, filters: FilterBank) -> Self {
        let nodes = inverse.nodes.len();
        let filter = |settings| BayesFilter::new(inverse, settings);
        Self {
            filter: filter(filters.frictional),
            frictionless: filters.frictionless.map(filter),
            knots: knots(nodes),
            knot_weights: knot_weights(nodes),
            before: None,
        }
    }

    /// Inputs of a token on a curve of this many nodes, by one filter or two.
    pub fn width(nodes: usize, two_filters: bool) -> usize {
        let knots = knots(nodes).len();
        COMMON_INPUTS
            + FILTER_INPUTS
            + KNOT_INPUTS * knots
            + if two_filters { 1 + knots } else { 0 }
    }

    /// Takes transverse moments (N mm) `dt_s` after those before, and the base's speed along +z
    /// where it is known.
    pub fn push(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Token {
        let dt = dt_s.max(1e-4);
        let mut inputs = self.common(dt, moment_nmm, base_mm_s);
        self.filter.step(dt_s, moment_nmm, base_mm_s, None);
        let all = self.filter.solutions();
        let posterior = posterior_or_uniform(&self.filter);
        let mut velocities = self.filter.velocities();
        velocities.resize(all.len(), 0.0);
        let shared = |at_nodes: &[f64]| at_knots(&self.knot_weights, self.knots.len(), at_nodes);
        let at_knots = shared(&posterior);
        let velocity = shared(
            &posterior
                .iter()
                .zip(&velocities)
                .map(|(w, p)| w * p)
                .collect::<Vec<_>>(),
        );
        let now: Vec<InverseSolution> = self.knots.iter().map(|k| all[*k]).collect();
        inputs.push(evidence(&self.filter));
        inputs.push(self.filter.speed_mm_s().or(base_mm_s).unwrap_or(0.0) / SPEED_MM_S);
        let base = Vector3::z() * base_mm_s.unwrap_or(0.0);
        for (k, c) in now.iter().enumerate() {
            // Along the force the touched point moves as the object does: a violation is evidence
            // against the node.
            let off = self.before.as_ref().map_or(0.0, |(_, before)| {
                let moved = (c.point_mm - before[k].point_mm) / dt + base;
                (c.normal.dot(&moved) / SPEED_MM_S).clamp(-4.0, 4.0)
            });
            inputs.extend(c.point_mm.iter().map(|x| x / PLACE_SCALE_MM));
            // A mean over the knot's weight: next to none would be a ratio of roundings.
            let velocity = if at_knots[k] > 1e-3 {
                (velocity[k] / at_knots[k]).clamp(-4.0, 4.0)
            } else {
                0.0
            };
            inputs.extend([off, c.normal.z, at_knots[k].sqrt() * 2.0, velocity]);
        }
        let mut posterior_frictionless = Vec::new();
        if let Some(frictionless) = &mut self.frictionless {
            frictionless.step(dt_s, moment_nmm, base_mm_s, Some(&self.filter));
            posterior_frictionless = posterior_or_uniform(frictionless);
            inputs.push(evidence(frictionless));
            inputs.extend(
                shared(&posterior_frictionless)
                    .iter()
                    .map(|w| w.sqrt() * 2.0),
            );
        }
        let token = Token::new(dt_s, &inputs, all, [&posterior, &posterior_frictionless]);
        self.before = Some((moment_nmm, now));
        token
    }

    /// Inputs that do not belong to a node.
    fn common(&self, dt: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Vec<f64> {
        let mut inputs = Vec::with_capacity(Self::width(
            self.knot_weights.len(),
            self.frictionless.is_some(),
        ));
        inputs.extend(moment_nmm.map(|m| m / MOMENT_NMM));
        // asinh: linear for small moments, logarithmic for large ones.
        inputs.extend(moment_nmm.map(|m| (m / SMALL_MOMENT_NMM).asinh() / 4.0));
        // Finite difference, bounded: a contact's first load has no rate.
        let rate = self.before.as_ref().map_or([0.0; 2], |(m, _)| {
            [0, 1].map(|k| (moment_nmm[k] - m[k]) / dt)
        });
        inputs.extend(rate.map(|r| (r / MOMENT_NMM).clamp(-8.0, 8.0)));
        inputs.push((dt / SWEEP_STEP_S).ln());
        inputs.push(f64::from(u8::from(base_mm_s.is_some())));
        inputs.push(base_mm_s.unwrap_or(0.0) / SPEED_MM_S);
        inputs
    }
}

/// A token's inputs on a curve of this many nodes, mirrored at the plane y = 0: places change their
/// y, moments the part about z.
pub fn mirror(inputs: &mut [f32], nodes: usize) {
    // A moment is an axial vector: a mirror at y = 0 keeps its part along y and turns that along z.
    let knots = if nodes > 0 { knots(nodes).len() } else { 0 };
    let places = (0..knots).map(|k| COMMON_INPUTS + FILTER_INPUTS + KNOT_INPUTS * k + 1);
    // The moment, small ones, and its rate.
    for at in [1, 3, 5].into_iter().chain(places) {
        inputs[at] = -inputs[at];
    }
}

/// A filter's posterior over the nodes; uniform without contact.
fn posterior_or_uniform(filter: &BayesFilter<'_>) -> Vec<f64> {
    let (posterior, nodes) = (filter.posterior(), filter.solutions().len());
    if posterior.is_empty() {
        vec![1.0 / nodes as f64; nodes]
    } else {
        posterior
    }
}

/// A filter's evidence as an input; 0 where it predicted nothing.
fn evidence(filter: &BayesFilter<'_>) -> f64 {
    let evidence = filter.log_evidence();
    if evidence == 0.0 {
        0.0
    } else {
        ((evidence - TYPICAL_LOG_EVIDENCE) / EVIDENCE_SCALE).max(-8.0)
    }
}

/// Values at nodes, split between the knots before and after each.
fn at_knots(knot_weights: &[(usize, f32)], knots: usize, at_nodes: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; knots];
    for (weight, (k, u)) in at_nodes.iter().zip(knot_weights) {
        sums[*k] += weight * f64::from(1.0 - u);
        if let Some(next) = sums.get_mut(k + 1) {
            *next += weight * f64::from(*u);
        }
    }
    sums
}

impl Token {
    fn new(
        dt_s: f64,
        inputs: &[f64],
        all: &[InverseSolution],
        [posterior, frictionless]: [&[f64]; 2],
    ) -> Self {
        let three = |v: &Vector3<f64>| [v.x, v.y, v.z].map(|x| x as f32);
        Self {
            inputs: inputs.iter().map(|x| *x as f32).collect(),
            dt_s: dt_s as f32,
            points_mm: all.iter().map(|c| three(&c.point_mm)).collect(),
            normals: all.iter().map(|c| three(&c.normal)).collect(),
            posterior: posterior.iter().map(|w| *w as f32).collect(),
            posterior_frictionless: frictionless.iter().map(|w| *w as f32).collect(),
        }
    }
}
