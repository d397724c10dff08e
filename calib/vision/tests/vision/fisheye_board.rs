//! Two fisheye cameras from the corners of a board that are drawn with noise (simulated): the truth
//! comes back within the stated errors.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use wcal_vision::calibrate::board::board_points;
use wcal_vision::calibrate::bundle::BoardView;
use wcal_vision::calibrate::solution::{StereoSolution, calibrate_stereo};
use wcal_vision::camera::Camera;
use wcal_vision::camera::{FISHEYE, OPENCV5};

const SIZE_PX: [usize; 2] = [1280, 960];
const NOISE_PX: f64 = 0.05;

fn cameras() -> [Camera; 2] {
    let camera = |f: f64, cx: f64, distortion| Camera {
        image_size_px: SIZE_PX,
        focal_px: [f, f + 1.0],
        centre_px: [cx, 475.0],
        lens: FISHEYE,
        distortion,
    };
    [
        camera(520.0, 645.0, [-0.02, 0.006, -0.003, 5e-4, 0.0]),
        camera(523.0, 632.0, [0.01, -0.008, 2e-3, -3e-4, 0.0]),
    ]
}

fn right_from_left() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.15, -0.02));
    Isometry3::from_parts(Vector3::new(-80.0, 1.0, 9.0).into(), turn)
}

/// Views of a board that fills much of a field 100 degrees wide; corners outside a picture are not
/// seen.
fn views(points: &[Vector3<f64>], seed: u64) -> Vec<BoardView> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, NOISE_PX).unwrap();
    let mut see = |camera: &Camera, pose: Isometry3<f64>| -> Vec<Option<Vector2<f64>>> {
        let mut corner = |p: &Vector3<f64>| {
            let px = camera.project(&(pose * Point3::from(*p)).coords)?;
            let inside = px.x > 5.0 && px.y > 5.0 && px.x < 1275.0 && px.y < 955.0;
            inside.then(|| px + Vector2::new(normal.sample(&mut rng), normal.sample(&mut rng)))
        };
        points.iter().map(&mut corner).collect()
    };
    let [left, right] = cameras();
    (0..16)
        .map(|k| {
            let t = f64::from(k);
            let tilt = Vector3::new(0.5 * (1.9 * t).sin(), 0.5 * (1.1 * t + 1.0).cos(), 0.3 * t);
            let place = Vector3::new(
                70.0 * (1.3 * t).sin() + 30.0,
                60.0 * (2.1 * t).cos(),
                190.0 + 30.0 * (0.7 * t).sin(),
            );
            let pose = Isometry3::from_parts(place.into(), UnitQuaternion::from_scaled_axis(tilt))
                * Isometry3::translation(-100.0, -62.5, 0.0);
            BoardView {
                name: k.to_string(),
                corners: [see(&left, pose), see(&right, right_from_left() * pose)],
            }
        })
        .collect()
}

/// What is left is the noise that was drawn: two coordinates a corner, some 3,000 of them, so that
/// 10 % are more than 7 sd.
fn explained(solution: &StereoSolution) -> bool {
    (solution.bundle.rms_px() / 2f64.sqrt() - NOISE_PX).abs() < 0.1 * NOISE_PX
}

#[test]
fn a_fisheye_pair_comes_back_within_its_stated_errors() {
    let points = board_points(9, 6, 25.0);
    let solution = calibrate_stereo(&points, views(&points, 1), SIZE_PX, FISHEYE).unwrap();
    assert!(solution.rejected.is_empty(), "{:?}", solution.rejected);
    let state = &solution.bundle.state;
    assert!(explained(&solution), "{}", solution.bundle.rms_px());
    let covariance = &solution.bundle.shared_covariance;
    let mut z2 = Vec::new();
    for (c, drawn) in cameras().iter().enumerate() {
        let found = state.cameras[c].parameters();
        assert_eq!(found.len(), 8);
        for (k, (f, d)) in found.iter().zip(drawn.parameters()).enumerate() {
            z2.push((f - d).powi(2) / covariance[(8 * c + k, 8 * c + k)]);
        }
    }
    let moved = state.right_from_left.translation.vector - right_from_left().translation.vector;
    z2.extend((0..3).map(|k| moved[k].powi(2) / covariance[(19 + k, 19 + k)]));
    let turned =
        (state.right_from_left.rotation * right_from_left().rotation.inverse()).scaled_axis();
    z2.extend((0..3).map(|k| turned[k].powi(2) / covariance[(16 + k, 16 + k)]));
    // 22 squares of unit normals, correlated: their mean is near 1, none beyond 4 sd.
    let mean = z2.iter().sum::<f64>() / z2.len() as f64;
    assert!(
        mean > 0.2 && mean < 3.0 && z2.iter().all(|z| *z < 16.0),
        "{mean}: {z2:?}"
    );
    // And in sizes that matter.
    assert!(
        (state.cameras[0].focal_px[0] - 520.0).abs() < 0.5,
        "{}",
        state.cameras[0].focal_px[0]
    );
    assert!(moved.norm() < 0.05, "{moved}");
}

/// Negative control: five coefficients of a narrow lens do not describe this one.
#[test]
fn the_other_model_leaves_what_the_fisheye_explains() {
    let points = board_points(9, 6, 25.0);
    match calibrate_stereo(&points, views(&points, 1), SIZE_PX, OPENCV5) {
        Err(why) => assert!(why.to_string().contains("expected"), "{why}"),
        Ok(solution) => assert!(!explained(&solution), "{}", solution.bundle.rms_px()),
    }
}
