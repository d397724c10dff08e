//! Training: windows of courses with what a bench adds to them, early stop on held-out objects.

use crate::network::model::attention_bias;
use crate::network::{FeatureMaker, NetworkConfig, WhiskerNet};
use crate::{Course, StaticInverse, TrackError};
use burn::module::Module;
use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::activation::{log_sigmoid, log_softmax};
use burn::tensor::{Device, Tensor, TensorData};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a network is trained.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainSettings {
    /// Passes over the courses at most.
    pub epochs: usize,
    /// Courses in a batch, and tokens of each.
    pub batch: usize,
    /// See `batch`.
    pub window: usize,
    /// Largest learning rate; it rises over the first part and falls to nothing along a half cosine.
    pub rate: f64,
    /// Passes without progress on the held-out objects after which training stops.
    pub patience: usize,
    /// Share of the courses for which the base's speed is given.
    pub speed_known: f64,
    /// Bounds of the factor on time (the wire is quasi-static: a faster sweep is the same one in less time).
    pub time_factor: [f64; 2],
    /// Largest noise of a moment, N mm, gain error, and drift, N mm/s.
    pub noise_nmm: f64,
    /// See `noise_nmm`.
    pub gain: f64,
    /// See `noise_nmm`.
    pub drift_nmm_s: f64,
    /// Seed of all draws.
    pub seed: u64,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            epochs: 20,
            batch: 16,
            window: 128,
            rate: 2e-3,
            patience: 4,
            speed_known: 0.7,
            time_factor: [0.4, 1.5],
            noise_nmm: 0.002,
            gain: 0.005,
            drift_nmm_s: 0.0002,
            seed: 1,
        }
    }
}

/// A window of a course, ready for the network.
struct Window {
    inputs: Vec<f32>,
    times_s: Vec<f64>,
    /// Candidates' places, a token and node, mm.
    points: Vec<f32>,
    /// Weights of the nodes that mean the true place.
    weights: Vec<f32>,
    /// True place, mm; what no token has is 0 and not counted.
    place: Vec<f32>,
    touching: Vec<f32>,
    counted: Vec<f32>,
}

/// One pass in the learning curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pass {
    /// Number, from 1.
    pub epoch: usize,
    /// Mean loss of training.
    pub loss: f64,
    /// On the held-out objects: loss, and RMSE of the true contact, mm.
    pub held_out_loss: f64,
    /// See `held_out_loss`.
    pub held_out_mm: f64,
    /// Seconds since the beginning.
    pub seconds: f64,
}

/// Trains a network; `heard` gets every pass and the network after it, and says whether to go on.
///
/// # Errors
/// Where the sizes do not fit or there is nothing to train on.
pub fn train(
    config: &NetworkConfig,
    settings: &TrainSettings,
    inverse: &StaticInverse,
    courses: &[Course],
    held_out: &[Course],
    device: &Device,
    mut heard: impl FnMut(&Pass, &WhiskerNet) -> bool,
) -> Result<WhiskerNet, TrackError> {
    if courses.is_empty() || held_out.is_empty() {
        return Err(TrackError::value("training", "courses to train on and to hold out", "none"));
    }
    let begin = std::time::Instant::now();
    let learning = device.clone().autodiff();
    learning.seed(settings.seed);
    let mut net = WhiskerNet::new(config, &learning)?;
    let mut best = (f64::INFINITY, net.valid(), 0);
    let mut optimizer = AdamWConfig::new().with_weight_decay(1e-3).init();
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut order: Vec<usize> = (0..courses.len()).collect();
    let batches = courses.len().div_ceil(settings.batch);
    for epoch in 1..=settings.epochs {
        order.shuffle(&mut rng);
        let mut sum = 0.0;
        for (k, batch) in order.chunks(settings.batch).enumerate() {
            let done = ((epoch - 1) * batches + k) as f64 / (settings.epochs * batches) as f64;
            let draw = settings.seed.wrapping_mul(0x9E37_79B9).wrapping_add((epoch * batches + k) as u64);
            let chosen: Vec<&Course> = batch.iter().map(|c| &courses[*c]).collect();
            let windows = windows(&chosen, inverse, settings, Some(draw));
            let (loss, _) = loss(&net, config, &windows, &learning);
            sum += f64::from(loss.clone().into_scalar::<f32>());
            let gradients = GradientsParams::from_grads(loss.backward(), &net);
            net = optimizer.step(learning_rate(settings.rate, done), net, gradients);
        }
        let valid = net.valid();
        let (held_out_loss, held_out_mm) = evaluate(&valid, config, settings, inverse, held_out, device);
        let pass = Pass {
            epoch,
            loss: sum / batches as f64,
            held_out_loss,
            held_out_mm,
            seconds: begin.elapsed().as_secs_f64(),
        };
        if held_out_loss < best.0 {
            best = (held_out_loss, valid, epoch);
        }
        if !heard(&pass, &best.1) || epoch - best.2 >= settings.patience {
            break;
        }
    }
    Ok(best.1)
}

