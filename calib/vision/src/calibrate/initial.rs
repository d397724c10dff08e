//! First estimates: one camera alone, and the relative pose on which most views agree.
//!
//! ```text
//! T_v = T_right,v T_left,v^-1                                                   relative pose by view v alone
//! T   = argmin over v of median over w of RMS_k |px_wk - pi_right(T_v T_left,w p_k)|
//! ```
//!
//! The median bears nearly half of the views being wrong. Source: P. J. Rousseeuw, "Least Median of
//! Squares Regression", J. Am. Stat. Assoc. 79 (1984) 871; Z. Zhang, "A Flexible New Technique for
//! Camera Calibration", IEEE PAMI 22 (2000).

use crate::calibrate::bundle::{
    BoardView, BundleSolution, BundleState, Corners, Free, residuals, solve,
};
use crate::camera::{Camera, Lens};
use crate::error::VisionError;
use crate::homography::{homography, plane_pose};
use crate::median::median;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// One camera calibrated by itself.
#[derive(Clone)]
pub(crate) struct MonoEstimate {
    /// Camera.
    pub camera: Camera,
    /// Board poses in the camera's frame.
    pub camera_from_board: Vec<Isometry3<f64>>,
    /// Per-corner RMS of every view, px.
    pub view_rms_px: Vec<f64>,
}

/// Places on the board of the corners that a picture shows, and these as `of` takes them.
fn shown(
    points: &[Vector3<f64>],
    corners: &Corners,
    of: impl Fn(&Vector2<f64>) -> Option<Vector2<f64>>,
) -> [Vec<Vector2<f64>>; 2] {
    let pairs = points.iter().zip(corners);
    let (plane, seen) = pairs
        .filter_map(|(p, c)| Some((p.xy(), of(c.as_ref()?)?)))
        .unzip();
    [plane, seen]
}

/// Pose of a board seen by a known camera; none where the corners tell none.
fn board_pose(
    camera: &Camera,
    points: &[Vector3<f64>],
    corners: &Corners,
) -> Option<Isometry3<f64>> {
    let [plane, seen] = shown(points, corners, |c| camera.undistort(c));
    plane_pose(&plane, &seen)
}

/// Focal length, px, by which the homographies h of all boards are those of a pinhole with square
/// pixels: h1 . w h2 = 0 and h1 . w h1 = h2 . w h2 with w = diag(1, 1, f^2), by least squares in
/// 1 / f^2 (Zhang 2000, section 3.1). Not a number where they leave it open.
fn focal_guess(points: &[Vector3<f64>], views: &[Corners], centre: &Vector2<f64>) -> f64 {
    let (mut pp, mut pq) = (0.0, 0.0);
    for corners in views {
        let [plane, seen] = shown(points, corners, |c| Some(c - centre));
        let Some(h) = homography(&plane, &seen) else {
            continue;
        };
        let [a, b] = [0, 1].map(|k| h.column(k) / h[(2, 2)]);
        let across = a.xy().dot(&b.xy());
        let longer = a.xy().norm_squared() - b.xy().norm_squared();
        for (p, q) in [(across, a.z * b.z), (longer, a.z * a.z - b.z * b.z)] {
            pp += p * p;
            pq += p * q;
        }
    }
    // q + p / f^2 = 0 in least squares: 1 / f^2 = -sum p q / sum p^2.
    (-pp / pq).sqrt()
}

/// RMS of a view over both pictures once its board pose is fitted to known cameras, px.
pub(crate) fn both_rms(points: &[Vector3<f64>], state: &BundleState, view: &BoardView) -> f64 {
    let Some(pose) = board_pose(&state.cameras[0], points, &view.corners[0]) else {
        return f64::INFINITY;
    };
    let start = BundleState {
        left_from_board: vec![pose],
        ..state.clone()
    };
    let solution = solve(points, std::slice::from_ref(view), start, Free::Poses);
    view_rms(&residuals(&solution.state, points, 0, view).concat())
}

