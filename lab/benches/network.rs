//! A row of a stream through the network alone, on one core: the paper's sizes (1.2 million
//! weights) and the shipped models. SIMULATED inputs.
//!
//! `cargo bench -p wcal-lab --bench network`: at the paper's 10 rows a second a whisker needs 0.1 s
//! a row; the goal is 1 ms.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a bench reports on stdout and may stop"
)]

use burn::tensor::Device;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use wcal_lab::dataset::thread_s;
use wcal_lab::model_file::{compact, paper, runnable};
use wcal_lab::network::TrainableNet;
use wcal_network::network::{FeatureExtractor, KvCache, knots};

/// Nodes of the curve that the shipped networks' inputs are made of.
const NODES: usize = 130;
/// Rows of the first measurement.
const ROWS: u32 = 2000;

fn rows(c: &mut Criterion) {
    let two = FeatureExtractor::width(NODES, true);
    let sizes = [
        ("paper", paper(FeatureExtractor::width(NODES, false))),
        ("compact", compact(two, knots(NODES).len(), true)),
    ];
    let mut group = c.benchmark_group("network");
    for (name, config) in sizes {
        let device = Device::flex();
        device.seed(7);
        let net = TrainableNet::new(&config, &device).expect("sizes that fit");
        let (net, _) = runnable(&net, &config).expect("weights that are written");
        let inputs: Vec<f32> = (0..config.inputs)
            .map(|k| (k as f32 * 0.37).sin())
            .collect();
        let (mut cache, mut k) = (KvCache::default(), 0_u32);
        let mut row = || {
            k += 1;
            net.step(
                black_box(&inputs),
                0.1 * f64::from(k),
                config.context,
                &mut cache,
            )
        };
        // A full context: what a stream costs in the long run.
        (0..config.context).for_each(|_| drop(row()));
        // By the processor's time: on a busy machine the clock's is not the network's.
        let begin_s = thread_s();
        (0..ROWS).for_each(|_| drop(black_box(row())));
        println!(
            "{name}: {:.0} rows a second of one core",
            f64::from(ROWS) / (thread_s() - begin_s)
        );
        group.throughput(Throughput::Elements(1));
        group.bench_function(name, |b| b.iter(&mut row));
    }
    group.finish();
}

criterion_group!(benches, rows);
criterion_main!(benches);