/// Warm-up over a twentieth, then half a cosine.
fn learning_rate(most: f64, done: f64) -> f64 {
    let rise = (done / 0.05).min(1.0);
    most * rise * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()) + 1e-6
}

/// Mean loss and RMSE of the true contact (mm) over courses as they are.
fn evaluate(
    net: &WhiskerNet,
    config: &NetworkConfig,
    settings: &TrainSettings,
    inverse: &StaticInverse,
    courses: &[Course],
    device: &Device,
) -> (f64, f64) {
    let (mut sum, mut squares, mut count, mut batches) = (0.0, 0.0, 0.0, 0.0);
    for (k, batch) in courses.chunks(settings.batch).enumerate() {
        let chosen: Vec<&Course> = batch.iter().collect();
        let quiet =
            TrainSettings { noise_nmm: 0.0, gain: 0.0, drift_nmm_s: 0.0, time_factor: [1.0; 2], ..*settings };
        let windows = windows(&chosen, inverse, &quiet, Some(k as u64));
        let (loss, off) = loss(net, config, &windows, device);
        sum += f64::from(loss.into_scalar::<f32>());
        batches += 1.0;
        squares += f64::from(off.sum().into_scalar::<f32>());
        count += windows.iter().flat_map(|w| &w.touching).map(|t| f64::from(*t)).sum::<f64>();
    }
    (sum / f64::max(batches, 1.0), (squares / f64::max(count, 1.0)).sqrt())
}

/// Loss of a batch, and squared distances to the true contact where there is one, mm^2 (`[batch * time]`).
fn loss(
    net: &WhiskerNet,
    config: &NetworkConfig,
    windows: &[Window],
    device: &Device,
) -> (Tensor<1>, Tensor<1>) {
    let (batch, time) = (windows.len(), windows[0].times_s.len());
    let n = batch * time;
    let gather = |values: fn(&Window) -> &Vec<f32>, shape: [usize; 3]| {
        let all: Vec<f32> = windows.iter().flat_map(|w| values(w).iter().copied()).collect();
        Tensor::<3>::from_data(TensorData::new(all, shape), device)
    };
    let flat = |values: fn(&Window) -> &Vec<f32>| gather(values, [n, 1, 1]).reshape([n]);
    let times: Vec<Vec<f64>> = windows.iter().map(|w| w.times_s.clone()).collect();
    let bias = attention_bias(&times, config.heads, config.context, device);
    let out = net.forward(gather(|w| &w.inputs, [batch, time, config.inputs]), bias);
    let out = out.reshape([n, config.outputs()]);
    let (touching, counted) = (flat(|w| &w.touching), flat(|w| &w.counted));
    let place = gather(|w| &w.place, [n, 1, 3]).reshape([n, 3]);
    let off_curve = out.clone().narrow(1, config.nodes, 3);
    let logit = out.clone().narrow(1, config.nodes + 3, 1).reshape([n]);
    let held = touching.clone() * counted.clone();
    let many = held.clone().sum() + 1.0;
    let (mean, choice) = if config.nodes == 0 {
        (off_curve * PLACE_MM, Tensor::zeros([1], device))
    } else {
        let k = config.nodes;
        let log_weights = log_softmax(out.narrow(1, 0, k), 1);
        let truth = gather(|w| &w.weights, [n, 1, k]).reshape([n, k]);
        let choice = -(log_weights.clone() * truth).sum_dim(1).reshape([n]) * held.clone();
        let points = gather(|w| &w.points, [n, k, 3]);
        let mean = (log_weights.exp().reshape([n, k, 1]) * points).sum_dim(1).reshape([n, 3]);
        (mean + off_curve, choice.sum() / many.clone())
    };
    let off = (mean - place).square().sum_dim(1).reshape([n]) * held.clone();
    // Square near the truth, straight far off: a sprung contact does not drown the rest.
    let place_loss = ((off.clone() / 4.0 + 1.0).sqrt() - 1.0).sum() / many;
    let contact = -(log_sigmoid(logit.clone()) * touching.clone() + log_sigmoid(-logit) * (-touching + 1.0));
    let contact = (contact * counted.clone()).sum() / (counted.sum() + 1.0);
    (choice + place_loss + contact, off)
}

