//! The joint solve of both cameras, their relative pose, every board pose and the board's warp
//! (bundle adjustment).
//!
//! ```text
//! minimise  sum |px_cvk - pi_c(T_c T_v (p_k + w_k))|^2      over cameras c, views v, corners k
//! w_k = (kx (1 - x^2) + ky (1 - y^2)) e_z                   x, y in -1..1 over the board
//! [U  W] [a]   [g_a]      S = U - sum_v W_v V_v^-1 W_v^T,   S a = g_a - sum_v W_v V_v^-1 g_v
//! [W' V] [b] = [g_b]      b_v = V_v^-1 (g_v - W_v^T a)
//! ```
//! with shared parameters a (cameras, relative pose, warp) and board poses b, by
//! Levenberg-Marquardt: diagonals times 1 + lambda. Sources: Triggs et al., "Bundle Adjustment - A
//! Modern Synthesis", 2000, section 6 (Schur complement); mrcal documentation, "Board deformation"
//! (warp).

use crate::camera::{Camera, MAX_INTRINSICS};
use crate::rigid::{hat, updated};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix2x3, Matrix6, Vector2, Vector3, Vector6};
use wcal_core::least_squares::{Damping, Ending, Linearised, minimise};

/// Places of the parameters shared by all views: left camera, right camera, right_from_left
/// (rotation, translation), warp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    /// Intrinsic parameters of one camera.
    intrinsics: usize,
}

impl Layout {
    fn extrinsic(self) -> usize {
        2 * self.intrinsics
    }

    fn warp(self) -> usize {
        self.extrinsic() + 6
    }

    fn shared(self) -> usize {
        self.warp() + 2
    }
}

/// Corners of one view, px, one entry a board point; none where the camera does not show it.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// Name for messages.
    pub name: String,
    /// Left camera.
    pub left: Vec<Option<Vector2<f64>>>,
    /// Right camera.
    pub right: Vec<Option<Vector2<f64>>>,
}

/// What is estimated.
#[derive(Debug, Clone, PartialEq)]
pub struct BundleState {
    /// Left and right camera.
    pub cameras: [Camera; 2],
    /// Takes left coordinates to right ones, units of the board.
    pub right_from_left: Isometry3<f64>,
    /// Warp (kx, ky), units of the board.
    pub warp: [f64; 2],
    /// Board poses, one a view.
    pub left_from_board: Vec<Isometry3<f64>>,
}

impl BundleState {
    /// Both cameras have a lens of one model.
    fn layout(&self) -> Layout {
        Layout {
            intrinsics: self.cameras[0].intrinsics(),
        }
    }
}

/// Which shared parameters are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Free {
    /// Left intrinsics.
    pub left: bool,
    /// Right intrinsics.
    pub right: bool,
    /// Relative pose.
    pub extrinsic: bool,
    /// Board warp.
    pub warp: bool,
}

impl Free {
    /// Everything, with or without warp.
    pub fn all(warp: bool) -> Self {
        Self {
            left: true,
            right: true,
            extrinsic: true,
            warp,
        }
    }

    fn mask(self, layout: Layout) -> Vec<bool> {
        let place = |k: usize| match k {
            k if k < layout.intrinsics => self.left,
            k if k < layout.extrinsic() => self.right,
            k if k < layout.warp() => self.extrinsic,
            _ => self.warp,
        };
        (0..layout.shared()).map(place).collect()
    }
}

/// Result of the solve.
#[derive(Debug, Clone)]
pub struct BundleSolution {
    /// Estimates.
    pub state: BundleState,
    /// Whether the iteration converged.
    pub converged: bool,
    /// Sum of squared residuals, px^2.
    pub cost_px2: f64,
    /// Corners counted (each two residuals).
    pub corners: usize,
    /// Covariance of the shared parameters (zero rows for fixed ones), scaled by the residual
    /// variance.
    pub shared_covariance: DMatrix<f64>,
}

impl BundleSolution {
    /// Variance of one intrinsic parameter of the left (0) or right (1) camera.
    pub(crate) fn variance_of(&self, camera: usize, k: usize) -> f64 {
        let place = camera * self.state.cameras[0].intrinsics() + k;
        self.shared_covariance[(place, place)]
    }

    /// Per-corner RMS over both cameras, px: `sqrt(sum |e|^2 / corners)`.
    pub fn rms_px(&self) -> f64 {
        (self.cost_px2 / self.corners.max(1) as f64).sqrt()
    }
}

