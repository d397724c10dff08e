//! Training: windows of courses with what a bench adds to them, early stop on held-out objects, taken up again where it stopped.

use crate::bayes::{BayesSettings, Filters};
use crate::model_file::put_weights;
use crate::network::{NetworkConfig, WhiskerNet};
use crate::{Course, StaticInverse, TrackError};
use burn::module::Module;
use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_mujoco::Mesh;
use window::{Window, Windows};

mod bench;
mod checkpoint;
mod loss;
mod window;

pub(crate) use bench::{Bench, between};
pub(crate) use loss::PLACE_MM;
use loss::loss;

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
    /// Passes for which windows are drawn once: what the bench adds is costly to make (the filter runs over it), not to learn from.
    pub reuse: usize,
    /// Share of the courses for which the base's speed is given.
    pub speed_known: f64,
    /// Bounds of the factor on time (the wire is quasi-static: a faster sweep is the same one in less time).
    pub time_factor: [f64; 2],
    /// Largest noise of a moment, N mm (small ones are drawn more often), gain error, and drift, N mm/s.
    pub noise_nmm: f64,
    /// See `noise_nmm`.
    pub gain: f64,
    /// See `noise_nmm`.
    pub drift_nmm_s: f64,
    /// Whether half of the courses, others in each pass, are taken as their mirror images, where the free wire lies in a plane.
    #[serde(default)]
    pub mirror: bool,
    /// What the filter below the network assumes; models of before it was written down had the default one.
    #[serde(default)]
    pub filter: BayesSettings,
    /// A second one, which the network weighs against it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter_beside: Option<BayesSettings>,
    /// Seed of all draws.
    pub seed: u64,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            epochs: 20,
            batch: 16,
            window: 128,
            rate: 1.5e-3,
            patience: 8,
            reuse: 5,
            speed_known: 0.7,
            time_factor: [0.4, 1.5],
            noise_nmm: 0.006,
            gain: 0.005,
            drift_nmm_s: 0.0004,
            mirror: true,
            filter: BayesSettings::dragged(),
            filter_beside: Some(BayesSettings::default()),
            seed: 1,
        }
    }
}

impl TrainSettings {
    /// The filters below the network.
    #[must_use]
    pub fn filters(&self) -> Filters {
        Filters { first: self.filter, beside: self.filter_beside }
    }

    /// Courses as the twin made them.
    fn as_it_is(&self) -> Self {
        Self { noise_nmm: 0.0, gain: 0.0, drift_nmm_s: 0.0, time_factor: [1.0; 2], ..*self }
    }
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
    /// RMSE to the surface, mm, where the objects' meshes were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out_surface_mm: Option<f64>,
    /// Seconds since the beginning.
    pub seconds: f64,
}

/// Courses by their use.
#[derive(Debug, Clone, Copy)]
pub struct Material<'a> {
    /// Trained on.
    pub courses: &'a [Course],
    /// Early stop.
    pub held_out: &'a [Course],
    /// Curve of candidates.
    pub inverse: &'a StaticInverse,
    /// The objects' meshes: where all of them are there, the answer is trained to lie on the surface, too.
    pub meshes: &'a BTreeMap<String, Mesh>,
    /// Folder of a model with whose weights to begin.
    pub from: Option<&'a Path>,
}

/// Where a training stands after a pass.
struct State {
    net: WhiskerNet,
    best: WhiskerNet,
    optimizer: ModuleOptimizer,
    passes: Vec<Pass>,
}

