//! Tracks sample by sample, and whole courses at once; both give the same answers.

use crate::bayes::Filters;
use crate::network::model::{attention_bias, numbers};
use crate::network::{
    Attended, COMMON, DOUBT, FeatureMaker, NetworkConfig, Prediction, Token, WhiskerNet, between, knots,
};
use crate::spread::SdFactors;
use crate::{StaticInverse, TrackError};
use burn::tensor::{Device, Tensor, TensorData};

/// A trained network with what it needs to answer.
#[derive(Debug, Clone)]
pub struct Tracker {
    /// Sizes.
    pub config: NetworkConfig,
    /// Layers.
    pub net: WhiskerNet,
    /// Curve of candidates.
    pub inverse: StaticInverse,
    /// The filters below the network.
    pub filters: Filters,
    /// Factors on the stated standard deviations: base's speed not known, and known.
    pub sd_factors: [SdFactors; 2],
    /// Where it runs.
    pub device: Device,
}

/// One sample: time (s), transverse moments (N mm), speed of the base along +z where it is known (mm/s).
#[derive(Debug, Clone, Copy, PartialEq)]
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
    pub fn check(&self) -> Result<(), TrackError> {
        let nodes = self.inverse.nodes.len();
        let (nodes, width) = (knots(nodes).len(), FeatureMaker::width(nodes, self.config.two_filters));
        self.config.check_filters(&self.filters)?;
        let plain = self.config.inputs == COMMON && self.config.nodes == 0;
        if !plain && (self.config.inputs != width || ![0, nodes].contains(&self.config.nodes)) {
            let found = format!("{} inputs, {} knots", self.config.inputs, self.config.nodes);
            return Err(TrackError::value("network", format!("{width} inputs, {nodes} knots"), found));
        }
        Ok(())
    }

    /// A stream from its beginning.
    #[must_use]
    pub fn stream(&self) -> Stream<'_> {
        self.stream_told(self.filters)
    }

    /// A stream from its beginning whose filters are told of other noise.
    #[must_use]
    pub fn stream_told(&self, filters: Filters) -> Stream<'_> {
        Stream {
            tracker: self,
            features: FeatureMaker::of(&self.config, &self.inverse, filters),
            memory: Attended::default(),
            last_s: None,
        }
    }

    /// All answers of a course in one pass.
    #[must_use]
    pub fn course(&self, samples: &[Sample]) -> Vec<Prediction> {
        self.course_told(self.filters, samples)
    }

    /// The same with the filters told of other noise.
    #[must_use]
    pub fn course_told(&self, filters: Filters, samples: &[Sample]) -> Vec<Prediction> {
        let mut features = FeatureMaker::of(&self.config, &self.inverse, filters);
        let mut last_s = None;
        let tokens: Vec<Token> = samples.iter().map(|s| token(&mut features, &mut last_s, s)).collect();
        if tokens.is_empty() {
            return Vec::new();
        }
        let inputs: Vec<f32> =
            tokens.iter().flat_map(|t| t.inputs[..self.config.inputs].iter().copied()).collect();
        let shape = [1, tokens.len(), self.config.inputs];
        let inputs = Tensor::<3>::from_data(TensorData::new(inputs, shape), &self.device);
        let times = vec![samples.iter().map(|s| s.t_s).collect()];
        let bias = attention_bias(&times, self.config.heads, self.config.context, &self.device);
        let out = numbers(self.net.forward(inputs, bias));
        let both = tokens.iter().zip(samples).zip(out.chunks(self.config.outputs()));
        both.map(|((t, s), o)| self.answer(t, o, s.base_mm_s.is_some())).collect()
    }

    fn answer(&self, token: &Token, out: &[f32], base_known: bool) -> Prediction {
        let k = self.config.nodes;
        let off = &out[k..k + 3];
        let [contact, several] = [k + 3, k + 4].map(|at| 1.0 / (1.0 + (-out[at]).exp()));
        if k == 0 {
            // The paper's head states no spread.
            let point_mm = [0, 1, 2].map(|i| off[i] * crate::train::PLACE_MM as f32);
            return Prediction {
                contact,
                several,
                point_mm,
                covariance_mm2: [[0.0; 3]; 3],
                weights: Vec::new(),
                normal: [0.0; 3],
            };
        }
        let doubt = (out[k + 5] + DOUBT).exp() / token.believed.len() as f32;
        let factors =
            between(token.believed.len()).into_iter().map(|(knot, u)| match out[..k].get(knot + 1) {
                Some(next) => out[knot] * (1.0 - u) + next * u,
                None => out[knot],
            });
        let mut believed = token.believed.clone();
        if self.config.two_filters {
            let share = 1.0 / (1.0 + (-out[k + 6]).exp());
            believed.iter_mut().zip(&token.beside).for_each(|(b, beside)| *b += (beside - *b) * share);
        }
        let mut weights: Vec<f32> = factors.zip(&believed).map(|(f, b)| f + (b + doubt).ln()).collect();
        let most = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        weights.iter_mut().for_each(|w| *w = (*w - most).exp());
        let total: f32 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        let mut mean = [0.0_f32; 3];
        for (w, p) in weights.iter().zip(&token.points_mm) {
            (0..3).for_each(|i| mean[i] += w * p[i]);
        }
        let mut normal = [0.0_f32; 3];
        for (w, n) in weights.iter().zip(&token.normals) {
            (0..3).for_each(|i| normal[i] += w * n[i]);
        }
        let size = normal.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-6);
        let normal = normal.map(|x| x / size);
        let mut covariance = [[0.0; 3]; 3];
        for (w, p) in weights.iter().zip(&token.points_mm) {
            for i in 0..3 {
                for j in 0..3 {
                    covariance[i][j] += w * (p[i] - mean[i]) * (p[j] - mean[j]);
                }
            }
        }
        let mut trace = 0.0;
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] += LEAST_SD_MM * LEAST_SD_MM;
            trace += row[i];
        }
        let factor = self.sd_factors[usize::from(base_known)].at(f64::from(trace).sqrt()).powi(2) as f32;
        covariance.as_flattened_mut().iter_mut().for_each(|x| *x *= factor);
        let point_mm = [0, 1, 2].map(|i| mean[i] + off[i]);
        Prediction { contact, several, point_mm, covariance_mm2: covariance, weights, normal }
    }
}

