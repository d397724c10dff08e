//! Tracks sample by sample.
//!
//! With outputs f_k (interpolated from the knots), o (3 numbers), floor e and mixture g of the
//! network, and posteriors b, b' of the two filters:
//!
//! ```text
//! w_k ~ exp(f_k) (b_k + sigmoid(g) (b'_k - b_k) + exp(e - 4) / K),   sum w = 1
//! q = sum w_k p_k,   p = q + o,   C = f(t)^2 (sum w_k (p_k - q)(p_k - q)^T + s_min^2 I),   t = sqrt(trace)        (`sd_factors`)
//! n ~ sum w_k n_k,   P(contact), P(several | contact): sigmoids
//! ```
//!
//! so that the answer stays on what the moments allow; the network corrects the filters' posterior.

use crate::error::NetworkError;
use crate::filter::FilterBank;
use crate::inverse::StaticInverse;
use crate::network::features::SWEEP_STEP_S;
use crate::network::{
    FeatureExtractor, INITIAL_LOG_FLOOR, KvCache, NetworkConfig, PLACE_SCALE_MM, Prediction, Token,
    WhiskerNet, knot_weights, knots,
};
use crate::sd_factors::SdFactors;
use nalgebra::{Matrix3, Vector3};

/// A trained network with what it needs to answer.
#[derive(Debug, Clone)]
pub struct Tracker {
    /// Sizes.
    pub config: NetworkConfig,
    /// Layers.
    pub net: WhiskerNet,
    /// Curve of solutions.
    pub inverse: StaticInverse,
    /// The filters below the network.
    pub filters: FilterBank,
    /// Factors on the stated standard deviations: base's speed not known, and known.
    pub sd_factors: [SdFactors; 2],
}

/// One sample: time (s), transverse moments (N mm), speed of the base along +z where it is known
/// (mm/s).
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Time, s.
    pub t_s: f64,
    /// Moments y and z, N mm.
    pub moment_nmm: [f64; 2],
    /// Speed, mm/s.
    pub base_mm_s: Option<f64>,
}

impl Tracker {
    /// # Errors
    /// Where network and curve do not fit each other.
    pub fn check(&self) -> Result<(), NetworkError> {
        let nodes = self.inverse.nodes.len();
        let (nodes, width) = (
            knots(nodes).len(),
            FeatureExtractor::width(nodes, self.config.two_filters),
        );
        self.config.check_filters(&self.filters)?;
        if self.config.inputs != width || ![0, nodes].contains(&self.config.nodes) {
            let found = format!("{} inputs, {} knots", self.config.inputs, self.config.nodes);
            return Err(NetworkError::value(
                "network",
                format!("{width} inputs, {nodes} knots"),
                found,
            ));
        }
        Ok(())
    }

    /// A stream from its beginning.
    pub fn stream(&self) -> TrackerStream<'_> {
        self.stream_with(self.filters)
    }

    /// A stream from its beginning with other filters (measurement noise).
    pub fn stream_with(&self, filters: FilterBank) -> TrackerStream<'_> {
        TrackerStream {
            tracker: self,
            features: FeatureExtractor::new(&self.inverse, filters),
            cache: KvCache::default(),
            last_s: None,
        }
    }

    fn answer(&self, token: &Token, out: &[f32], base_known: bool) -> Prediction {
        let k = self.config.nodes;
        let off = &out[k..k + 3];
        let contact = 1.0 / (1.0 + (-out[k + 3]).exp());
        let several = (1.0 / (1.0 + (-f64::from(out[k + 4])).exp())) as f32;
        if k == 0 {
            // The paper's head states no spread.
            return Prediction {
                contact,
                several,
                point_mm: [0, 1, 2].map(|i| off[i] * PLACE_SCALE_MM as f32),
                ..Prediction::unknown()
            };
        }
        // Floor e: a share of the weight that the filters cannot rule out, spread uniformly over
        // the K nodes.
        let floor = (out[k + 5] + INITIAL_LOG_FLOOR).exp() / token.posterior.len() as f32;
        let factors = knot_weights(token.posterior.len())
            .into_iter()
            .map(|(knot, u)| match out[..k].get(knot + 1) {
                Some(next) => out[knot] * (1.0 - u) + next * u,
                None => out[knot],
            });
        let mut posterior = token.posterior.clone();
        if self.config.two_filters {
            let share = 1.0 / (1.0 + (-out[k + 6]).exp());
            posterior
                .iter_mut()
                .zip(&token.posterior_frictionless)
                .for_each(|(b, frictionless)| *b += (frictionless - *b) * share);
        }
        let mut weights: Vec<f32> = factors
            .zip(&posterior)
            .map(|(f, b)| f + (b + floor).ln())
            .collect();
        // Softmax, the maximum subtracted against overflow.
        let max = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        weights.iter_mut().for_each(|w| *w = (*w - max).exp());
        let total: f32 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        let mean = |of: &[[f32; 3]]| -> Vector3<f32> {
            let each = weights.iter().zip(of);
            each.map(|(w, v)| Vector3::from(*v) * *w).sum()
        };
        let (place, normal) = (mean(&token.points_mm), mean(&token.normals));
        // Second moment of the posterior on the curve, widened by the calibrated factor of its
        // spread.
        let mut covariance = Matrix3::zeros();
        for (w, p) in weights.iter().zip(&token.points_mm) {
            let off = Vector3::from(*p) - place;
            covariance += (off * *w) * off.transpose();
        }
        covariance += Matrix3::identity() * MIN_SD_MM * MIN_SD_MM;
        let factors = &self.sd_factors[usize::from(base_known)];
        let factor = factors.at(f64::from(covariance.trace()).sqrt()).powi(2) as f32;
        Prediction {
            contact,
            several,
            point_mm: [0, 1, 2].map(|i| place[i] + off[i]),
            covariance_mm2: (covariance.transpose() * factor).into(),
            weights,
            normal: (normal / normal.norm().max(1e-6)).into(),
        }
    }
}

/// Standard deviation added for errors that the curve's nodes do not represent, mm.
const MIN_SD_MM: f32 = 0.1;

/// The stream of one whisker.
#[derive(Debug, Clone)]
pub struct TrackerStream<'a> {
    tracker: &'a Tracker,
    features: FeatureExtractor<'a>,
    cache: KvCache,
    last_s: Option<f64>,
}

impl TrackerStream<'_> {
    /// The answer at a sample.
    pub fn push(&mut self, sample: &Sample) -> Prediction {
        // No time is known before the first sample: the training's step stands for it.
        let dt_s = self.last_s.map_or(SWEEP_STEP_S, |last| sample.t_s - last);
        self.last_s = Some(sample.t_s);
        let token = self
            .features
            .push(dt_s, sample.moment_nmm, sample.base_mm_s);
        let Tracker { config, net, .. } = self.tracker;
        let out = net.step(&token.inputs, sample.t_s, config.context, &mut self.cache);
        self.tracker
            .answer(&token, &out, sample.base_mm_s.is_some())
    }
}

/// Shortest and longest time between samples that a network was trained with, s, from the factors
/// of its training.
pub fn trained_steps_s(time_factor: [f64; 2]) -> [f64; 2] {
    time_factor.map(|f| f * SWEEP_STEP_S)
}