/// Trains a network and gives the best one on the held-out objects, with the learning curve; `heard` gets every pass. With a folder it
/// is taken up again where it stopped.
///
/// # Errors
/// Where the sizes do not fit, there is nothing to train on, or what the folder holds belongs to another training.
pub fn train(
    config: &NetworkConfig,
    settings: &TrainSettings,
    material: &Material<'_>,
    folder: Option<&Path>,
    device: &Device,
    mut heard: impl FnMut(&Pass),
) -> Result<(WhiskerNet, Vec<Pass>), TrackError> {
    let Material { courses, held_out, inverse, meshes, from } = *material;
    if courses.is_empty() || held_out.is_empty() {
        return Err(TrackError::value("training", "courses to train on and to hold out", "none"));
    }
    config.check_filters(&settings.filters())?;
    let learning = device.clone().autodiff();
    learning.seed(settings.seed);
    let mut net = WhiskerNet::new(config, &learning)?;
    // What goes on from another training draws anew: the same noise again would be learnt by heart.
    let mut seed = settings.seed;
    if let Some(folder) = from {
        seed ^= put_weights(&mut net, folder)?;
    }
    let optimizer = AdamWConfig::new().with_weight_decay(1e-3).init();
    let mut state = State { best: net.valid(), net, optimizer, passes: Vec::new() };
    if let Some(folder) = folder {
        state = checkpoint::resume(folder, config, settings, state)?;
    }
    let batches = courses.len().div_ceil(settings.batch);
    let before_s = state.passes.last().map_or(0.0, |p| p.seconds);
    let begin = std::time::Instant::now();
    let made = Windows { config, inverse, meshes };
    let held_out = made.of(held_out, &settings.as_it_is(), settings.seed);
    let mut drawn: (usize, Vec<Window<'_>>) = (0, Vec::new());
    while !finished(&state.passes, settings) {
        let epoch = state.passes.len() + 1;
        let draw = (epoch - 1) / settings.reuse.max(1) + 1;
        if drawn.0 != draw {
            drawn = (draw, made.of(courses, settings, seed ^ (draw as u64) << 20));
        }
        if settings.mirror && inverse.flat {
            mirror_half(&mut drawn.1, seed ^ (epoch as u64) << 40);
        }
        let mut order: Vec<usize> = (0..courses.len()).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed ^ (epoch as u64) << 32));
        let mut sum = 0.0;
        for (k, batch) in order.chunks(settings.batch).enumerate() {
            let number = (epoch - 1) * batches + k;
            let windows: Vec<&Window<'_>> = batch.iter().map(|c| &drawn.1[*c]).collect();
            let loss = loss(&state.net, config, &windows, &learning).loss;
            sum += f64::from(loss.clone().into_scalar::<f32>());
            let gradients = GradientsParams::from_grads(loss.backward(), &state.net);
            let rate = learning_rate(settings.rate, number as f64 / (settings.epochs * batches) as f64);
            state.net = state.optimizer.step(rate, state.net, gradients);
        }
        let valid = state.net.valid();
        let (held_out_loss, held_out_mm, held_out_surface_mm) =
            evaluate(&valid, config, settings.batch, &held_out, device);
        let seconds = before_s + begin.elapsed().as_secs_f64();
        let loss = sum / batches as f64;
        let pass = Pass { epoch, loss, held_out_loss, held_out_mm, held_out_surface_mm, seconds };
        if best(&state.passes).is_none_or(|b| held_out_loss < b.held_out_loss) {
            state.best = valid;
        }
        state.passes.push(pass);
        heard(&pass);
        if let Some(folder) = folder {
            checkpoint::keep(folder, config, settings, &state)?;
        }
    }
    Ok((state.best, state.passes))
}

/// Half of the windows as mirror images, the others as they are.
fn mirror_half(windows: &mut [Window<'_>], seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for window in windows {
        if window.mirrored != rng.random::<bool>() {
            window.mirror();
        }
    }
}

/// The pass with the least loss on the held-out objects.
#[must_use]
pub fn best(passes: &[Pass]) -> Option<&Pass> {
    passes.iter().min_by(|a, b| a.held_out_loss.total_cmp(&b.held_out_loss))
}

fn finished(passes: &[Pass], settings: &TrainSettings) -> bool {
    let stalled = best(passes).is_some_and(|b| passes.len() - b.epoch >= settings.patience);
    passes.len() >= settings.epochs || stalled
}

/// Warm-up over a twentieth, then half a cosine.
fn learning_rate(most: f64, done: f64) -> f64 {
    let rise = (done / 0.05).min(1.0);
    most * rise * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()) + 1e-6
}

/// Mean loss, and RMSE (mm) of the true contact and, where the meshes are known, to the surface.
fn evaluate(
    net: &WhiskerNet,
    config: &NetworkConfig,
    batch: usize,
    all: &[Window<'_>],
    device: &Device,
) -> (f64, f64, Option<f64>) {
    let (mut sum, mut squares, mut on_surface, mut count, mut batches) = (0.0, 0.0, Some(0.0), 0.0, 0.0);
    let total = |t: Tensor<1>| f64::from(t.sum().into_scalar::<f32>());
    for windows in all.chunks(batch) {
        let windows: Vec<&Window<'_>> = windows.iter().collect();
        let lost = loss(net, config, &windows, device);
        sum += f64::from(lost.loss.into_scalar::<f32>());
        batches += 1.0;
        squares += total(lost.contact);
        on_surface = on_surface.zip(lost.surface).map(|(s, t)| s + total(t));
        count += windows.iter().flat_map(|w| &w.touching).map(|t| f64::from(*t)).sum::<f64>();
    }
    let rmse = |squares: f64| (squares / f64::max(count, 1.0)).sqrt();
    (sum / f64::max(batches, 1.0), rmse(squares), on_surface.map(rmse))
}