/// A point of the board with its warp shapes (1 - x^2, 1 - y^2).
fn warp_shapes(points: &[Vector3<f64>]) -> Vec<[f64; 2]> {
    let range = |axis: usize| {
        let (lo, hi) = points.iter().fold((f64::MAX, f64::MIN), |(lo, hi), p| {
            (lo.min(p[axis]), hi.max(p[axis]))
        });
        (0.5 * (lo + hi), (0.5 * (hi - lo)).max(f64::MIN_POSITIVE))
    };
    let ((mx, hx), (my, hy)) = (range(0), range(1));
    points
        .iter()
        .map(|p| {
            [
                1.0 - ((p.x - mx) / hx).powi(2),
                1.0 - ((p.y - my) / hy).powi(2),
            ]
        })
        .collect()
}

/// Normal equations. Plain arrays: matrices of this width as nalgebra types unroll into minutes of
/// compilation.
struct Normal {
    cost: f64,
    corners: usize,
    shared: Vec<Vec<f64>>,
    shared_gradient: Vec<f64>,
    views: Vec<ViewNormal>,
}

/// The part of one view: coupling with the shared parameters, own block, own right-hand side.
struct ViewNormal {
    cross: Vec<[f64; 6]>,
    own: Matrix6<f64>,
    gradient: Vector6<f64>,
}

/// Board points with the warp applied.
fn warped(points: &[Vector3<f64>], shapes: &[[f64; 2]], warp: [f64; 2]) -> Vec<Vector3<f64>> {
    points
        .iter()
        .zip(shapes)
        .map(|(p, s)| Vector3::new(p.x, p.y, p.z + warp[0] * s[0] + warp[1] * s[1]))
        .collect()
}

/// Residuals (px, measured minus predicted) of one view: left and right, one entry a board point.
pub fn residuals(
    state: &BundleState,
    points: &[Vector3<f64>],
    view: usize,
    observed: &BoardView,
) -> [Vec<Option<Vector2<f64>>>; 2] {
    let board = warped(points, &warp_shapes(points), state.warp);
    let left_from_board = &state.left_from_board[view];
    [&observed.left, &observed.right]
        .map(|side| side.clone())
        .into_iter()
        .enumerate()
        .map(|(c, side)| {
            let pose = if c == 0 {
                *left_from_board
            } else {
                state.right_from_left * left_from_board
            };
            side.iter()
                .zip(&board)
                .map(|(px, p)| {
                    Some(
                        px.as_ref()?
                            - state.cameras[c]
                                .project(&(pose * nalgebra::Point3::from(*p)).coords)?,
                    )
                })
                .collect::<Vec<_>>()
        })
        .collect::<Vec<_>>()
        .try_into()
        .unwrap_or_default()
}

