//! One solve and one trajectory at the working mesh, numbers compared with scipy's in
//! tests/peers/rod_peers.py.
#![allow(clippy::expect_used, reason = "a measurement")]
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;
use std::hint::black_box;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{Guess, Line, Rod, Tangential, WORKING_STEP_MM};

fn rod() -> Rod {
    let spec = WhiskerSpec::nominal();
    Rod::new(&spec, WORKING_STEP_MM).expect("nominal whisker")
}

fn bench(c: &mut Criterion) {
    let rod = rod();
    let line = Line {
        origin_mm: rod.shape.rest_point(31.0),
        direction: Vector3::new(0.0, 0.6, 0.8),
    };
    let xs: Vec<f64> = (1..=30).map(|k| 0.3 * f64::from(k)).collect();
    let held = rod.follow(&line, &xs);
    let near = Guess::from(held[20].equilibrium().expect("held"));
    c.bench_function("solve_from_neighbour", |b| {
        b.iter(|| {
            rod.solve(
                black_box(&line.point(xs[21])),
                black_box(&near),
                Tangential::Frictionless,
            )
        });
    });
    c.bench_function("trajectory_of_30_poses", |b| {
        b.iter(|| rod.follow(black_box(&line), black_box(&xs)))
    });
}

criterion_group!(benches, bench);
criterion_main!(benches);
