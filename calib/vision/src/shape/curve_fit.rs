//! The wire's shape of one pair: pieces measured in both pictures, a curve of known kind through
//! all of them at once. Every piece measures the wire's position across its own image line only;
//! parts along epipolar lines need no match of their own.
//!
//! ```text
//! r_i = n_i . (observed_i - pi_c(T exp(x) p(s_i; c))),   weight_i = (nu + 1) / (nu + (r_i / sd_i)^2) / sd_i^2     (Student, nu = 4)
//! (J^T W J + P) step = J^T W r - P state,                P: tags' information on x, root, smoothing * roughness
//! ln evidence(smoothing) = (rank ln smoothing - ln det(J^T W J + P) - minimum of the penalised squares) / 2
//! ```
//! Sources: Lange, Little and Taylor, "Robust Statistical Modeling Using the t Distribution", 1989;
//! MacKay, "Bayesian Interpolation", 1992 (evidence).

use crate::shape::curve::{CurveModel, CurveState, ROOT};
use crate::stereo::StereoCameras;
use crate::wire::piece::{PIECE_PX, Piece, Station};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix2x3, Matrix6, Point3, Vector2, Vector3};

/// Systematic error of a piece that neighbouring pieces share, px: speckle of the surface and of
/// the background.
const PIECE_FLOOR_PX: f64 = 0.01;
/// Degrees of freedom of the Student weights: one piece in twenty lies on an edge or in a crossing.
const STUDENT_DOF: f64 = 4.0;

/// A point of the base's frame in a camera: its pixel with the derivative by the point, and its
/// depth.
pub(crate) fn in_camera(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    camera: usize,
    p: &Vector3<f64>,
) -> Option<(Vector2<f64>, Matrix2x3<f64>, f64)> {
    let pose = stereo.in_camera(camera, left_from_base);
    let x = (pose * Point3::from(*p)).coords;
    let (px, by_point, _) = stereo.cameras[camera].project_with_jacobian(&x)?;
    Some((px, by_point * pose.rotation.to_rotation_matrix(), x.z))
}

/// Stations of one camera along the image of a curve (base frame nodes) up to `length_mm`, one
/// every piece length.
pub(crate) fn image_line(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    camera: usize,
    points: &[Vector3<f64>],
    step_mm: f64,
    length_mm: f64,
    diameter_mm: f64,
) -> Vec<Station> {
    let pixels: Vec<Option<(Vector2<f64>, f64)>> = points
        .iter()
        .map(|p| {
            let (px, _, z) = in_camera(stereo, left_from_base, camera, p)?;
            Some((px, z))
        })
        .collect();
    let mut stations = Vec::new();
    let mut due = 0.5 * PIECE_PX;
    let mut run = 0.0;
    for i in 0..pixels.len().saturating_sub(1) {
        let (Some((a, z)), Some((b, _))) = (pixels[i], pixels[i + 1]) else {
            continue;
        };
        let long = (b - a).norm();
        let Some(tangent) = (b - a).try_normalize(1e-9) else {
            continue;
        };
        // Curvature in the picture from the neighbours' directions.
        let bend = match (
            i.checked_sub(4).and_then(|k| pixels[k]),
            pixels.get(i + 5).copied().flatten(),
        ) {
            (Some((before, _)), Some((after, _))) => {
                let (d1, d2) = (a - before, after - b);
                let turn = d1.perp(&d2).atan2(d1.dot(&d2));
                // Angle between two chords over the arc between their middles.
                turn / (0.5 * (d1.norm() + d2.norm()) + long).max(1.0)
            }
            _ => 0.0,
        };
        while due <= run + long {
            let f = (due - run) / long;
            let arc_mm = (i as f64 + f) * step_mm;
            if arc_mm > length_mm {
                return stations;
            }
            // The chord of a curved piece is inside the curve by the sagitta.
            let sag = -0.5 * bend * (f * long) * (long - f * long);
            let normal = Vector2::new(-tangent.y, tangent.x);
            let turned = (tangent + normal * (bend * (f - 0.5) * long)).normalize();
            stations.push(Station {
                arc_mm,
                position_px: a + (b - a) * f + normal * sag,
                tangent: turned,
                bend_per_px: bend,
                width_px: diameter_mm * stereo.cameras[camera].focal_px[0] / z,
            });
            due += PIECE_PX;
        }
        run += long;
    }
    stations
}

