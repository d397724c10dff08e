//! The convex start of the shape's fit: the curve as a chain of nodes through the pieces of both
//! pictures, its links no longer than the wire between them. A second-order cone programme: convex,
//! so that its solution does not depend on the search's error, and where no piece shows the wire (a
//! groove before it, a part along epipolar lines) the curve is as smooth as the rest shape allows.
//!
//! ```text
//! minimise  sum Huber(r_i - a_i . x) + sum |D^3 x - rest|^2 / rough^2 - tension . links    subject to  |x_n+1 - x_n| <= link
//! Huber(r) = min over u, v of u^2 / 2 + bound v,  |r - u| <= v
//! ```
//! Source: Boyd and Vandenberghe, Convex Optimization, 2004, sections 4.4.2 (cone programmes) and
//! 6.1.2 (Huber's loss as one).

use crate::shape::curve::{CurveModel, CurveShape, CurveState};
use crate::shape::curve_fit::{LineObservation, Prior, between, in_camera, node};
use crate::stereo::StereoCameras;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::{DMatrix, Isometry3, Vector3};

/// Intervals of the curve model per link.
const STRIDE: usize = 8;
/// Change of the wire's curvature per mm, 1/mm^2: a force of 0.06 N on a 0.3 mm NiTi wire.
const CURVATURE_CHANGE: f64 = 0.002;
/// Huber's bound, sd: 95 % efficient on Gaussian errors.
const HUBER: f64 = 1.345;
/// Tension along the wire, 1/mm: enough to keep the links stretched, too little to straighten a gap
/// below 12 mm.
const TENSION: f64 = 10.0;
/// Accuracy of a node that the smooth curve has to follow, mm.
const NODE_MM: f64 = 0.01;

/// Entries of a sparse matrix.
#[derive(Default)]
struct Triplets(Vec<usize>, Vec<usize>, Vec<f64>);

impl Triplets {
    fn add(&mut self, row: usize, column: usize, value: f64) {
        self.0.push(row);
        self.1.push(column);
        self.2.push(value);
    }

    fn sparse(self, rows: usize, columns: usize) -> CscMatrix<f64> {
        CscMatrix::new_from_triplets(rows, columns, self.0, self.1, self.2)
    }
}

/// Equation of a piece: residual in sd, and its derivative by the positions of the link's two
/// nodes, 1/mm.
struct PieceEquation {
    camera: usize,
    link: usize,
    residual: f64,
    by_nodes: [Vector3<f64>; 2],
}

/// The curve nearest to the chain that fits the observations best; none where the solver gives up.
pub fn socp_initial_curve(
    stereo: &StereoCameras,
    left_from_base: &Isometry3<f64>,
    model: &CurveModel,
    state: &CurveState,
    observations: &[LineObservation],
    prior: &Prior,
) -> Option<CurveState> {
    let shape = model.shape(state);
    let at: Vec<usize> = (0..model.nodes).step_by(STRIDE).collect();
    let mut pulls: Vec<PieceEquation> = observations
        .iter()
        .filter_map(|s| {
            let (i, f) = node(s.arc_mm, model.step_mm, model.nodes);
            let p = between(&shape.points, (i, f));
            let (px, by_point, _) = in_camera(stereo, left_from_base, s.camera, &p)?;
            // Derivative of the residual by the piece's place, in sd.
            let along = by_point.tr_mul(&s.normal) / s.sd_px;
            let link = (i / STRIDE).min(at.len() - 2);
            let g = (((i - link * STRIDE) as f64 + f) / STRIDE as f64).min(1.0);
            let residual = s.normal.dot(&(s.observed_px - px)) / s.sd_px;
            Some(PieceEquation {
                camera: s.camera,
                link,
                residual,
                by_nodes: [along * (1.0 - g), along * g],
            })
        })
        .collect();
    // The median of a camera's residuals on a link represents all of them: a fifth of the time, and
    // robust.
    pulls.sort_by(|a, b| {
        (a.camera, a.link)
            .cmp(&(b.camera, b.link))
            .then(a.residual.total_cmp(&b.residual))
    });
    let pulls: Vec<&PieceEquation> = pulls
        .chunk_by(|a, b| (a.camera, a.link) == (b.camera, b.link))
        .map(|c| &c[c.len() / 2])
        .collect();
    let moved = solve(model, &shape, &at, &pulls, prior)?;
    let nodes: Vec<(usize, Vector3<f64>)> = at
        .iter()
        .zip(moved)
        .map(|(i, by)| (*i, shape.points[*i] + by))
        .collect();
    Some(model.through(state, &nodes, NODE_MM, prior.smoothing))
}

