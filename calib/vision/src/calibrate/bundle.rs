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

use crate::camera::Camera;
use crate::rigid::updated;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, MatrixXx6, Point3, RowVector2, Vector2, Vector3, Vector6,
};
use wcal_core::least_squares::{Damping, Ending, Linearised, minimise};

/// Places of the parameters shared by all views: left camera, right camera, right_from_left
/// (rotation, translation), warp.
#[derive(Clone, Copy)]
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

/// Corners of one picture, px, one entry a board point; none where the camera does not show it.
pub type Corners = Vec<Option<Vector2<f64>>>;

/// Corners of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// Name for messages.
    pub name: String,
    /// Left and right camera.
    pub corners: [Corners; 2],
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
    /// Pose of a view's board in a camera's frame (0 left, 1 right).
    pub(crate) fn camera_from_board(&self, camera: usize, view: usize) -> Isometry3<f64> {
        match camera {
            0 => self.left_from_board[view],
            _ => self.right_from_left * self.left_from_board[view],
        }
    }

    /// Both cameras have a lens of one model.
    fn layout(&self) -> Layout {
        Layout {
            intrinsics: self.cameras[0].intrinsics(),
        }
    }
}

/// Which shared parameters are estimated beside the boards' poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Free {
    /// None.
    Poses,
    /// Those of the left camera.
    Left,
    /// All, with or without the board's warp.
    All(bool),
}