/// A measured place: camera, arc length, observed point, normal, sd.
#[derive(Debug, Clone, Copy)]
pub struct LineObservation {
    /// 0 left, 1 right.
    pub camera: usize,
    /// Arc length, mm.
    pub arc_mm: f64,
    /// Observed centre, px.
    pub observed_px: Vector2<f64>,
    /// Unit normal of the image line.
    pub normal: Vector2<f64>,
    /// Standard deviation along the normal, px.
    pub sd_px: f64,
}

/// Observation by a measured piece.
pub(crate) fn observation(camera: usize, piece: &Piece) -> LineObservation {
    LineObservation {
        camera,
        arc_mm: piece.station.arc_mm,
        observed_px: piece.position_px(),
        normal: piece.station.normal(),
        sd_px: piece.sd_px.hypot(PIECE_FLOOR_PX),
    }
}

/// The linearised problem of one pair: base correction (6: rotation, translation in the base frame)
/// then curve parameters.
#[derive(Debug, Clone)]
pub struct PairSystem {
    /// Information of the observations alone.
    pub data: DMatrix<f64>,
    /// Right-hand side of the observations alone.
    pub rhs: DVector<f64>,
    /// Weighted sum of squares of the observations.
    pub chi2: f64,
    /// Residuals, px, in order of the observations.
    pub residuals_px: Vec<f64>,
    /// Student weights, in order of the observations.
    pub weights: Vec<f64>,
    /// Derivatives of the predicted offsets along the normal times their weights, one column an
    /// observation.
    pub rows_weighted: DMatrix<f64>,
}

/// Node before an arc length, and the share of the interval to the next.
pub(crate) fn node(arc_mm: f64, step_mm: f64, nodes: usize) -> (usize, f64) {
    let x = (arc_mm / step_mm).clamp(0.0, nodes as f64 - 1.001);
    (x.floor() as usize, x.fract())
}

/// Value there, linear between the nodes.
pub(crate) fn between(values: &[Vector3<f64>], (node, share): (usize, f64)) -> Vector3<f64> {
    values[node] * (1.0 - share) + values[node + 1] * share
}

/// Linearises the observations about a state. `noise` scales their standard deviations.
pub fn linearise(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    model: &CurveModel,
    state: &CurveState,
    observations: &[LineObservation],
    noise: f64,
) -> PairSystem {
    let shape = model.shape(state);
    let by_parameters = model.jacobian(state);
    let n = 6 + model.parameters();
    let mut columns = DMatrix::<f64>::zeros(n, observations.len());
    let mut weighted = columns.clone();
    let (mut chi2, mut residuals_px, mut weights) = (0.0, Vec::new(), Vec::new());
    let mut pull = DVector::zeros(observations.len());
    for (index, s) in observations.iter().enumerate() {
        let (i, f) = node(s.arc_mm, model.step_mm, model.nodes);
        let p = between(&shape.points, (i, f));
        let Some((px, by_point, _)) = in_camera(stereo, left_from_base, s.camera, &p) else {
            residuals_px.push(f64::NAN);
            weights.push(0.0);
            continue;
        };
        // d r / d x = n . (d pi / d X) R [-p.cross_matrix()  I] for the base's correction, times dp / dc for
        // the curve.
        let residual = s.normal.dot(&(s.observed_px - px));
        let by_base = s.normal.transpose() * by_point;
        let by_turn = -by_base * p.cross_matrix();
        let mut column = columns.column_mut(index);
        for k in 0..3 {
            column[k] = by_turn[k];
            column[3 + k] = by_base[k];
        }
        let mut curve = column.rows_mut(6, n - 6);
        for k in 0..3 {
            curve.axpy(
                by_base[k] * (1.0 - f),
                &by_parameters.column(3 * i + k),
                1.0,
            );
            curve.axpy(by_base[k] * f, &by_parameters.column(3 * i + 3 + k), 1.0);
        }
        // Iteratively reweighted least squares: Student weight of the present residual.
        let sd = s.sd_px * noise;
        let z2 = (residual / sd).powi(2);
        let student = (STUDENT_DOF + 1.0) / (STUDENT_DOF + z2);
        let weight = student / (sd * sd);
        weighted
            .column_mut(index)
            .axpy(weight, &columns.column(index), 0.0);
        pull[index] = residual;
        chi2 += student * z2;
        residuals_px.push(residual);
        weights.push(student);
    }
    PairSystem {
        data: &weighted * columns.transpose(),
        rhs: &weighted * pull,
        chi2,
        residuals_px,
        weights,
        rows_weighted: weighted,
    }
}

