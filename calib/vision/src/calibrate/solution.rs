//! `stereo-calibrate`: from pairs of pictures of a board to both cameras, their relative pose, and
//! how well each is known.
//!
//! Views are judged by their RMS under the joint solution, corners by the robust standard deviation
//! 1.4826 median |e|, the board's warp by the F test
//! `F = ((Q_flat - Q_warped) / 2) / (Q_warped / n)`. The residual is checked on pairs left out of
//! the solve, by the distance of a corner q from its partner's epipolar line `l = [t]x R p` in the
//! undistorted pictures: `|l . q| / |(l_x / fx, l_y / fy)|`. Source: Hartley and Zisserman,
//! Multiple View Geometry, 2nd ed., section 9.6 (essential matrix).

use crate::calibrate::bundle::{
    BoardView, BundleSolution, BundleState, Corners, Free, residuals, solve,
};
use crate::calibrate::checks;
use crate::calibrate::document::{HeldOut, RejectedView};
use crate::calibrate::initial::{MonoEstimate, both_rms, calibrate_alone, consensus, view_rms};
use crate::camera::Lens;
use crate::error::VisionError;
use crate::median::median;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use wcal_core::order_statistics::MAD_TO_SD;

/// A view is omitted where its RMS exceeds this multiple of the median view's: 13 real pairs spread
/// by a factor 2.
const VIEW_OUTLIER: f64 = 4.0;
/// A corner is omitted where its error exceeds this multiple of the robust sd of a coordinate.
const CORNER_OUTLIER: f64 = 7.0;

/// The solved calibration.
#[derive(Debug, Clone)]
pub struct StereoSolution {
    /// Estimates and covariance.
    pub bundle: BundleSolution,
    /// Views used, with their corners.
    pub views: Vec<BoardView>,
    /// Views left out.
    pub rejected: Vec<RejectedView>,
    /// Per-corner RMS of every view used, left and right, px.
    pub per_view_rms_px: Vec<[f64; 2]>,
    /// Whether the board's warp was estimated.
    pub warp_used: bool,
    /// Remarks.
    pub warnings: Vec<String>,
}

/// Solves for both cameras. `views` hold the corners of every pair in which both pictures show the
/// board.
///
/// # Errors
/// Where fewer than three pairs agree, the pairs contradict each other (with the reason where one
/// is found), or the result is not physical.
pub fn calibrate_stereo(
    points: &[Vector3<f64>],
    views: Vec<BoardView>,
    image_size_px: [usize; 2],
    lens: &'static dyn Lens,
) -> Result<StereoSolution, VisionError> {
    if views.len() < 3 {
        return Err(VisionError::result(
            "calibrate two cameras",
            "at least 3 pairs that show the whole board",
            views.len().to_string(),
        ));
    }
    let side = |c: usize| views.iter().map(|v| v.corners[c].clone()).collect();
    let sides: [Vec<Corners>; 2] = [side(0), side(1)];
    let mono: Vec<MonoEstimate> = sides
        .par_iter()
        .map(|s| calibrate_alone(points, s, image_size_px, lens))
        .collect::<Result<_, _>>()?;
    let (relative, errors) = consensus(points, &mono[0], &mono[1], &sides[1]);
    let mono_rms = median(mono.iter().map(|m| median(&m.view_rms_px)));
    // One view's relative pose is coarse: a loose bound here, the views are judged again by the
    // joint solve below.
    let bound = 5.0 * median(&errors).max(3.0 * mono_rms);
    let mut used: Vec<usize> = (0..views.len()).filter(|&v| errors[v] <= bound).collect();
    let mut state = BundleState {
        cameras: [mono[0].camera.clone(), mono[1].camera.clone()],
        right_from_left: relative,
        warp: [0.0; 2],
        left_from_board: mono[0].camera_from_board.clone(),
    };
    let mut last = Vec::new();
    // Wrong views bend the solution that they are tested against: solved again until the set stays.
    for _ in 0..6 {
        if used.len() < 3 {
            break;
        }
        let solution = solve_subset(points, &views, &state, &used, false);
        state = with_poses(&solution.state, &state, &used);
        let rms: Vec<f64> = (0..views.len())
            .into_par_iter()
            .map(|v| both_rms(points, &state, &views[v]))
            .collect();
        let typical = median(used.iter().map(|&v| rms[v]));
        let next: Vec<usize> = (0..views.len())
            .filter(|&v| rms[v] <= VIEW_OUTLIER * typical)
            .collect();
        last = rms;
        if next == used {
            break;
        }
        used = next;
    }
    let majority = used.len() >= 3 && 2 * used.len() > views.len();
    let typical = median(used.iter().filter_map(|&v| last.get(v)));
    // Pairs that belong together fit jointly about as well as each camera alone.
    if !majority || typical > 4.0 * mono_rms.max(0.05) {
        return Err(checks::explain_disagreement(
            points, &views, &mono, mono_rms, typical,
        ));
    }
    let rejected = (0..views.len())
        .filter(|v| !used.contains(v))
        .map(|v| RejectedView {
            view: views[v].name.clone(),
            why: format!(
                "RMS {:.2} px against {typical:.2} px of the typical view: the corners fit no pose that both cameras share (pictures swapped, of another pair or not taken together, or a board that looks alike after half a turn?)",
                last[v]
            ),
        })
        .collect();
    let mut kept: Vec<BoardView> = used.iter().map(|&v| views[v].clone()).collect();
    state.left_from_board = used.iter().map(|&v| state.left_from_board[v]).collect();
    let mut warnings = Vec::new();
    let dropped = drop_wild_corners(points, &state, &mut kept);
    // Single corners left out need no warning.
    if dropped * 200 > kept.len() * 2 * points.len() {
        warnings.push(format!(
            "{dropped} single corners left out: more than {CORNER_OUTLIER} sd from the model"
        ));
    }
    let flat = solve(points, &kept, state, Free::All(false));
    let (bundle, warp_used) = with_warp_if_needed(points, &kept, flat);
    checks::refuse_unphysical(points, &bundle, &kept)?;
    warnings.extend(checks::weak_geometry(points, &bundle, &kept));
    let per_view_rms_px = (0..kept.len())
        .map(|v| residuals(&bundle.state, points, v, &kept[v]).map(|r| view_rms(&r)))
        .collect();
    Ok(StereoSolution {
        bundle,
        views: kept,
        rejected,
        per_view_rms_px,
        warp_used,
        warnings,
    })
}