fn linearise(
    state: &BundleState,
    points: &[Vector3<f64>],
    shapes: &[[f64; 2]],
    views: &[BoardView],
) -> Normal {
    let board = warped(points, shapes, state.warp);
    let extrinsic = state.right_from_left.rotation.to_rotation_matrix();
    let layout = state.layout();
    let mut n = Normal {
        cost: 0.0,
        corners: 0,
        shared: vec![vec![0.0; layout.shared()]; layout.shared()],
        shared_gradient: vec![0.0; layout.shared()],
        views: Vec::with_capacity(views.len()),
    };
    for (view, pose) in views.iter().zip(&state.left_from_board) {
        let rotation = pose.rotation.to_rotation_matrix();
        let normal_axis = rotation.matrix().column(2).into_owned();
        let mut part = ViewNormal {
            cross: vec![[0.0; 6]; layout.shared()],
            own: Matrix6::zeros(),
            gradient: Vector6::zeros(),
        };
        for (k, p) in board.iter().enumerate() {
            let rotated = rotation * p;
            let in_left = rotated + pose.translation.vector;
            let in_right = extrinsic * in_left + state.right_from_left.translation.vector;
            for (side, observed, x) in
                [(0, &view.left[k], &in_left), (1, &view.right[k], &in_right)]
            {
                let Some(px) = observed else { continue };
                let Some((predicted, by_point, by_camera)) =
                    state.cameras[side].project_with_jacobian(x)
                else {
                    // Behind the camera: infinite cost, so that the step is refused.
                    n.cost = f64::INFINITY;
                    continue;
                };
                let e = px - predicted;
                n.cost += e.norm_squared();
                n.corners += 1;
                // Nonzero columns only, with their place among all: this camera, the relative pose,
                // the warp.
                let mut columns = [(0, [0.0; 2]); MAX_INTRINSICS + 8];
                let mut count = 0;
                let mut push = |place: usize, x: f64, y: f64| {
                    columns[count] = (place, [x, y]);
                    count += 1;
                };
                for k in 0..layout.intrinsics {
                    push(
                        side * layout.intrinsics + k,
                        by_camera[(0, k)],
                        by_camera[(1, k)],
                    );
                }
                let by_left: Matrix2x3<f64> = if side == 1 {
                    let by_turn = -by_point * hat(&(extrinsic * in_left));
                    for k in 0..3 {
                        push(layout.extrinsic() + k, by_turn[(0, k)], by_turn[(1, k)]);
                        push(
                            layout.extrinsic() + 3 + k,
                            by_point[(0, k)],
                            by_point[(1, k)],
                        );
                    }
                    by_point * extrinsic.matrix()
                } else {
                    by_point
                };
                // The warp moves the point along the board's normal.
                let along = by_left * normal_axis;
                for (w, shape) in shapes[k].iter().enumerate() {
                    push(layout.warp() + w, along.x * shape, along.y * shape);
                }
                let by_turn = -by_left * hat(&rotated);
                let own: [[f64; 6]; 2] = std::array::from_fn(|r| {
                    std::array::from_fn(|c| {
                        if c < 3 {
                            by_turn[(r, c)]
                        } else {
                            by_left[(r, c - 3)]
                        }
                    })
                });
                n.accumulate(&mut part, &columns[..count], &own, [e.x, e.y]);
            }
        }
        n.views.push(part);
    }
    n
}

impl Normal {
    /// Adds one corner: its columns of the shared parameters, its rows of the view's pose, its
    /// residual.
    fn accumulate(
        &mut self,
        view: &mut ViewNormal,
        columns: &[(usize, [f64; 2])],
        own: &[[f64; 6]; 2],
        e: [f64; 2],
    ) {
        for (i, a) in columns {
            for (j, b) in columns {
                self.shared[*i][*j] += a[0] * b[0] + a[1] * b[1];
            }
            self.shared_gradient[*i] += a[0] * e[0] + a[1] * e[1];
            for k in 0..6 {
                view.cross[*i][k] += a[0] * own[0][k] + a[1] * own[1][k];
            }
        }
        for k in 0..6 {
            for l in 0..6 {
                view.own[(k, l)] += own[0][k] * own[0][l] + own[1][k] * own[1][l];
            }
            view.gradient[k] += own[0][k] * e[0] + own[1][k] * e[1];
        }
    }
}

/// Shared step, board steps and the reduced normal matrix of the shared parameters.
type SharedStep = (DVector<f64>, Vec<Vector6<f64>>, DMatrix<f64>);

/// Solves for the shared step and the view steps with damping `lambda`; none where the normal
/// matrix is singular.
fn step(normal: &Normal, mask: &[bool], lambda: f64) -> Option<SharedStep> {
    let free: Vec<usize> = (0..mask.len()).filter(|&k| mask[k]).collect();
    let mut schur = DMatrix::<f64>::from_fn(free.len(), free.len(), |i, j| {
        normal.shared[free[i]][free[j]]
    });
    for i in 0..free.len() {
        schur[(i, i)] *= 1.0 + lambda;
    }
    let mut rhs = DVector::<f64>::from_fn(free.len(), |i, _| normal.shared_gradient[free[i]]);
    let mut eliminated = Vec::with_capacity(normal.views.len());
    // Schur complement: the board poses couple only through the shared parameters, so that each is
    // eliminated by its own 6 x 6 block.
    for ViewNormal {
        cross,
        own,
        gradient,
    } in &normal.views
    {
        let mut damped = *own;
        for k in 0..6 {
            damped[(k, k)] *= 1.0 + lambda;
        }
        let inverse = damped.cholesky()?.inverse();
        let w = DMatrix::<f64>::from_fn(free.len(), 6, |i, j| cross[free[i]][j]);
        let wi = &w * DMatrix::from_iterator(6, 6, inverse.iter().copied());
        schur -= &wi * w.transpose();
        rhs -= &wi * DVector::from_column_slice(gradient.as_slice());
        eliminated.push((inverse, w));
    }
    let shared = if free.is_empty() {
        rhs
    } else {
        schur.clone().cholesky()?.solve(&rhs)
    };
    let views = eliminated
        .iter()
        .zip(&normal.views)
        .map(|((inverse, w), ViewNormal { gradient, .. })| {
            let coupled = w.transpose() * &shared;
            inverse * (gradient - Vector6::from_column_slice(coupled.as_slice()))
        })
        .collect();
    let mut full = DVector::<f64>::zeros(mask.len());
    for (i, &k) in free.iter().enumerate() {
        full[k] = shared[i];
    }
    Some((full, views, schur))
}

