//! What the network sees of a sample, made the same way for training and for a stream.

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

/// Inputs that do not belong to a node.
const COMMON: usize = 9;
/// Inputs a node.
const PER_NODE: usize = 6;

/// A sample as the network takes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Token {
    /// `FeatureMaker::width` numbers.
    pub inputs: Vec<f32>,
    /// Time step since the token before, s.
    pub dt_s: f32,
    /// Where the contact would be, a node of the static inverse, mm.
    pub points_mm: Vec<[f32; 3]>,
    /// Whether the node can explain the moments.
    pub reachable: Vec<bool>,
}

/// Makes tokens out of samples in order of time.
#[derive(Debug, Clone)]
pub struct FeatureMaker<'a> {
    filter: BayesFilter<'a>,
    before: Option<([f64; 2], Vec<Candidate>)>,
}

impl<'a> FeatureMaker<'a> {
    /// At the beginning of a recording.
    #[must_use]
    pub fn new(inverse: &'a StaticInverse) -> Self {
        Self { filter: BayesFilter::new(inverse, BayesSettings::default()), before: None }
    }

    /// Inputs of a token.
    #[must_use]
    pub fn width(nodes: usize) -> usize {
        COMMON + PER_NODE * nodes
    }

    /// Takes transverse moments (N mm) `dt_s` after those before, and the base's speed along +z where it is known.
    pub fn push(&mut self, dt_s: f64, moment_nmm: [f64; 2], base_mm_s: Option<f64>) -> Token {
        self.filter.step(dt_s, moment_nmm, base_mm_s);
        let believed = self.filter.posterior();
        let now = self.filter.candidates().to_vec();
        let dt = dt_s.max(1e-4);
        let mut inputs = Vec::with_capacity(Self::width(now.len()));
        inputs.extend(moment_nmm.map(|m| m / MOMENT_NMM));
        inputs.extend(moment_nmm.map(|m| (m / SMALL_MOMENT_NMM).asinh() / 4.0));
        let rate =
            self.before.as_ref().map_or([0.0; 2], |(m, _)| [0, 1].map(|k| (moment_nmm[k] - m[k]) / dt));
        inputs.extend(rate.map(|r| (r / MOMENT_NMM).clamp(-8.0, 8.0)));
        inputs.push((dt / STEP_S).ln());
        inputs.push(f64::from(u8::from(base_mm_s.is_some())));
        inputs.push(base_mm_s.unwrap_or(0.0) / SPEED_MM_S);
        let base = Vector3::z() * base_mm_s.unwrap_or(0.0);
        for (k, c) in now.iter().enumerate() {
            // Along the force the touched point moves as the object does: what breaks that rule speaks against the node.
            let off = self.before.as_ref().map_or(0.0, |(_, before)| {
                let moved = (c.point_mm - before[k].point_mm) / dt + base;
                (c.normal.dot(&moved) / SPEED_MM_S).clamp(-4.0, 4.0)
            });
            inputs.extend(c.point_mm.iter().map(|x| x / LENGTH_MM));
            // What the Bayes filter believes: the network mends its physics and its springs.
            inputs.extend([off, c.normal.z, believed.get(k).map_or(0.0, |w| w.sqrt() * 2.0)]);
        }
        let token = Token {
            inputs: inputs.into_iter().map(|x| x as f32).collect(),
            dt_s: dt_s as f32,
            points_mm: now
                .iter()
                .map(|c| [c.point_mm.x, c.point_mm.y, c.point_mm.z].map(|x| x as f32))
                .collect(),
            reachable: now.iter().map(|c| c.reachable).collect(),
        };
        self.before = Some((moment_nmm, now));
        token
    }
}