/// Joint solve of some views, starting from `state`.
fn solve_subset(
    points: &[Vector3<f64>],
    views: &[BoardView],
    state: &BundleState,
    subset: &[usize],
    warp: bool,
) -> BundleSolution {
    let chosen: Vec<BoardView> = subset.iter().map(|&v| views[v].clone()).collect();
    let mut start = state.clone();
    start.left_from_board = subset.iter().map(|&v| state.left_from_board[v]).collect();
    solve(points, &chosen, start, Free::All(warp))
}

fn with_poses(solved: &BundleState, all: &BundleState, subset: &[usize]) -> BundleState {
    let mut state = solved.clone();
    state.left_from_board = all.left_from_board.clone();
    for (k, &v) in subset.iter().enumerate() {
        state.left_from_board[v] = solved.left_from_board[k];
    }
    state
}

fn drop_wild_corners(
    points: &[Vector3<f64>],
    state: &BundleState,
    views: &mut [BoardView],
) -> usize {
    let all: Vec<Corners> = (0..views.len())
        .flat_map(|v| residuals(state, points, v, &views[v]))
        .collect();
    let coordinates = all
        .iter()
        .flatten()
        .flatten()
        .flat_map(|e| [e.x.abs(), e.y.abs()]);
    // The robust sd is not moved by the corners that it judges.
    let limit = CORNER_OUTLIER * MAD_TO_SD * median(coordinates);
    let mut dropped = 0;
    let corners = views
        .iter_mut()
        .flat_map(|view| &mut view.corners)
        .flatten();
    for (corner, error) in corners.zip(all.iter().flatten()) {
        if error.is_some_and(|e| e.amax() > limit) {
            *corner = None;
            dropped += 1;
        }
    }
    dropped
}

/// Estimates the warp as well and keeps it where an F test of its two parameters rejects the flat
/// board (p < 0.001).
fn with_warp_if_needed(
    points: &[Vector3<f64>],
    views: &[BoardView],
    flat: BundleSolution,
) -> (BundleSolution, bool) {
    let bent = solve(points, views, flat.state.clone(), Free::All(true));
    let shared = bent.shared_covariance.nrows();
    let redundancy = (2 * bent.corners) as f64 - (shared + 6 * views.len()) as f64;
    // F statistic of two more parameters.
    let f = (flat.cost_px2 - bent.cost_px2) / 2.0 / (bent.cost_px2 / redundancy.max(1.0));
    // 99.9 % quantile of F(2, n) for n > 500, the usual case; for smaller n the quantile is larger.
    if bent.converged && f > 6.95 {
        (bent, true)
    } else {
        (flat, false)
    }
}

/// Leaves out one pair at a time, solves without it, and measures its epipolar distances.
pub(crate) fn leave_one_out(points: &[Vector3<f64>], solution: &StereoSolution) -> HeldOut {
    let mut sorted: Vec<f64> = (0..solution.views.len())
        .into_par_iter()
        .flat_map_iter(|out| {
            let rest: Vec<usize> = (0..solution.views.len()).filter(|&v| v != out).collect();
            let state = &solution.bundle.state;
            let solved = solve_subset(points, &solution.views, state, &rest, solution.warp_used);
            epipolar_distances(&solved.state, &solution.views[out])
        })
        .collect();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    HeldOut {
        epipolar_mean_px: sorted.iter().sum::<f64>() / n.max(1) as f64,
        epipolar_p95_px: sorted
            .get((0.95 * n as f64) as usize)
            .copied()
            .unwrap_or(f64::NAN),
        corners: n,
    }
}

/// Mean of the two distances (px) of every corner to the epipolar line of its partner, in the
/// undistorted pictures.
fn epipolar_distances(state: &BundleState, view: &BoardView) -> Vec<f64> {
    let r = state.right_from_left.rotation.to_rotation_matrix();
    // Epipolar constraint: q . E l = 0 in normalised coordinates.
    let essential = state.right_from_left.translation.vector.cross_matrix() * r.matrix();
    let [left, right] = &view.corners;
    left.iter()
        .zip(right)
        .filter_map(|(l, q)| {
            let l = state.cameras[0].undistort(&(*l)?)?.push(1.0);
            let q = state.cameras[1].undistort(&(*q)?)?.push(1.0);
            // Lines in pixels: the normal is divided by the focal lengths.
            let distance = |line: &Vector3<f64>, p: &Vector3<f64>, focal: &[f64; 2]| {
                line.dot(p).abs() / Vector2::new(line.x / focal[0], line.y / focal[1]).norm()
            };
            let in_right = essential * l;
            let in_left = essential.transpose() * q;
            Some(
                0.5 * (distance(&in_right, &q, &state.cameras[1].focal_px)
                    + distance(&in_left, &l, &state.cameras[0].focal_px)),
            )
        })
        .collect()
}