fn applied(state: &BundleState, shared: &DVector<f64>, views: &[Vector6<f64>]) -> BundleState {
    let layout = state.layout();
    let camera = |c: usize| {
        let mut p = state.cameras[c].parameters();
        for (k, value) in p.iter_mut().enumerate() {
            *value += shared[c * layout.intrinsics + k];
        }
        state.cameras[c].with_parameters(&p)
    };
    BundleState {
        cameras: [camera(0), camera(1)],
        right_from_left: updated(
            &state.right_from_left,
            &Vector6::from_fn(|k, _| shared[layout.extrinsic() + k]),
        ),
        warp: [
            state.warp[0] + shared[layout.warp()],
            state.warp[1] + shared[layout.warp() + 1],
        ],
        left_from_board: state
            .left_from_board
            .iter()
            .zip(views)
            .map(|(p, s)| updated(p, s))
            .collect(),
    }
}

/// The problem with the parameters that are free.
struct Masked<'a> {
    normal: Normal,
    mask: &'a [bool],
}

impl Linearised for Masked<'_> {
    type Step = SharedStep;

    fn cost(&self) -> f64 {
        self.normal.cost
    }

    fn step(&self, damping: f64) -> Option<SharedStep> {
        step(&self.normal, self.mask, damping)
    }
}

/// Minimises the reprojection error from `start`. `points` are the flat board's points in the board
/// frame.
///
/// Non-convergence and rank deficiency are reported in the result (`converged`, infinite
/// covariance), not as errors.
pub fn solve(
    points: &[Vector3<f64>],
    views: &[BoardView],
    start: BundleState,
    free: Free,
) -> BundleSolution {
    let shapes = warp_shapes(points);
    let mask = free.mask(start.layout());
    let damping = Damping {
        start: 1e-3,
        shrink: 0.1,
        min: 1e-12,
        grow: 10.0,
        max: 1e10,
        max_steps: 100,
    };
    let linearised = |state: &BundleState| Masked {
        normal: linearise(state, points, &shapes, views),
        mask: &mask,
    };
    let first = linearised(&start);
    let found = minimise(
        (start, first),
        &damping,
        |state| Some(linearised(state)),
        |state, _, (shared, steps, _)| applied(state, shared, steps),
        |_, [before, after]| before - after < 1e-12 * after.max(1e-300),
    );
    // A step that changes nothing any more (rounding) is the end, not a failure.
    let (state, normal) = (found.place, found.at.normal);
    let converged = match found.ending {
        Ending::Converged => true,
        Ending::Stalled => normal.cost.is_finite(),
        Ending::Singular | Ending::Exhausted => false,
    };
    let count = mask.iter().filter(|&&m| m).count();
    let redundancy = (2 * normal.corners) as f64 - (count + 6 * views.len()) as f64;
    let variance = normal.cost / redundancy.max(1.0);
    let mut covariance = DMatrix::<f64>::zeros(mask.len(), mask.len());
    let indices: Vec<usize> = (0..mask.len()).filter(|&k| mask[k]).collect();
    let inverse = step(&normal, &mask, 0.0)
        .and_then(|s| s.2.cholesky())
        .map(|c| c.inverse());
    for (i, &a) in indices.iter().enumerate() {
        for (j, &b) in indices.iter().enumerate() {
            covariance[(a, b)] = inverse
                .as_ref()
                .map_or(f64::INFINITY, |m| m[(i, j)] * variance);
        }
    }
    BundleSolution {
        converged,
        cost_px2: normal.cost,
        corners: normal.corners,
        shared_covariance: covariance,
        state,
    }
}
