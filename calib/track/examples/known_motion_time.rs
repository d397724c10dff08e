//! Time of a reading in the recursive posterior of known motion, on one core:
//! `cargo run --release -p wcal-track --example known_motion_time`.
//!
//! SIMULATED presses, a row every 2.5 ms at 4 mm/s, twelve unknowns that all readings share.
//! Printed: rows a second, quantiles of single readings. On Linux readings during which the system
//! gave the core to another process are left out and counted (`preempted`): on a busy machine they
//! measure its scheduler.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    missing_docs,
    reason = "an example reports on stdout and may stop"
)]

use nalgebra::{Matrix2, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::sync::Arc;
use std::time::Instant;
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_rod::Rod;
use wcal_track::known_motion::{
    CorrelatedNoise, Friction, MomentField, MotionRow, RecursivePosterior, Segmenter, Settings,
    Step,
};

const NOISE_NMM: f64 = 4e-3;
const STEP_S: f64 = 0.0025;
const SPEED_MM_S: f64 = 4.0;

/// Free, pressed, held, back.
fn press(field: &MomentField, seed: u64, shared: usize) -> Vec<MotionRow> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let s_mm: f64 = rng.random_range(16.0..50.0);
    let (touch, tangent) = field.free(s_mm);
    let push = Vector3::new(-tangent.z, 0.0, tangent.x).normalize();
    let deepest = 0.12 * s_mm;
    let steps = |from: f64, to: f64| {
        let n = ((to - from).abs() / SPEED_MM_S / STEP_S) as usize;
        (0..n).map(move |k| {
            (
                from + (to - from) * k as f64 / n as f64,
                (to - from).signum() * SPEED_MM_S,
            )
        })
    };
    let hold = std::iter::repeat_n((deepest, 0.0), 200);
    let ways = steps(-2.0, deepest).chain(hold).chain(steps(deepest, -1.0));
    let row = |(k, (way, speed)): (usize, (f64, f64))| {
        let place = touch + push * way;
        let m = if way > 0.0 {
            field.held(&place, 0.0).map_or([0.0; 2], |h| h.moment_nmm)
        } else {
            [0.0; 2]
        };
        MotionRow {
            t_s: k as f64 * STEP_S,
            moment_nmm: m.map(|m| m + NOISE_NMM * rng.sample::<f64, _>(StandardNormal)),
            noise_nmm2: Matrix2::identity() * NOISE_NMM * NOISE_NMM,
            shared_nmm: (0..shared)
                .map(|j| [1e-3 * m[j % 2], 1e-3 * (j % 3) as f64])
                .collect(),
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm: push * way,
            turn: Rotation3::identity(),
            velocity_mm_s: push * speed,
            moved_sd_mm: 0.02,
            free: false,
            contact_segment: 0,
        }
    };
    ways.enumerate().map(row).collect()
}

/// How often the core was taken from this thread; 0 where the system does not say.
fn preemptions() -> u64 {
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|l| l.strip_prefix("nonvoluntary_ctxt_switches:"));
    line.and_then(|n| n.trim().parse().ok()).unwrap_or(0)
}

fn main() {
    let rod = Rod::new(&WhiskerSpec::nominal(), 4.0).expect("a wire");
    let covariance_nmm2 = Matrix2::identity() * NOISE_NMM * NOISE_NMM;
    let correlated = Some(CorrelatedNoise::ByPose {
        covariance_nmm2,
        length_mm: 0.5,
    });
    let settings = Settings {
        clock_sd_s: 0.01,
        correlated,
        ..Settings::default()
    };
    let creeping = Settings {
        creep_sd: 0.15,
        ..settings
    };
    for (name, friction) in [
        ("none", Friction::NONE),
        (
            "0.2",
            Friction {
                coefficient: 0.2,
                moving_share: 1.0,
            },
        ),
    ] {
        let field = Arc::new(MomentField::new(&rod, &MomentAxes::default(), friction));
        let begun = Instant::now();
        field.fill(10.0);
        let fill_s = begun.elapsed().as_secs_f64();
        for shared in [4, 12] {
            let (mut each_us, mut rows, mut preempted) = (Vec::new(), 0, 0);
            for seed in 0..6 {
                let press = press(&field, seed, shared);
                let mut segmenter = Segmenter::new(&field);
                let mut posteriors: Vec<RecursivePosterior> = Vec::new();
                for row in &mut press.clone() {
                    let before = preemptions();
                    let start = Instant::now();
                    let is_loaded = settings.is_loaded(row);
                    match segmenter.push(row, 0, None, is_loaded) {
                        Step::Begins(b) => {
                            let begun = |s| {
                                RecursivePosterior::begin(&field, s, &b)
                                    .expect("a push across the wire")
                            };
                            posteriors = [settings, creeping].map(begun).into();
                        }
                        Step::Within => posteriors.iter_mut().for_each(|p| p.push(&field, row)),
                        Step::Outside => posteriors.clear(),
                    }
                    let places: Vec<_> = posteriors.iter().map(|p| p.place(&field, row)).collect();
                    // Free readings before the contact cost nothing.
                    let us = start.elapsed().as_secs_f64() * 1e6;
                    match (!places.is_empty(), preemptions() == before) {
                        (true, true) => each_us.push(us),
                        (true, false) => preempted += 1,
                        _ => {}
                    }
                    rows += 1;
                }
            }
            let total_s = each_us.iter().sum::<f64>() * 1e-6;
            each_us.sort_by(f64::total_cmp);
            let at = |q: f64| each_us[((each_us.len() - 1) as f64 * q) as usize];
            println!(
                "{{\"example\":\"known_motion_time\",\"simulated\":true,\"friction\":\"{name}\",\"shared\":{shared},\"rows\":{rows},\"in_contact\":{},\"preempted\":{preempted},\
                 \"rows_per_s\":{:.0},\"p50_us\":{:.0},\"p99_us\":{:.0},\"p999_us\":{:.0},\"worst_us\":{:.0},\"fill_s\":{fill_s:.2}}}",
                each_us.len(),
                each_us.len() as f64 / total_s,
                at(0.5),
                at(0.99),
                at(0.999),
                at(1.0),
            );
        }
    }
}