/// By how much each node moves, mm.
fn solve(
    model: &CurveModel,
    shape: &CurveShape,
    at: &[usize],
    pulls: &[&PieceEquation],
    prior: &Prior,
) -> Option<Vec<Vector3<f64>>> {
    let (points, rest) = (&shape.points, &shape.rest_bends);
    let (nodes, link_mm) = (at.len(), STRIDE as f64 * model.step_mm);
    let (moves, count) = (3 * nodes, pulls.len());
    // Unknowns: moves of the nodes, then each piece's plain part (squared) and the bound of the
    // rest (counted once).
    let unknowns = moves + 2 * count;
    let mut square = DMatrix::<f64>::zeros(moves, moves);
    let mut linear = vec![0.0; unknowns];
    // A term is (a . x + value)^2 / (2 sd^2); the solver takes the upper triangle alone.
    let mut fold = |terms: &[(usize, f64)], value: f64, sd: f64| {
        for &(i, a) in terms {
            linear[i] += a * value / (sd * sd);
            for &(j, b) in terms.iter().filter(|t| t.0 >= i) {
                square[(i, j)] += a * b / (sd * sd);
            }
        }
    };
    // The root stands where it was found; the first link leaves it along x.
    let (place, turn) = (prior.root_sd[0].min(0.1), prior.root_sd[1] * link_mm);
    let first = points[at[1]] - points[0];
    for (k, off, place, turn) in [
        (0, 0.0, 1e-3, 1.0),
        (1, first.y, place, turn),
        (2, first.z, place, turn),
    ] {
        fold(&[(k, 1.0)], 0.0, place);
        fold(&[(k, -1.0), (3 + k, 1.0)], off, turn);
    }
    // The bending beyond the rest shape's changes little from link to link.
    let rough = CURVATURE_CHANGE * link_mm.powi(3);
    let bend = |n: usize, k: usize| {
        let second = points[at[n + 1]][k] - 2.0 * points[at[n]][k] + points[at[n - 1]][k];
        second - rest[at[n]][k] * link_mm * link_mm
    };
    for n in 1..nodes - 2 {
        for k in 0..3 {
            let terms =
                [(-1.0, n - 1), (3.0, n), (-3.0, n + 1), (1.0, n + 2)].map(|(w, m)| (3 * m + k, w));
            fold(&terms, bend(n + 1, k) - bend(n, k), rough);
        }
    }
    // The cones bound a link from above only: without tension the chain could shrink.
    for n in 0..nodes - 1 {
        let chord = (points[at[n + 1]] - points[at[n]]).normalize();
        for k in 0..3 {
            linear[3 * n + k] += TENSION * chord[k];
            linear[3 * (n + 1) + k] -= TENSION * chord[k];
        }
    }
    let mut quadratic = Triplets::default();
    // A third difference joins four nodes, so that the matrix has a band of 12.
    for i in 0..moves {
        for j in (i..moves.min(i + 12)).filter(|j| square[(i, *j)] != 0.0) {
            quadratic.add(i, j, square[(i, j)]);
        }
    }
    // Huber's loss of a residual r: minimum of u^2 / 2 + bound * v with |r - u| <= v.
    let mut rows = Triplets::default();
    let mut bounds = Vec::with_capacity(2 * count + 4 * nodes);
    for (p, pull) in pulls.iter().enumerate() {
        let (plain, rest) = (moves + p, moves + count + p);
        quadratic.add(plain, plain, 1.0);
        linear[rest] = HUBER;
        for sign in [1.0, -1.0] {
            let row = bounds.len();
            for (end, by) in pull.by_nodes.iter().enumerate() {
                for k in 0..3 {
                    rows.add(row, 3 * (pull.link + end) + k, -sign * by[k]);
                }
            }
            rows.add(row, plain, -sign);
            rows.add(row, rest, -1.0);
            bounds.push(-sign * pull.residual);
        }
    }
    let mut cones = vec![SupportedConeT::NonnegativeConeT(2 * count)];
    // A link is no longer than the wire between its nodes.
    for n in 0..nodes - 1 {
        let chord = points[at[n + 1]] - points[at[n]];
        bounds.push(chord.norm());
        for k in 0..3 {
            let row = bounds.len();
            rows.add(row, 3 * n + k, 1.0);
            rows.add(row, 3 * (n + 1) + k, -1.0);
            bounds.push(chord[k]);
        }
        cones.push(SupportedConeT::SecondOrderConeT(4));
    }
    let settings = DefaultSettings {
        verbose: false,
        tol_gap_rel: 1e-6,
        ..DefaultSettings::default()
    };
    let (p, a) = (
        quadratic.sparse(unknowns, unknowns),
        rows.sparse(bounds.len(), unknowns),
    );
    let mut solver = DefaultSolver::new(&p, &linear, &a, &bounds, &cones, settings).ok()?;
    solver.solve();
    let solved = matches!(
        solver.solution.status,
        SolverStatus::Solved | SolverStatus::AlmostSolved
    );
    let moved = solver.solution.x[..moves].chunks_exact(3);
    solved.then(|| moved.map(Vector3::from_column_slice).collect())
}