/// Spread that the curve's nodes do not tell, mm.
const LEAST_SD_MM: f32 = 0.1;

/// The stream of one whisker.
#[derive(Debug, Clone)]
pub struct Stream<'a> {
    tracker: &'a Tracker,
    features: FeatureMaker<'a>,
    memory: Attended,
    last_s: Option<f64>,
}

impl Stream<'_> {
    /// The answer at a sample.
    pub fn push(&mut self, sample: &Sample) -> Prediction {
        let token = token(&mut self.features, &mut self.last_s, sample);
        let config = &self.tracker.config;
        let data = TensorData::new(token.inputs[..config.inputs].to_vec(), [1, 1, config.inputs]);
        let inputs = Tensor::<3>::from_data(data, &self.tracker.device);
        let out = self.tracker.net.step(inputs, sample.t_s, config.context, &mut self.memory);
        self.tracker.answer(&token, &numbers(out), sample.base_mm_s.is_some())
    }
}

fn token(features: &mut FeatureMaker<'_>, last_s: &mut Option<f64>, sample: &Sample) -> Token {
    let dt_s = last_s.map_or(FIRST_S, |last| sample.t_s - last);
    *last_s = Some(sample.t_s);
    features.push(dt_s, sample.moment_nmm, sample.base_mm_s)
}

/// Time step that the first sample is taken to have, s; sweeps are simulated with it.
pub(crate) const FIRST_S: f64 = 0.1;

/// Shortest and longest time between samples that a network was trained with, s, from the factors of its training.
#[must_use]
pub fn trained_steps_s(time_factor: [f64; 2]) -> [f64; 2] {
    time_factor.map(|f| f * FIRST_S)
}
