//! Errors that all pairs share: how one standard deviation of each moves every wire.
//!
//! The covariance of the cameras is split into independent parts, ordered by how far they move the wires; the first few carry all. A
//! line that is off in one picture moves the whole wire in depth, and the form of the wire's end changes every length alike.
//!
//! ```text
//! C = F F^T,   sum_i (J_i F)^T (J_i F) = V L V^T,   columns of F V by falling L: d(nodes) = J_i (F V)_k
//! ```
//! Source: principal components of the propagated covariance (JCGM 102:2011, 6.2).

use crate::shape::curve_fit::{in_camera, stepped};
use crate::shape::describe::places;
use crate::shape::joint::{PairUncertainty, depth_axis};
use crate::shape::pair_fit::PairFit;
use crate::stereo::StereoCameras;
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Vector2, Vector3};
use wcal_core::shapes_document::SharedError;

/// Share of the wires' variance that may be left out, and largest number of parts.
const LEFT_OUT: f64 = 0.01;
const MAX_PARTS: usize = 3;

/// Columns: independent errors of the cameras' parameters, one standard deviation each; none where they state no covariance.
pub(crate) fn camera_errors(
    stereo: &StereoCameras,
    fits: &[Result<PairFit, String>],
    uncertain: &[Option<PairUncertainty>],
) -> DMatrix<f64> {
    let none = DMatrix::zeros(stereo.parameters(), 0);
    let Some(c) = &stereo.covariance else { return none };
    // In units of the standard deviations: pixels and radians differ by orders of magnitude.
    let sd = c.diagonal().map(|v| v.max(0.0).sqrt().max(1e-300));
    let correlation = DMatrix::from_fn(c.nrows(), c.ncols(), |i, j| c[(i, j)] / (sd[i] * sd[j]));
    let parts = correlation.symmetric_eigen();
    let root = parts.eigenvalues.map(|v| v.max(0.0).sqrt());
    let factor = DMatrix::from_diagonal(&sd) * parts.eigenvectors * DMatrix::from_diagonal(&root);
    let mut moved = DMatrix::zeros(stereo.parameters(), stereo.parameters());
    for (fit, u) in fits.iter().zip(uncertain) {
        if let (Ok(fit), Some(u)) = (fit, u) {
            let shifts = nodes_by_calibration(fit, u) * &factor;
            moved += shifts.transpose() * shifts;
        }
    }
    let axes = moved.symmetric_eigen();
    let mut order: Vec<usize> = (0..stereo.parameters()).collect();
    order.sort_by(|a, b| axes.eigenvalues[*b].total_cmp(&axes.eigenvalues[*a]));
    let total: f64 = axes.eigenvalues.iter().sum();
    let mut left = total;
    let mut columns = Vec::new();
    for k in order.into_iter().take(MAX_PARTS) {
        if left <= LEFT_OUT * total {
            break;
        }
        left -= axes.eigenvalues[k];
        columns.push(&factor * axes.eigenvectors.column(k));
    }
    if columns.is_empty() { none } else { DMatrix::from_columns(&columns) }
}

/// A pair's wire under each shared error, the cameras' first.
pub(crate) fn shared_errors(
    stereo: &StereoCameras,
    fit: &PairFit,
    u: &PairUncertainty,
    errors: &DMatrix<f64>,
) -> Vec<SharedError> {
    let nodes = nodes_by_calibration(fit, u) * errors;
    let of_camera = |(k, error): (usize, DVector<f64>)| {
        let node = |i: usize| Vector3::new(nodes[(3 * i, k)], nodes[(3 * i + 1, k)], nodes[(3 * i + 2, k)]);
        let at = |(_, i, f): (f64, usize, f64)| (node(i) * (1.0 - f) + node(i + 1) * f).into();
        SharedError {
            cause: "cameras".to_owned(),
            displacement_mm: places(fit).map(at).map(rounded).collect(),
            length_mm: length_change_mm(stereo, fit, u, &error),
        }
    };
    let mut all: Vec<SharedError> =
        errors.column_iter().map(|c| c.into_owned()).enumerate().map(of_camera).collect();
    let everywhere = |by: Vector3<f64>| places(fit).map(|_| rounded(by.into())).collect();
    all.push(SharedError {
        cause: "line".to_owned(),
        displacement_mm: everywhere(depth_axis(fit) * u.shared_mm),
        length_mm: 0.0,
    });
    all.push(SharedError {
        cause: "end".to_owned(),
        displacement_mm: Vec::new(),
        length_mm: fit.length_shared_mm,
    });
    all
}

/// To a nanometre: an error of an error.
fn rounded(by: [f64; 3]) -> [f64; 3] {
    by.map(|x| (x * 1e6).round() / 1e6)
}

/// Derivative of the nodes' places (base frame, mm) by the calibration.
fn nodes_by_calibration(fit: &PairFit, u: &PairUncertainty) -> DMatrix<f64> {
    fit.model.jacobian(&fit.state).tr_mul(&u.by_calibration.rows(6, fit.model.parameters()))
}

/// The pictures show the tip where they do: with other cameras that is another arc length.
pub(crate) fn length_change_mm(
    stereo: &StereoCameras,
    fit: &PairFit,
    u: &PairUncertainty,
    error: &DVector<f64>,
) -> f64 {
    let other = (0..stereo.parameters()).fold(stereo.clone(), |s, k| s.moved(k, error[k]));
    let (pose, state) = stepped(&fit.left_from_base, &fit.state, &(&u.by_calibration * error));
    let end = |state: &crate::shape::curve::CurveState, arc_mm: f64| {
        let points = fit.model.shape(state).points;
        let x = (arc_mm / fit.model.step_mm).clamp(0.0, points.len() as f64 - 1.001);
        points[x as usize] * (1.0 - x.fract()) + points[x as usize + 1] * x.fract()
    };
    let seen = |s: &StereoCameras, pose: &Isometry3<f64>, p: &Vector3<f64>, camera: usize| {
        in_camera(s, camera, &(pose * Point3::from(*p)).coords).map(|(px, _, _)| px)
    };
    let tip = end(&fit.state, fit.length_mm);
    let before = end(&fit.state, fit.length_mm - fit.model.step_mm);
    let moved = end(&state, fit.length_mm);
    let changes: Vec<f64> = (0..2)
        .filter_map(|camera| {
            let at = seen(stereo, &fit.left_from_base, &tip, camera)?;
            let along: Vector2<f64> = at - seen(stereo, &fit.left_from_base, &before, camera)?;
            let off: Vector2<f64> = seen(&other, &pose, &moved, camera)? - at;
            Some(-off.dot(&along) / along.norm_squared() * fit.model.step_mm)
        })
        .collect();
    changes.iter().sum::<f64>() / changes.len().max(1) as f64
}
