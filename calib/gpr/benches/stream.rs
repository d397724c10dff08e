//! Map at stream rate: one reading in, two moments and their deviations out.
//!
//! 2 kHz x 16 whiskers on one core leave 31 us a reading. Beside criterion's mean, the 99th
//! percentile of single readings is printed, since that is what the goal (100 us) is about.
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
use wcal_gpr::{FitOptions, MapKind, MapPredictor, fit_map};

#[path = "../tests/gpr/support.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod support;

fn stream(c: &mut Criterion) {
    let training = support::whiskerfbg();
    for candidate in [MapKind::Affine, MapKind::ThinPlate, MapKind::Matern52] {
        let options = FitOptions {
            candidates: vec![candidate],
            ..FitOptions::default()
        };
        let fit = fit_map(&training, &options).expect("the measured set can be fitted");
        // One map a whisker: 16 predictors, as a stream of 16 whiskers would hold them.
        let whiskers: Vec<MapPredictor> = (0..16)
            .map(|_| MapPredictor::new(&fit.artefact).expect("a sound artefact"))
            .collect();
        let shift = |i: usize| {
            let s = training.shifts_pm[i % training.len()];
            [s[0] + 0.01 * (i % 7) as f64, s[1]]
        };
        let mut i = 0;
        c.bench_function(&format!("predict {}", candidate.name()), |b| {
            b.iter(|| {
                i += 1;
                whiskers[i % 16].predict(black_box(shift(i)))
            });
        });
        let mut each_ns: Vec<u128> = (0..64_000)
            .map(|i| {
                let start = Instant::now();
                black_box(whiskers[i % 16].predict(black_box(shift(i))));
                start.elapsed().as_nanos()
            })
            .collect();
        let total_s = each_ns.iter().sum::<u128>() as f64 * 1e-9;
        each_ns.sort_unstable();
        println!(
            "{{\"bench\":\"stream\",\"map\":\"{}\",\"p50_us\":{:.3},\"p99_us\":{:.3},\"readings_per_s\":{:.0}}}",
            candidate.name(),
            each_ns[32_000] as f64 * 1e-3,
            each_ns[63_360] as f64 * 1e-3,
            64_000.0 / total_s
        );
    }
}

criterion_group!(benches, stream);
criterion_main!(benches);
