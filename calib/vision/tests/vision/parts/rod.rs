//! The curve model.

use nalgebra::Vector3;
use wcal_vision::rig::RigWhisker;
use wcal_vision::shape::curve::{CurveModel, ROOT};

fn model() -> CurveModel {
    let whisker = RigWhisker {
        diameter_mm: 0.3,
        length_mm: 60.0,
        straight_mm: 30.0,
        arc_curvature_per_mm: 0.05,
    };
    CurveModel::new(&whisker, 60.0, 3.0)
}

#[test]
fn rest_shape_is_the_straight_line_and_the_arc() {
    let model = model();
    let shape = model.shape(&model.rest());
    let tip = shape.points.last().unwrap();
    let expected = Vector3::new(
        30.0 + 20.0 * 1.5f64.sin(),
        0.0,
        -20.0 * (1.0 - 1.5f64.cos()),
    );
    assert!((tip - expected).norm() < 2e-3, "{tip}");
}

#[test]
fn jacobian_agrees_with_finite_differences() {
    let model = model();
    let mut state = model.rest();
    for (k, c) in state.coefficients.iter_mut().enumerate() {
        *c = 0.004 * (k as f64).sin();
    }
    let j = model.jacobian(&state);
    for p in [0, 1, 2, 3, ROOT + 2, ROOT + 10, ROOT + model.splines + 5] {
        let h = 1e-6;
        let at = |d: f64| {
            let mut s = state.clone();
            if p < ROOT {
                s.root[p] += d
            } else {
                s.coefficients[p - ROOT] += d
            }
            model.shape(&s).points
        };
        let (a, b) = (at(-h), at(h));
        for i in [0, 40, 120, model.nodes - 1] {
            let numeric = (b[i] - a[i]) / (2.0 * h);
            let analytic = j.fixed_view::<1, 3>(p, 3 * i).transpose();
            assert!(
                (numeric - analytic).norm() < 1e-3 * numeric.norm().max(1.0),
                "{p} {i} {numeric} {analytic}"
            );
        }
    }
}