/// Calibrates one camera alone from `views`.
///
/// # Errors
/// Where fewer than three views are given, or none fits.
pub(crate) fn calibrate_alone(
    points: &[Vector3<f64>],
    views: &[Corners],
    image_size_px: [usize; 2],
    lens: &'static dyn Lens,
) -> Result<MonoEstimate, VisionError> {
    if views.len() < 3 {
        return Err(VisionError::result(
            "calibrate a camera",
            "at least 3 usable views",
            views.len().to_string(),
        ));
    }
    // Pixel centres are at integers: the middle of n columns is at (n - 1) / 2.
    let centre = Vector2::from(image_size_px.map(|size| 0.5 * (size as f64 - 1.0)));
    let guess = focal_guess(points, views, &centre);
    let width = image_size_px[0] as f64;
    let plausible = |f: f64| f > 0.2 * width && f < 50.0 * width;
    // The right camera shows nothing, so that the left one is solved for by itself.
    let bundle: Vec<BoardView> = views
        .iter()
        .map(|v| BoardView {
            name: String::new(),
            corners: [v.clone(), vec![None; points.len()]],
        })
        .collect();
    let mut best: Option<BundleSolution> = None;
    // Nearly parallel boards leave the focal length open: then a ladder of values is tried.
    let ladder = [0.7, 1.2, 2.5, 5.0, 0.35].map(|s| s * width);
    for focal in Some(guess)
        .filter(|f| plausible(*f))
        .into_iter()
        .chain(ladder)
    {
        let camera = Camera::new(image_size_px, lens, &[focal, focal, centre.x, centre.y]);
        let poses = views.iter().map(|v| board_pose(&camera, points, v));
        let Some(left_from_board) = poses.collect::<Option<Vec<_>>>() else {
            continue;
        };
        let start = BundleState {
            cameras: [camera.clone(), camera],
            right_from_left: Isometry3::identity(),
            warp: [0.0; 2],
            left_from_board,
        };
        let solution = solve(points, &bundle, start, Free::Left);
        let cost = solution.cost_px2;
        if cost.is_finite() && best.as_ref().is_none_or(|b| cost < b.cost_px2) {
            let good = plausible(solution.state.cameras[0].focal_px[0]);
            best = Some(solution);
            if good && plausible(guess) {
                break;
            }
        }
    }
    let state = best
        .ok_or_else(|| {
            VisionError::result(
                "calibrate a camera",
                "a finite solution",
                "none from any starting focal length",
            )
        })?
        .state;
    let rms = |v: usize| view_rms(&residuals(&state, points, v, &bundle[v])[0]);
    Ok(MonoEstimate {
        view_rms_px: (0..views.len()).map(rms).collect(),
        camera: state.cameras[0].clone(),
        camera_from_board: state.left_from_board,
    })
}

/// Per-corner RMS of residuals, px; NaN without corners.
pub(crate) fn view_rms(residuals: &[Option<Vector2<f64>>]) -> f64 {
    let (n, sum) = residuals
        .iter()
        .flatten()
        .fold((0, 0.0), |(n, s), e| (n + 1, s + e.norm_squared()));
    (sum / f64::from(n)).sqrt()
}

/// The relative pose by one view with the smallest median RMS in the right pictures of all views,
/// with the RMS of each view (px).
pub(crate) fn consensus(
    points: &[Vector3<f64>],
    left: &MonoEstimate,
    right: &MonoEstimate,
    right_corners: &[Corners],
) -> (Isometry3<f64>, Vec<f64>) {
    let transfer = |relative: &Isometry3<f64>| -> Vec<f64> {
        left.camera_from_board
            .iter()
            .zip(right_corners)
            .map(|(pose, corners)| {
                let all = relative * pose;
                let off = |(c, p): (&Option<Vector2<f64>>, &Vector3<f64>)| {
                    Some((*c)? - right.camera.project(&(all * Point3::from(*p)).coords)?)
                };
                view_rms(&corners.iter().zip(points).map(off).collect::<Vec<_>>())
            })
            .collect()
    };
    left.camera_from_board
        .iter()
        .zip(&right.camera_from_board)
        .map(|(l, r)| {
            // Each view alone states the cameras' relative pose.
            let relative = r * l.inverse();
            let errors = transfer(&relative);
            (median(&errors), relative, errors)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(
            || (Isometry3::identity(), Vec::new()),
            |(_, relative, errors)| (relative, errors),
        )
}
