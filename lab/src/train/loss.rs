//! The loss of training.
//!
//! ```text
//! L = CE(w, w*) + mean H(|p - c|^2; 2 mm) + 16 mean H(|p - q|^2; 2 mm) + CE(contact) + CE(several)
//! H(e^2; a) = sqrt(1 + e^2 / a^2) - 1                                                            pseudo-Huber
//! ```
//!
//! over the samples with contact: w the weights of the nodes, w* those of the true place between
//! its two neighbours, c the true contact, q the point of the object's surface nearest to the
//! answer p (held fixed: the gradient of the distance is the same), CE the cross entropy. Source of
//! H: P. Charbonnier et al., IEEE Trans. Image Processing 6 (1997) 298.

use super::window::Window;
use crate::network::{TrainableNet, attention_bias};
use burn::tensor::activation::{log_sigmoid, log_softmax, sigmoid};
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Vector3;
use rayon::prelude::*;
use wcal_network::network::{INITIAL_LOG_FLOOR, NetworkConfig, PLACE_SCALE_MM, knot_weights};

/// Errors above which the loss is linear instead of quadratic, mm: to the true contact, and to the
/// surface.
const PSEUDO_HUBER_MM: [f64; 2] = [2.0, 2.0];
/// Weight of the distance to the surface.
const SURFACE_WEIGHT: f64 = 16.0;

/// Loss of a batch and squared errors, mm^2 (`[batch * time]`, 0 where there is no contact).
pub(super) struct LossTerms {
    pub loss: Tensor<1>,
    /// To the true contact.
    pub contact: Tensor<1>,
    /// To the object's surface, where its mesh is known.
    pub surface: Option<Tensor<1>>,
}

/// Values of a window at each token.
type Values = for<'w, 'a> fn(&'w Window<'a>) -> &'w Vec<f32>;

