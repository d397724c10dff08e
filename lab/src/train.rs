//! Training: windows of series with what a sensor adds to them, early stop on held-out objects,
//! resumed where it stopped.
//!
//! AdamW (I. Loshchilov, F. Hutter, ICLR 2019; weight decay 1e-3) with the rate
//! `r(x) = r_max min(x / 0.05, 1) (1 + cos pi x) / 2`, x the part of all steps that is done. The
//! kept network is that of the pass with the least loss on the held-out objects.

use crate::LabError;
use crate::dataset::process_s;
use crate::model_file::put_weights;
use crate::network::TrainableNet;
use crate::sweep_series::SweepSeries;
use burn::module::Module;
use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Device, Tensor};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_mesh::Mesh;
use wcal_network::inverse::StaticInverse;
use wcal_network::network::NetworkConfig;
use window::{Window, WindowMaker};

mod checkpoint;
mod loss;
mod sensor_errors;
pub(crate) mod settings;
mod window;

use checkpoint::State;
use loss::loss;
pub(crate) use sensor_errors::{SensorErrors, uniform};
pub use settings::{Pass, TRAINING_RANGES, TrainSettings, best};

/// Sweep series by their use.
#[derive(Debug, Clone, Copy)]
pub struct TrainingData<'a> {
    /// Trained on.
    pub all_series: &'a [SweepSeries],
    /// Early stop.
    pub held_out: &'a [SweepSeries],
    /// Curve of solutions.
    pub inverse: &'a StaticInverse,
    /// The objects' meshes: where all of them are there, the answer is trained to lie on the
    /// surface, too.
    pub meshes: &'a BTreeMap<String, Mesh>,
    /// Folder of a model with whose weights to begin.
    pub from: Option<&'a Path>,
}

/// Trains a network and gives the best one on the held-out objects, with the learning curve;
/// `on_pass` gets every pass. With a folder it is taken up again where it stopped.
///
/// # Errors
/// Where the sizes do not fit, there is nothing to train on, or what the folder holds belongs to
/// another training.
pub fn train(
    config: &NetworkConfig,
    settings: &TrainSettings,
    material: &TrainingData<'_>,
    folder: Option<&Path>,
    device: &Device,
    mut on_pass: impl FnMut(&Pass),
) -> Result<(TrainableNet, Vec<Pass>), LabError> {
    let TrainingData {
        all_series,
        held_out,
        inverse,
        meshes,
        from,
    } = *material;
    if all_series.is_empty() || held_out.is_empty() {
        return Err(LabError::value(
            "training",
            "series to train on and to hold out",
            "none",
        ));
    }
    config.check_filters(&settings.filters())?;
    let learning = device.clone().autodiff();
    learning.seed(settings.seed);
    let mut net = TrainableNet::new(config, &learning)?;
    // A continued training draws from another seed: the same noise again would be memorised.
    let mut seed = settings.seed;
    if let Some(folder) = from {
        seed ^= put_weights(&mut net, folder)?;
    }
    let optimizer = AdamWConfig::new().with_weight_decay(1e-3).init();
    let mut state = State {
        best: net.valid(),
        net,
        optimizer,
        passes: Vec::new(),
    };
    if let Some(folder) = folder {
        state = checkpoint::resume(folder, config, settings, state)?;
    }
    let batches = all_series.len().div_ceil(settings.batch);
    let before = state
        .passes
        .last()
        .map_or([0.0; 2], |p| [p.seconds, p.cpu_s.unwrap_or(0.0)]);
    let (begin, begin_cpu_s) = (std::time::Instant::now(), process_s());
    let maker = WindowMaker {
        config,
        inverse,
        meshes,
    };
    let held_out = maker.make(held_out, &settings.without_disturbances(), settings.seed);
    let mut windows: (usize, Vec<Window<'_>>) = (0, Vec::new());
    while !finished(&state.passes, settings) {
        let epoch = state.passes.len() + 1;
        let draw = (epoch - 1) / settings.passes_per_draw.max(1) + 1;
        if windows.0 != draw {
            windows = (
                draw,
                maker.make(all_series, settings, seed ^ (draw as u64) << 20),
            );
        }
        if settings.mirror && inverse.flat {
            mirror_half(&mut windows.1, seed ^ (epoch as u64) << 40);
        }
        let mut order: Vec<usize> = (0..all_series.len()).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed ^ (epoch as u64) << 32));
        let mut sum = 0.0;
        for (k, batch) in order.chunks(settings.batch).enumerate() {
            let number = (epoch - 1) * batches + k;
            let of_batch: Vec<&Window<'_>> = batch.iter().map(|c| &windows.1[*c]).collect();
            let loss = loss(&state.net, config, &of_batch, &learning).loss;
            sum += f64::from(loss.clone().into_scalar::<f32>());
            let gradients = GradientsParams::from_grads(loss.backward(), &state.net);
            let rate = learning_rate(
                settings.rate,
                number as f64 / (settings.epochs * batches) as f64,
            );
            state.net = state.optimizer.step(rate, state.net, gradients);
        }
        let valid = state.net.valid();
        let (held_out_loss, held_out_mm, held_out_surface_mm) =
            evaluate(&valid, config, settings.batch, &held_out, device);
        let seconds = before[0] + begin.elapsed().as_secs_f64();
        let cpu_s = Some(before[1] + process_s() - begin_cpu_s);
        let loss = sum / batches as f64;
        let pass = Pass {
            epoch,
            loss,
            held_out_loss,
            held_out_mm,
            held_out_surface_mm,
            seconds,
            cpu_s,
        };
        if best(&state.passes).is_none_or(|b| held_out_loss < b.held_out_loss) {
            state.best = valid;
        }
        state.passes.push(pass);
        on_pass(&pass);
        if let Some(folder) = folder {
            checkpoint::save(folder, config, settings, &state)?;
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
    net: &TrainableNet,
    config: &NetworkConfig,
    batch: usize,
    all: &[Window<'_>],
    device: &Device,
) -> (f64, f64, Option<f64>) {
    let (mut sum, mut squares, mut on_surface, mut count, mut batches) =
        (0.0, 0.0, Some(0.0), 0.0, 0.0);
    let total = |t: Tensor<1>| f64::from(t.sum().into_scalar::<f32>());
    for windows in all.chunks(batch) {
        let of_batch: Vec<&Window<'_>> = windows.iter().collect();
        let lost = loss(net, config, &of_batch, device);
        sum += f64::from(lost.loss.into_scalar::<f32>());
        batches += 1.0;
        squares += total(lost.contact);
        on_surface = on_surface.zip(lost.surface).map(|(s, t)| s + total(t));
        count += of_batch
            .iter()
            .flat_map(|w| &w.touching)
            .map(|t| f64::from(*t))
            .sum::<f64>();
    }
    let rmse = |squares: f64| (squares / f64::max(count, 1.0)).sqrt();
    (
        sum / f64::max(batches, 1.0),
        rmse(squares),
        on_surface.map(rmse),
    )
}
