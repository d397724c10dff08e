//! The convex start of the shape's fit.

use crate::common::bench;
use nalgebra::{Matrix6, Point3, Vector2, Vector3};
use wcal_vision::rig::Rig;
use wcal_vision::shape::curve::{CurveModel, CurveState};
use wcal_vision::shape::curve_fit::{LineObservation, Prior};
use wcal_vision::shape::socp_start::socp_initial_curve;
use wcal_vision::stereo::StereoCameras;

/// Sights of the true curve seen from a start 0.3 mm off at its end: none in a gap of 8 mm, and a
/// stretch of one picture on a line that lies `wrong_px` beside the wire.
fn setting(
    wrong_px: f64,
) -> (
    StereoCameras,
    CurveModel,
    CurveState,
    CurveState,
    Vec<LineObservation>,
) {
    let cameras = bench::cameras();
    let right_from_left = bench::camera_from_base(1) * bench::camera_from_base(0).inverse();
    let stereo = StereoCameras {
        cameras,
        right_from_left,
        covariance: None,
    };
    let rig = Rig::parse("rig.toml", bench::RIG).unwrap();
    let model = CurveModel::new(&rig.whisker, 60.0, 2.5);
    let mut truth = model.rest();
    for (k, c) in truth.coefficients.iter_mut().enumerate() {
        *c = 0.004 * (0.15 * k as f64).sin();
    }
    let mut start = truth.clone();
    start.coefficients.iter_mut().for_each(|c| *c += 2e-4);
    let shape = model.shape(&truth);
    let mut observations = Vec::new();
    for camera in 0..2 {
        let see = |p: &Vector3<f64>| {
            let x = bench::camera_from_base(camera) * Point3::from(*p);
            stereo.cameras[camera].project(&x.coords).unwrap()
        };
        for i in (2..model.nodes - 2).filter(|i| !(100..132).contains(i)) {
            let tangent = (see(&shape.points[i + 1]) - see(&shape.points[i - 1])).normalize();
            let normal = Vector2::new(-tangent.y, tangent.x);
            let off = if camera == 0 && (160..168).contains(&i) {
                wrong_px
            } else {
                0.0
            };
            let observed_px = see(&shape.points[i]) + normal * off;
            observations.push(LineObservation {
                camera,
                arc_mm: 0.25 * i as f64,
                observed_px,
                normal,
                sd_px: 0.03,
            });
        }
    }
    (stereo, model, truth, start, observations)
}

/// Greatest distance between nodes of the same arc length across the wire, mm.
fn apart(model: &CurveModel, a: &CurveState, b: &CurveState) -> f64 {
    let (a, b) = (model.shape(a), model.shape(b));
    let across = |i: usize| {
        let d = a.points[i] - b.points[i];
        (d - b.tangents[i] * d.dot(&b.tangents[i])).norm()
    };
    (0..model.nodes).map(across).fold(0.0, f64::max)
}

fn prior() -> Prior {
    Prior {
        base: Matrix6::zeros(),
        root_sd: [0.003, 1e-4],
        smoothing: 1e6,
    }
}

#[test]
fn the_chain_bridges_a_gap_and_takes_no_stretch_of_another_line() {
    let (stereo, model, truth, start, observations) = setting(4.0);
    assert!(
        apart(&model, &start, &truth) > 0.2,
        "the start is not where it should end"
    );
    let found = socp_initial_curve(
        &stereo,
        &bench::camera_from_base(0),
        &model,
        &start,
        &observations,
        &prior(),
    )
    .expect("solved");
    let off = apart(&model, &found, &truth);
    println!(
        "off by {off:.4} mm, start {:.4}",
        apart(&model, &start, &truth)
    );
    assert!(off < 0.03, "{off} mm");
}

/// Negative control: where both pictures agree on the other place, the chain goes there.
#[test]
fn a_stretch_that_all_pieces_show_is_followed() {
    let (stereo, model, truth, start, mut observations) = setting(0.0);
    for s in observations.iter_mut().filter(|s| s.arc_mm > 40.0) {
        s.observed_px += s.normal * 2.0;
    }
    let found = socp_initial_curve(
        &stereo,
        &bench::camera_from_base(0),
        &model,
        &start,
        &observations,
        &prior(),
    )
    .expect("solved");
    assert!(apart(&model, &found, &truth) > 0.1);
}