impl Free {
    /// How many they are; they come first.
    fn count(self, layout: Layout) -> usize {
        match self {
            Self::Poses => 0,
            Self::Left => layout.intrinsics,
            Self::All(false) => layout.warp(),
            Self::All(true) => layout.shared(),
        }
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
    // Parabolas, 1 in the middle and 0 at the edges: a bent board to second order.
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

/// Normal equations, of which the first `free` shared parameters are estimated.
struct Normal {
    cost: f64,
    corners: usize,
    free: usize,
    shared: DMatrix<f64>,
    gradient: DVector<f64>,
    views: Vec<ViewNormal>,
}

/// The part of one view: coupling with the shared parameters, own block, own right-hand side.
struct ViewNormal {
    cross: MatrixXx6<f64>,
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
    [0, 1].map(|c| {
        let pose = state.camera_from_board(c, view);
        let off = |(px, p): (&Option<Vector2<f64>>, &Vector3<f64>)| {
            Some(px.as_ref()? - state.cameras[c].project(&(pose * Point3::from(*p)).coords)?)
        };
        observed.corners[c].iter().zip(&board).map(off).collect()
    })
}

fn linearise(
    state: &BundleState,
    points: &[Vector3<f64>],
    shapes: &[[f64; 2]],
    views: &[BoardView],
    free: Free,
) -> Normal {
    let board = warped(points, shapes, state.warp);
    let extrinsic = state.right_from_left.rotation.to_rotation_matrix();
    let layout = state.layout();
    let mut n = Normal {
        cost: 0.0,
        corners: 0,
        free: free.count(layout),
        shared: DMatrix::zeros(layout.shared(), layout.shared()),
        gradient: DVector::zeros(layout.shared()),
        views: Vec::with_capacity(views.len()),
    };
    for (view, pose) in views.iter().zip(&state.left_from_board) {
        let rotation = pose.rotation.to_rotation_matrix();
        // Two rows a corner: derivatives by the shared parameters and by the board's pose, and the
        // residual.
        let rows = 2 * view.corners.iter().flatten().flatten().count();
        let mut by_shared = DMatrix::zeros(rows, layout.shared());
        let mut by_pose = MatrixXx6::zeros(rows);
        let mut errors = DVector::zeros(rows);
        let mut row = 0;
        for (k, p) in board.iter().enumerate() {
            let rotated = rotation * p;
            let in_left = rotated + pose.translation.vector;
            // The chain of frames: board, left camera, right camera.
            let in_right = extrinsic * in_left + state.right_from_left.translation.vector;
            for (side, x) in [in_left, in_right].iter().enumerate() {
                let Some(px) = &view.corners[side][k] else {
                    continue;
                };
                let Some((predicted, by_point, by_camera)) =
                    state.cameras[side].project_with_jacobian(x)
                else {
                    // Behind the camera: infinite cost, so that the step is refused.
                    n.cost = f64::INFINITY;
                    continue;
                };
                errors.fixed_rows_mut::<2>(row).copy_from(&(px - predicted));
                by_shared
                    .view_mut((row, side * layout.intrinsics), (2, layout.intrinsics))
                    .copy_from(&by_camera.columns(0, layout.intrinsics));
                let mut by_left = by_point;
                if side == 1 {
                    let mut by_extrinsic =
                        by_shared.fixed_view_mut::<2, 6>(row, layout.extrinsic());
                    // exp(w) R x moves by w x (R x): its derivative by w is -hat(R x).
                    let by_turn = -by_point * (extrinsic * in_left).cross_matrix();
                    by_extrinsic.fixed_columns_mut::<3>(0).copy_from(&by_turn);
                    by_extrinsic.fixed_columns_mut::<3>(3).copy_from(&by_point);
                    by_left = by_point * extrinsic.matrix();
                }
                // The warp moves the point along the board's normal.
                let along = by_left * rotation.matrix().column(2);
                let mut by_warp = by_shared.fixed_view_mut::<2, 2>(row, layout.warp());
                by_warp.copy_from(&(along * RowVector2::from(shapes[k])));
                let mut own = by_pose.fixed_rows_mut::<2>(row);
                own.fixed_columns_mut::<3>(0)
                    .copy_from(&(-by_left * rotated.cross_matrix()));
                own.fixed_columns_mut::<3>(3).copy_from(&by_left);
                row += 2;
            }
        }
        n.cost += errors.norm_squared();
        n.corners += row / 2;
        n.shared += by_shared.tr_mul(&by_shared);
        n.gradient += by_shared.tr_mul(&errors);
        n.views.push(ViewNormal {
            cross: by_shared.tr_mul(&by_pose),
            own: by_pose.tr_mul(&by_pose),
            gradient: by_pose.tr_mul(&errors),
        });
    }
    n
}

/// Shared step, board steps and the reduced normal matrix of the shared parameters.
type SharedStep = (DVector<f64>, Vec<Vector6<f64>>, DMatrix<f64>);

impl Linearised for Normal {
    type Step = SharedStep;

    fn cost(&self) -> f64 {
        self.cost
    }

    fn step(&self, damping: f64) -> Option<SharedStep> {
        let n = self.free;
        // The left camera is the frame and the board the unit of length: no gauge is left free.
        let mut schur = self.shared.view((0, 0), (n, n)).into_owned();
        for i in 0..n {
            schur[(i, i)] *= 1.0 + damping;
        }
        let mut rhs = self.gradient.rows(0, n).into_owned();
        let mut inverses = Vec::with_capacity(self.views.len());
        // Schur complement: the board poses couple only through the shared parameters, so that each
        // is eliminated by its own 6 x 6 block.
        for view in &self.views {
            let mut damped = view.own;
            for k in 0..6 {
                damped[(k, k)] *= 1.0 + damping;
            }
            let inverse = damped.cholesky()?.inverse();
            let cross = view.cross.rows(0, n);
            let carried = cross * inverse;
            schur -= &carried * cross.transpose();
            rhs -= carried * view.gradient;
            inverses.push(inverse);
        }
        let shared = schur.clone().cholesky()?.solve(&rhs);
        let coupled = |view: &ViewNormal| view.gradient - view.cross.rows(0, n).tr_mul(&shared);
        let views = inverses.iter().zip(&self.views);
        let views = views
            .map(|(inverse, view)| inverse * coupled(view))
            .collect();
        let shared = shared.resize_vertically(self.gradient.len(), 0.0);
        Some((shared, views, schur))
    }
}

fn applied(state: &BundleState, shared: &DVector<f64>, views: &[Vector6<f64>]) -> BundleState {
    let layout = state.layout();
    let camera = |c: usize| {
        let own = shared.rows(c * layout.intrinsics, layout.intrinsics);
        let parameters = DVector::from_vec(state.cameras[c].parameters()) + own;
        state.cameras[c].with_parameters(parameters.as_slice())
    };
    let poses = state.left_from_board.iter().zip(views);
    BundleState {
        cameras: [camera(0), camera(1)],
        right_from_left: updated(
            &state.right_from_left,
            &shared.fixed_rows::<6>(layout.extrinsic()).into_owned(),
        ),
        warp: [0, 1].map(|k| state.warp[k] + shared[layout.warp() + k]),
        left_from_board: poses.map(|(p, s)| updated(p, s)).collect(),
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
    let damping = Damping {
        shrink: 0.1,
        min: 1e-12,
        max: 1e10,
        max_steps: 100,
        ..Damping::default()
    };
    let linearised = |state: &BundleState| linearise(state, points, &shapes, views, free);
    let first = linearised(&start);
    let found = minimise(
        (start, first),
        &damping,
        |state| Some(linearised(state)),
        |state, _, (shared, steps, _)| applied(state, shared, steps),
        |_, [before, after]| before - after < 1e-12 * after.max(1e-300),
    );
    // A step that changes nothing any more (rounding) is the end, not a failure.
    let (state, normal) = (found.place, found.at);
    let converged = match found.ending {
        Ending::Converged => true,
        Ending::Stalled => normal.cost.is_finite(),
        Ending::Singular | Ending::Exhausted => false,
    };
    let (free, all) = (normal.free, normal.gradient.len());
    // The residual variance scales the covariance: the corners' noise is not known beforehand.
    let redundancy = (2 * normal.corners) as f64 - (free + 6 * views.len()) as f64;
    let variance = normal.cost / redundancy.max(1.0);
    // The inverse of the Schur complement is the covariance with the boards' poses left free.
    let inverse = normal.step(0.0).and_then(|step| step.2.cholesky());
    let unknown = DMatrix::from_element(free, free, f64::INFINITY);
    let covariance = inverse.map_or(unknown, |c| c.inverse() * variance);
    BundleSolution {
        converged,
        cost_px2: normal.cost,
        corners: normal.corners,
        shared_covariance: covariance.resize(all, all, 0.0),
        state,
    }
}
