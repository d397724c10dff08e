//! The network that `wcal` runs is the one that was trained: the same numbers come out of both, on
//! inputs of sweeps (SIMULATED).

use crate::tracking::coarse_inverse;
use burn::tensor::{Device, Tensor, TensorData};
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_lab::model_file::{preset, put_weights, read_card, runnable};
use wcal_lab::network::{TrainableNet, attention_bias};
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_network::StaticInverse;
use wcal_network::filter::{BayesSettings, FilterBank};
use wcal_network::network::{FeatureExtractor, KvCache, NetworkConfig};

/// Inputs and times (s) of two sweeps, more than the network's context.
fn recorded(inverse: &StaticInverse, filters: FilterBank) -> (Vec<Vec<f32>>, Vec<f64>) {
    let (whisker, plan) = (
        WhiskerSpec::nominal(),
        SweepPlan {
            rate_hz: 10.0,
            ..SweepPlan::default()
        },
    );
    let order = SweepRequest {
        whisker: &whisker,
        plan: &plan,
        seed: 11,
        sweeps: 2,
    };
    let mut features = FeatureExtractor::new(inverse, filters);
    let (mut inputs, mut times_s, mut begin_s) = (Vec::new(), Vec::new(), 0.0);
    for series in generate_sweeps(&objects::built_in("vase").unwrap(), &order).unwrap() {
        for sample in &series.samples {
            inputs.push(
                features
                    .push(0.1, sample.moment_nmm, Some(sample.speed_mm_s))
                    .inputs,
            );
            times_s.push(begin_s + sample.t_s);
        }
        begin_s = times_s[times_s.len() - 1] + 0.1;
    }
    (inputs, times_s)
}

/// Largest difference of the outputs of both, over the larger of 1 and the output's size.
fn difference(
    net: &TrainableNet,
    config: &NetworkConfig,
    own_context: usize,
    (inputs, times_s): (&[Vec<f32>], &[f64]),
) -> f32 {
    let device = Device::flex();
    let data = TensorData::new(inputs.concat(), [1, inputs.len(), config.inputs]);
    let bias = attention_bias(&[times_s.to_vec()], config.heads, config.context, &device);
    let batch = net
        .forward(Tensor::<3>::from_data(data, &device), bias)
        .into_data();
    let batch: Vec<f32> = batch.try_into_vec().unwrap();
    let (own, mut cache) = (runnable(net, config).unwrap().0, KvCache::default());
    let rows = inputs
        .iter()
        .zip(times_s)
        .zip(batch.chunks(config.outputs()));
    rows.map(|((inputs, t_s), batch)| {
        let step = own.step(inputs, *t_s, own_context, &mut cache);
        assert_eq!(step.len(), batch.len());
        step.iter()
            .zip(batch)
            .map(|(a, b)| (a - b).abs() / b.abs().max(1.0))
            .fold(0.0, f32::max)
    })
    .fold(0.0, f32::max)
}

/// To 1e-5: a sum of some hundred products in single precision, whose order differs, is good to
/// some 1e-6.
#[test]
fn what_wcal_runs_is_what_was_trained() {
    let device = Device::flex();
    for name in ["tracker", "tracker_small"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../fixtures")
            .join(name);
        let card = read_card(&folder).unwrap();
        let inverse = StaticInverse::new(&card.whisker, card.inverse).unwrap();
        let (inputs, times_s) = recorded(&inverse, card.training.filters());
        assert!(inputs.len() > card.network.context);
        let mut net = TrainableNet::new(&card.network, &device).unwrap();
        put_weights(&mut net, &folder).unwrap();
        let off = difference(
            &net,
            &card.network,
            card.network.context,
            (&inputs, &times_s),
        );
        println!("{name}: {off:.1e} over {} tokens", inputs.len());
        assert!(off < 1e-5, "{name}: {off}");
        // Negative control: a network that remembers less is another one.
        let apart = difference(
            &net,
            &card.network,
            card.network.context / 2,
            (&inputs, &times_s),
        );
        assert!(apart > 1e-4, "{name}: {apart}");
    }
    // The paper's sizes and head, with weights as drawn.
    let inverse = coarse_inverse();
    let config = NetworkConfig {
        dropout: 0.0,
        ..preset("paper", inverse, false).unwrap()
    };
    let (inputs, times_s) = recorded(inverse, BayesSettings::multi_mu().into());
    device.seed(3);
    let net = TrainableNet::new(&config, &device).unwrap();
    let off = difference(&net, &config, config.context, (&inputs, &times_s));
    println!("paper: {off:.1e} over {} tokens", inputs.len());
    assert!(off < 1e-5, "paper: {off}");
}