/// The network on a batch of windows.
pub(super) fn loss(
    net: &TrainableNet,
    config: &NetworkConfig,
    windows: &[&Window<'_>],
    device: &Device,
) -> LossTerms {
    let (batch, time) = (windows.len(), windows[0].times_s.len());
    let n = batch * time;
    let gather = |values: Values, shape: [usize; 3]| {
        let all: Vec<f32> = windows
            .iter()
            .flat_map(|w| values(w).iter().copied())
            .collect();
        Tensor::<3>::from_data(TensorData::new(all, shape), device)
    };
    let flat = |values: Values| gather(values, [n, 1, 1]).reshape([n]);
    let times: Vec<Vec<f64>> = windows.iter().map(|w| w.times_s.clone()).collect();
    let bias = attention_bias(&times, config.heads, config.context, device);
    let inputs = gather(|w| &w.inputs, [batch, time, config.inputs]);
    let out = net.forward(inputs, bias);
    let out = out.reshape([n, config.outputs()]);
    let (touching, counted) = (flat(|w| &w.touching), flat(|w| &w.counted));
    let place = gather(|w| &w.place, [n, 1, 3]).reshape([n, 3]);
    let off_curve = out.clone().narrow(1, config.nodes, 3);
    let logit = out.clone().narrow(1, config.nodes + 3, 1).reshape([n]);
    let several = out.clone().narrow(1, config.nodes + 4, 1).reshape([n]);
    let held = touching.clone() * counted.clone();
    let many = held.clone().sum() + 1.0;
    let (mean, choice) = if config.nodes == 0 {
        (off_curve * PLACE_SCALE_MM, Tensor::zeros([1], device))
    } else {
        let k = windows[0].points.len() / (3 * time);
        let floor =
            (out.clone().narrow(1, config.nodes + 5, 1) + INITIAL_LOG_FLOOR).exp() / k as f32;
        let mut posterior = gather(|w| &w.posterior, [n, 1, k]).reshape([n, k]);
        if config.two_filters {
            let frictionless = gather(|w| &w.posterior_frictionless, [n, 1, k]).reshape([n, k]);
            let share = sigmoid(out.clone().narrow(1, config.nodes + 6, 1));
            posterior = posterior.clone() + (frictionless - posterior) * share;
        }
        let factors = out
            .narrow(1, 0, config.nodes)
            .matmul(hat_functions(config.nodes, k, device));
        let log_weights = log_softmax(factors + (posterior + floor).log(), 1);
        let truth = gather(|w| &w.weights, [n, 1, k]).reshape([n, k]);
        let choice = -(log_weights.clone() * truth).sum_dim(1).reshape([n]) * held.clone();
        let points = gather(|w| &w.points, [n, k, 3]);
        let mean = (log_weights.exp().reshape([n, k, 1]) * points)
            .sum_dim(1)
            .reshape([n, 3]);
        (mean + off_curve, choice.sum() / many.clone())
    };
    let squared =
        |to: Tensor<2>| (mean.clone() - to).square().sum_dim(1).reshape([n]) * held.clone();
    // Quadratic near the truth, linear far from it: a contact that jumped does not dominate the
    // mean.
    let robust = |off: &Tensor<1>, straight_mm: f64| {
        ((off.clone() / straight_mm.powi(2) + 1.0).sqrt() - 1.0).sum() / many.clone()
    };
    let contact = squared(place);
    let mut total = choice + robust(&contact, PSEUDO_HUBER_MM[0]);
    // The nearest point of the surface counts as fixed: the gradient of the distance is the same.
    let surface = nearest_on_surfaces(windows, &mean, device).map(squared);
    if let Some(off) = &surface {
        total = total + robust(off, PSEUDO_HUBER_MM[1]) * SURFACE_WEIGHT;
    }
    let cross = |logit: Tensor<1>, truth: Tensor<1>| {
        -(log_sigmoid(logit.clone()) * truth.clone() + log_sigmoid(-logit) * (-truth + 1.0))
    };
    let called = (cross(logit, touching) * counted.clone()).sum() / (counted.sum() + 1.0);
    let several = (cross(several, flat(|w| &w.several)) * held).sum() / many;
    LossTerms {
        loss: total + called + several,
        contact,
        surface,
    }
}

/// The surface's points nearest to the answers, `[batch * time, 3]`; the answer itself where there
/// is no contact. None where a mesh is not known.
fn nearest_on_surfaces(
    windows: &[&Window<'_>],
    answers: &Tensor<2>,
    device: &Device,
) -> Option<Tensor<2>> {
    let time = windows[0].times_s.len();
    if windows.iter().any(|w| w.mesh.is_none()) {
        return None;
    }
    let mut points: Vec<f32> = answers.clone().detach().into_data().try_to_vec().ok()?;
    points
        .par_chunks_mut(3)
        .enumerate()
        .for_each(|(row, point)| {
            let (window, k) = (windows[row / time], row % time);
            if let (Some(mesh), true) = (window.mesh, window.touching[k] * window.counted[k] > 0.0)
            {
                let side = Vector3::new(1.0, if window.mirrored { -1.0 } else { 1.0 }, 1.0);
                let at = Vector3::new(point[0], point[1], point[2])
                    .map(f64::from)
                    .component_mul(&side);
                let near = window
                    .series
                    .closest_surface_point(mesh, window.travel_mm[k], &at)
                    .component_mul(&side);
                point
                    .iter_mut()
                    .zip(near.iter())
                    .for_each(|(p, q)| *p = *q as f32);
            }
        });
    let shape = [windows.len() * time, 3];
    Some(Tensor::from_data(TensorData::new(points, shape), device))
}

/// Linear interpolation from knots to nodes, `[knots, nodes]`.
fn hat_functions(knots: usize, nodes: usize, device: &Device) -> Tensor<2> {
    let mut hat_functions = vec![0.0_f32; knots * nodes];
    for (node, (k, u)) in knot_weights(nodes).into_iter().enumerate() {
        hat_functions[k * nodes + node] += 1.0 - u;
        if k + 1 < knots {
            hat_functions[(k + 1) * nodes + node] += u;
        }
    }
    Tensor::from_data(TensorData::new(hat_functions, [knots, nodes]), device)
}

#[cfg(test)]
mod tests {
    use super::super::settings::TrainSettings;
    use super::super::window::WindowMaker;
    use super::super::window::tests::swept;
    use super::*;
    use crate::evaluate::track_series;
    use crate::model_file::{preset, runnable};
    use std::collections::BTreeMap;
    use wcal_lab_sweeps::objects;
    use wcal_network::sd_factors::SdFactors;
    use wcal_network::tracker::{Sample, Tracker};

    /// What a training makes small is the error of what a stream answers, with one filter below the
    /// network and with two.
    #[test]
    fn training_and_answers_agree() {
        let (inverse, all_series) = swept("can");
        let device = Device::flex();
        device.seed(7);
        for two_filters in [true, false] {
            let usual = TrainSettings {
                window: 64,
                ..TrainSettings::default()
            }
            .without_disturbances();
            let frictionless = usual.filter_frictionless.filter(|_| two_filters);
            let settings = TrainSettings {
                filter_frictionless: frictionless,
                ..usual
            };
            let config = preset("compact", &inverse, two_filters).unwrap();
            let net = TrainableNet::new(&config, &device).unwrap();
            let meshes = BTreeMap::new();
            let windows = WindowMaker {
                config: &config,
                inverse: &inverse,
                meshes: &meshes,
            };
            let window = &windows.make(&all_series, &settings, 5)[0];
            let lost: Vec<f32> = loss(&net, &config, &[window], &device)
                .contact
                .into_data()
                .try_to_vec()
                .unwrap();
            let width = window.inputs.len() / window.times_s.len();
            let samples: Vec<Sample> = window
                .inputs
                .chunks(width)
                .zip(&window.times_s)
                .map(|(x, t_s)| Sample {
                    t_s: *t_s,
                    moment_nmm: [x[0], x[1]].map(|m| f64::from(m) * 0.5),
                    base_mm_s: (x[7] > 0.5).then_some(f64::from(x[8]) * 5.0),
                })
                .collect();
            let sd_factors = [1.0; 2].map(SdFactors::constant);
            let inverse = inverse.clone();
            let filters = settings.filters();
            let net = runnable(&net, &config).unwrap().0;
            let tracker = Tracker {
                config,
                net,
                inverse,
                filters,
                sd_factors,
            };
            let mut touching = 0;
            for (k, answer) in track_series(&tracker, filters, &samples)
                .iter()
                .enumerate()
                .filter(|(k, _)| lost[*k] > 0.0)
            {
                let off: f32 = (0..3)
                    .map(|i| (answer.point_mm[i] - window.place[3 * k + i]).powi(2))
                    .sum();
                assert!(
                    (off.sqrt() - lost[k].sqrt()).abs() < 2e-3,
                    "{k}: {off} {}",
                    lost[k]
                );
                touching += 1;
            }
            assert!(touching > 20, "{touching}");
        }
    }

    /// The surface of a mirrored window is the object's mirror image.
    #[test]
    fn a_mirrored_answer_has_a_mirrored_nearest_point() {
        let (inverse, all_series) = swept("vase");
        let config = preset("compact", &inverse, true).unwrap();
        let meshes = BTreeMap::from([("vase".to_owned(), objects::built_in("vase").unwrap())]);
        let windows = WindowMaker {
            config: &config,
            inverse: &inverse,
            meshes: &meshes,
        };
        let mut window = windows
            .make(
                &all_series,
                &TrainSettings::default().without_disturbances(),
                5,
            )
            .swap_remove(0);
        let device = Device::flex();
        let time = window.times_s.len();
        let near = |window: &Window<'_>, side: f32| -> Vec<f32> {
            let at: Vec<f32> = window
                .place
                .chunks(3)
                .flat_map(|p| [p[0] + 1.0, p[1].abs() * side + side, p[2]])
                .collect();
            let at = Tensor::from_data(TensorData::new(at, [time, 3]), &device);
            nearest_on_surfaces(&[window], &at, &device)
                .unwrap()
                .into_data()
                .try_to_vec()
                .unwrap()
        };
        let (here, other) = (near(&window, 1.0), near(&window, -1.0));
        window.mirror();
        let there = near(&window, -1.0);
        let off = |image: &[f32]| {
            let y = |k: usize| if k % 3 == 1 { -1.0 } else { 1.0 };
            here.iter()
                .zip(image)
                .enumerate()
                .map(|(k, (a, b))| (a - y(k) * b).abs())
                .fold(0.0, f32::max)
        };
        assert!(off(&there) < 1e-5, "{}", off(&there));
        // Negative control: the object itself is none.
        assert!(off(&other) > 0.1, "{}", off(&other));
    }
}
