//! The stated standard deviations of a calibration against the scatter of many noisy ones
//! (simulated corners).

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use wcal_vision::calibrate::board::board_points;
use wcal_vision::calibrate::bundle::{BoardView, BundleState, Free, solve};
use wcal_vision::camera::Camera;
use wcal_vision::camera::OPENCV5;

fn truth() -> BundleState {
    let camera = |fx: f64, cx: f64| Camera {
        image_size_px: [1280, 960],
        focal_px: [fx, fx + 2.0],
        centre_px: [cx, 470.0],
        lens: OPENCV5,
        distortion: [-0.14, 0.2, 2e-4, -1e-4, 0.0],
    };
    let turn = |x: f64, y: f64, z: f64| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z));
    let centre = Isometry3::translation(-24.0, -15.0, 0.0);
    let left_from_board = (0..10)
        .map(|k| {
            let t = f64::from(k);
            let pose = Isometry3::from_parts(
                Vector3::new(
                    8.0 * (1.3 * t).sin(),
                    6.0 * (2.1 * t).cos(),
                    280.0 + 15.0 * (0.7 * t).sin(),
                )
                .into(),
                turn(
                    0.45 * (1.9 * t).sin(),
                    0.45 * (1.1 * t + 1.0).cos(),
                    0.2 * t,
                ),
            );
            pose * centre
        })
        .collect();
    BundleState {
        cameras: [camera(3450.0, 650.0), camera(3465.0, 636.0)],
        right_from_left: Isometry3::from_parts(
            Vector3::new(-118.0, 2.0, 25.0).into(),
            turn(0.01, 0.42, 0.02),
        ),
        warp: [0.0; 2],
        left_from_board,
    }
}

fn noisy(state: &BundleState, points: &[Vector3<f64>], sd: f64, seed: u64) -> Vec<BoardView> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, sd).unwrap();
    let mut see = |camera: usize, pose: &Isometry3<f64>| {
        points
            .iter()
            .map(|p| {
                let x = pose * Point3::from(*p);
                let px = state.cameras[camera].project(&x.coords)?;
                Some(px + Vector2::new(normal.sample(&mut rng), normal.sample(&mut rng)))
            })
            .collect::<Vec<_>>()
    };
    state
        .left_from_board
        .iter()
        .map(|pose| BoardView {
            name: String::new(),
            corners: [see(0, pose), see(1, &(state.right_from_left * pose))],
        })
        .collect()
}

/// Fractions of draws in which each shared parameter lies within 1.96 stated sd, the sd multiplied
/// by `factor`.
fn coverage(draws: u64, factor: f64) -> Vec<f64> {
    let (state, points) = (truth(), board_points(9, 6, 6.0));
    let hits: Vec<Vec<bool>> = (0..draws)
        .into_par_iter()
        .map(|seed| {
            let solution = solve(
                &points,
                &noisy(&state, &points, 0.05, seed),
                state.clone(),
                Free::All(false),
            );
            assert!(solution.converged);
            let sd = |k: usize| factor * solution.shared_covariance[(k, k)].sqrt();
            let mut errors = Vec::new();
            for c in 0..2 {
                let (found, drawn) = (
                    solution.state.cameras[c].parameters(),
                    state.cameras[c].parameters(),
                );
                errors.extend(found.iter().zip(drawn).map(|(f, d)| f - d));
            }
            let turned =
                solution.state.right_from_left.rotation * state.right_from_left.rotation.inverse();
            errors.extend(turned.scaled_axis().iter());
            let moved = solution.state.right_from_left.translation.vector
                - state.right_from_left.translation.vector;
            errors.extend(moved.iter());
            errors
                .iter()
                .enumerate()
                .map(|(k, e)| e.abs() <= 1.96 * sd(k))
                .collect()
        })
        .collect();
    (0..24)
        .map(|k| hits.iter().filter(|h| h[k]).count() as f64 / draws as f64)
        .collect()
}

#[test]
fn stated_sd_covers_95_percent_within_binomial_bounds() {
    let draws = 200;
    // 3.3 binomial sd: one false alarm in a thousand a parameter.
    let slack = 3.3 * (0.95f64 * 0.05 / draws as f64).sqrt();
    for (k, c) in coverage(draws, 1.0).into_iter().enumerate() {
        assert!((c - 0.95).abs() <= slack, "parameter {k}: {c}");
    }
    // Negative control: sds that are too small by a third are found out.
    let low = coverage(draws, 0.67);
    assert!(low.iter().all(|c| *c < 0.95 - slack), "{low:?}");
}

#[test]
#[ignore = "2,000 draws: minutes; run with --ignored --release"]
fn stated_sd_covers_95_percent_over_2000_draws() {
    let draws = 2000;
    let slack = 3.3 * (0.95f64 * 0.05 / draws as f64).sqrt();
    let shares = coverage(draws, 1.0);
    println!("{draws} draws, 0.95 +- {slack:.4}: {shares:.4?}");
    for (k, c) in shares.into_iter().enumerate() {
        assert!((c - 0.95).abs() <= slack, "parameter {k}: {c}");
    }
}
