//! Time to fit and choose on the measured set: every candidate, leave-one-out and
//! leave-one-trajectory-out with refits.
#![allow(clippy::unwrap_used, reason = "a measurement")]
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a bench reports on stdout and may stop"
)]

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Instant;
use wcal_gpr::{FitOptions, MapKind, fit_map};

#[path = "../tests/gpr/support.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod support;

/// The candidates that scikit-learn fits in tests/peers/map_peers.py.
const PEERS: [MapKind; 4] = [
    MapKind::Affine,
    MapKind::Quadratic,
    MapKind::ThinPlateConstant,
    MapKind::Matern52,
];

fn fit(c: &mut Criterion) {
    let training = support::whiskerfbg();
    let options = FitOptions::default();
    c.benchmark_group("fit")
        .sample_size(10)
        .bench_function("fit and choose", |b| {
            b.iter(|| fit_map(black_box(&training), &options));
        });
    for candidates in [options.candidates.clone(), PEERS.to_vec()] {
        let options = FitOptions {
            candidates,
            ..options.clone()
        };
        let mut each_ms: Vec<f64> = (0..9)
            .map(|_| {
                let start = Instant::now();
                black_box(fit_map(black_box(&training), &options))
                    .expect("the measured set can be fitted");
                start.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        each_ms.sort_by(f64::total_cmp);
        let count = options.candidates.len();
        println!(
            "{{\"bench\":\"fit\",\"candidates\":{count},\"median_ms\":{:.3}}}",
            each_ms[4]
        );
    }
}

criterion_group!(benches, fit);
criterion_main!(benches);