/// Scale of a place that comes out as it is, mm.
pub(crate) const PLACE_MM: f64 = 30.0;

/// Windows of courses, with what a bench adds; `seed` draws.
fn windows(
    courses: &[&Course],
    inverse: &StaticInverse,
    settings: &TrainSettings,
    seed: Option<u64>,
) -> Vec<Window> {
    courses
        .par_iter()
        .enumerate()
        .map(|(k, course)| {
            let mut rng =
                ChaCha8Rng::seed_from_u64(seed.unwrap_or(0).wrapping_mul(1_000_003).wrapping_add(k as u64));
            window(course, inverse, settings, &mut rng)
        })
        .collect()
}

fn window(
    course: &Course,
    inverse: &StaticInverse,
    settings: &TrainSettings,
    rng: &mut ChaCha8Rng,
) -> Window {
    let mut uniform = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
    let factor = uniform(settings.time_factor[0].ln(), settings.time_factor[1].ln()).exp();
    let noise = settings.noise_nmm * uniform(0.0, 1.0);
    let gain: [f64; 2] = std::array::from_fn(|_| 1.0 + settings.gain * uniform(-1.0, 1.0));
    let drift: [f64; 2] = std::array::from_fn(|_| settings.drift_nmm_s * uniform(-1.0, 1.0));
    let known = uniform(0.0, 1.0) < settings.speed_known;
    let stride = 1 + usize::from(uniform(0.0, 1.0) < 0.3);
    let latest = course.instants.len().saturating_sub(settings.window * stride / 2);
    let first = (uniform(-0.3, 1.0).max(0.0) * latest as f64) as usize;
    let mut features = FeatureMaker::new(inverse);
    let nodes = inverse.nodes.len();
    let t = settings.window;
    let mut made = Window {
        inputs: Vec::with_capacity(t * FeatureMaker::width(nodes)),
        times_s: Vec::with_capacity(t),
        points: Vec::with_capacity(t * nodes * 3),
        weights: Vec::with_capacity(t * nodes),
        place: Vec::with_capacity(t * 3),
        touching: Vec::with_capacity(t),
        counted: Vec::with_capacity(t),
    };
    let mut before_s = None;
    let last = course.instants.len() - 1;
    for k in 0..t {
        let at = first + k * stride;
        let now = &course.instants[at.min(last)];
        // Beyond its end a course goes on without counting.
        let over_s = at.saturating_sub(last) as f64 * 0.1;
        let t_s = (now.t_s + over_s) * factor;
        let moment = [0, 1].map(|i| {
            now.moment_nmm[i] * gain[i] + drift[i] * t_s + noise * 3.0_f64.sqrt() * uniform(-1.0, 1.0)
        });
        let speed = known.then_some(now.speed_mm_s / factor);
        let token = features.push(t_s - before_s.unwrap_or(t_s - crate::stream::FIRST_S), moment, speed);
        before_s = Some(t_s);
        let truth = now.contact.map(|c| [c.point_mm.x, c.point_mm.y, c.point_mm.z].map(|x| x as f32));
        made.weights.extend(match truth {
            Some(p) => truth_weights(&token.points_mm, p),
            None => vec![0.0; nodes],
        });
        made.inputs.extend(token.inputs);
        made.points.extend(token.points_mm.iter().flatten());
        made.times_s.push(t_s);
        made.place.extend(truth.unwrap_or_default());
        made.touching.push(f32::from(u8::from(truth.is_some())));
        made.counted.push(f32::from(u8::from(at <= last)));
    }
    made
}

/// Weights of the two nodes between which the curve comes nearest to a place.
fn truth_weights(points: &[[f32; 3]], place: [f32; 3]) -> Vec<f32> {
    let sub = |a: [f32; 3], b: [f32; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let mut best = (f32::INFINITY, 0, 0.0);
    for k in 0..points.len() - 1 {
        let (along, to) = (sub(points[k + 1], points[k]), sub(place, points[k]));
        let u = (dot(along, to) / dot(along, along).max(1e-12)).clamp(0.0, 1.0);
        let off = sub(to, along.map(|x| x * u));
        let distance = dot(off, off);
        if distance < best.0 {
            best = (distance, k, u);
        }
    }
    let mut weights = vec![0.0; points.len()];
    weights[best.1] = 1.0 - best.2;
    weights[best.1 + 1] = best.2;
    weights
}