/// Prior information on base, root and roughness.
#[derive(Debug, Clone)]
pub struct Prior {
    /// Information on the base correction.
    pub base: Matrix6<f64>,
    /// Standard deviations of the root's offsets (mm) and tilts (rad).
    pub root_sd: [f64; 2],
    /// Weight of the roughness.
    pub smoothing: f64,
}

/// Information matrix and right-hand side with the prior.
pub(crate) fn with_prior(
    system: &PairSystem,
    prior: &Prior,
    state: &CurveState,
    model: &CurveModel,
) -> (DMatrix<f64>, DVector<f64>) {
    let (mut h, mut g) = (system.data.clone(), system.rhs.clone());
    let mut base = h.fixed_view_mut::<6, 6>(0, 0);
    base += prior.base;
    for k in 0..ROOT {
        // The root's offsets are known to be 0 within their sd: the wire is clamped at the origin.
        let w = 1.0 / prior.root_sd[k / 2].powi(2);
        h[(6 + k, 6 + k)] += w;
        g[6 + k] -= w * state.root[k];
    }
    let n = model.parameters();
    let mut block = h.view_mut((6, 6), (n, n));
    block.zip_apply(&model.penalty, |a, p| *a += prior.smoothing * p);
    let mut rows = g.rows_mut(6, n);
    rows.gemv(-prior.smoothing, &model.penalty, &state.bends(), 1.0);
    for k in 0..n {
        // Splines beyond the tip have no data and little penalty: a weak ridge keeps the matrix
        // regular.
        h[(6 + k, 6 + k)] += 1e-3;
    }
    (h, g)
}

/// The curve after a step with the base held; none where the normal matrix is singular.
pub(crate) fn stepped(
    system: &PairSystem,
    prior: &Prior,
    state: &CurveState,
    model: &CurveModel,
) -> Option<CurveState> {
    let (h, g) = with_prior(system, prior, state, model);
    let n = model.parameters();
    let curve = h.view((6, 6), (n, n)).into_owned().cholesky()?;
    let mut next = state.clone();
    next.add(curve.solve(&g.rows(6, n)).as_slice());
    Some(next)
}

/// Smoothing that maximises the marginal likelihood of the linearised problem, on a ladder of
/// factors of 3.
pub(crate) fn choose_smoothing(
    system: &PairSystem,
    prior: &Prior,
    state: &CurveState,
    model: &CurveModel,
) -> f64 {
    let rank = model.penalty_rank() as f64;
    let theta = state.bends();
    let rough_now = theta.dot(&(&model.penalty * &theta));
    let mut best = (f64::NEG_INFINITY, prior.smoothing);
    for k in 0..28 {
        let smoothing = 1e2 * 3f64.powi(k);
        let trial = Prior {
            smoothing,
            ..prior.clone()
        };
        let (h, g) = with_prior(system, &trial, state, model);
        let Some(cholesky) = h.cholesky() else {
            continue;
        };
        // The penalised minimum in one step: the problem is linear here.
        let step = cholesky.solve(&g);
        let log_det = 2.0 * cholesky.l_dirty().diagonal().map(f64::ln).sum();
        // Minimum of the penalised sum of squares: value at the current state less what the step
        // gains.
        let smallest = system.chi2 + smoothing * rough_now - step.dot(&g);
        let evidence = 0.5 * (rank * smoothing.ln() - log_det - smallest);
        if evidence > best.0 {
            best = (evidence, smoothing);
        }
    }
    best.1
}
