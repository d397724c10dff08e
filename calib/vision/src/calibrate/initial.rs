//! First estimates: one camera alone, and the relative pose on which most views agree.
//!
//! ```text
//! T_v = T_right,v T_left,v^-1                                                   relative pose by view v alone
//! T   = argmin over v of median over w of RMS_k |px_wk - pi_right(T_v T_left,w p_k)|
//! ```
//!
//! The median bears nearly half of the views being wrong. Source: P. J. Rousseeuw, "Least Median of
//! Squares Regression", J. Am. Stat. Assoc. 79 (1984) 871.

use crate::calibrate::bundle::{BoardView, BundleState, Free, residuals, solve};
use crate::camera::Camera;
use crate::camera::{Lens, MAX_COEFFICIENTS};
use crate::error::{OpenCvContext, VisionError};
use crate::median::median;
use crate::rigid::pose_from_parts;
use nalgebra::{Isometry3, Matrix3, Rotation3, Vector2, Vector3};
use opencv::calib3d;
use opencv::core::{Mat, Point2f, Point3f, Size, Vector};
use opencv::prelude::*;

/// Corners of one picture, px, one entry a board point.
pub(crate) type Corners = Vec<Option<Vector2<f64>>>;

/// One camera calibrated by itself.
#[derive(Debug, Clone)]
pub(crate) struct MonoEstimate {
    /// Camera.
    pub camera: Camera,
    /// Board poses in the camera's frame.
    pub camera_from_board: Vec<Isometry3<f64>>,
    /// Per-corner RMS of every view, px.
    pub view_rms_px: Vec<f64>,
}

type ImageAndObject = (Vector<Point2f>, Vector<Point3f>);

/// Corners that the picture shows, with their points on the board.
fn visible(points: &[Vector3<f64>], corners: &Corners) -> ImageAndObject {
    points
        .iter()
        .zip(corners)
        .filter_map(|(p, c)| {
            c.map(|c| {
                (
                    Point2f::new(c.x as f32, c.y as f32),
                    Point3f::new(p.x as f32, p.y as f32, 0.0),
                )
            })
        })
        .unzip()
}

/// Pose of a board seen by a known camera.
///
/// # Errors
/// Where OpenCV fails or finds no pose.
fn board_pose(
    camera: &Camera,
    points: &[Vector3<f64>],
    corners: &Corners,
) -> Result<Isometry3<f64>, VisionError> {
    // The corners as a pinhole would see them: the solver models no lens distortion.
    let straight: Corners = corners
        .iter()
        .map(|c| c.as_ref().and_then(|c| camera.undistorted_px(c)))
        .collect();
    let (image, object) = visible(points, &straight);
    let k = camera.matrix();
    let k = Mat::from_slice_2d(&[
        [k[(0, 0)], 0.0, k[(0, 2)]],
        [0.0, k[(1, 1)], k[(1, 2)]],
        [0.0, 0.0, 1.0],
    ])
    .doing("camera matrix")?;
    let d = Mat::default();
    let (mut rvec, mut tvec) = (Vector::<f64>::new(), Vector::<f64>::new());
    let ok = calib3d::solve_pnp(
        &object,
        &image,
        &k,
        &d,
        &mut rvec,
        &mut tvec,
        false,
        calib3d::SOLVEPNP_ITERATIVE,
    )
    .doing("solvePnP")?;
    let vector = |v: &Vector<f64>| Vector3::from_iterator(v.iter());
    if !ok || rvec.len() != 3 || rvec.iter().chain(tvec.iter()).any(|v| !v.is_finite()) {
        return Err(VisionError::result(
            "find the board's pose",
            "a pose in front of the camera",
            "none",
        ));
    }
    let rotation = Rotation3::from_scaled_axis(vector(&rvec));
    let mut pose = pose_from_parts(rotation.matrix(), &vector(&tvec));
    if pose.translation.z < 0.0 {
        // The mirror solution behind the camera projects alike.
        let flip = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        pose = pose_from_parts(&(rotation.matrix() * flip), &-pose.translation.vector);
    }
    Ok(pose)
}

/// RMS of a view over both pictures once its board pose is fitted to known cameras, px.
pub(crate) fn both_rms(points: &[Vector3<f64>], state: &BundleState, view: &BoardView) -> f64 {
    let Ok(pose) = board_pose(&state.cameras[0], points, &view.left) else {
        return f64::INFINITY;
    };
    let start = BundleState {
        left_from_board: vec![pose],
        ..state.clone()
    };
    let none = Free {
        left: false,
        right: false,
        extrinsic: false,
        warp: false,
    };
    let solution = solve(points, std::slice::from_ref(view), start, none);
    let [l, r] = residuals(&solution.state, points, 0, view);
    let all: Vec<_> = l.into_iter().chain(r).collect();
    view_rms(&all)
}

/// Calibrates one camera alone from `views`.
///
/// # Errors
/// Where fewer than three views are given, or OpenCV fails.
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
    let (images, objects): (Vector<Vector<Point2f>>, Vector<Vector<Point3f>>) =
        views.iter().map(|v| visible(points, v)).unzip();
    let size = Size::new(image_size_px[0] as i32, image_size_px[1] as i32);
    let k =
        calib3d::init_camera_matrix_2d(&objects, &images, size, 1.0).doing("initCameraMatrix2D")?;
    let guess = *k.at_2d::<f64>(0, 0).doing("initCameraMatrix2D")?;
    let width = image_size_px[0] as f64;
    let plausible = |f: f64| f.is_finite() && f > 0.2 * width && f < 50.0 * width;
    // Nearly parallel boards leave the focal length open: then a ladder of values is tried.
    let mut ladder: Vec<f64> = [0.7, 1.2, 2.5, 5.0, 0.35]
        .iter()
        .map(|s| s * width)
        .collect();
    if plausible(guess) {
        ladder.insert(0, guess);
    }
    let mut best: Option<(f64, MonoEstimate)> = None;
    for focal in ladder {
        let camera = Camera {
            image_size_px,
            focal_px: [focal; 2],
            centre_px: [0.5 * (width - 1.0), 0.5 * (image_size_px[1] as f64 - 1.0)],
            lens,
            distortion: [0.0; MAX_COEFFICIENTS],
        };
        let poses: Result<Vec<_>, _> = views
            .iter()
            .map(|v| board_pose(&camera, points, v))
            .collect();
        let Ok(left_from_board) = poses else { continue };
        let none = vec![None; points.len()];
        let bundle: Vec<BoardView> = views
            .iter()
            .map(|v| BoardView {
                name: String::new(),
                left: v.clone(),
                right: none.clone(),
            })
            .collect();
        let start = BundleState {
            cameras: [camera.clone(), camera],
            right_from_left: Isometry3::identity(),
            warp: [0.0; 2],
            left_from_board,
        };
        let free = Free {
            left: true,
            right: false,
            extrinsic: false,
            warp: false,
        };
        let solution = solve(points, &bundle, start, free);
        let cost = solution.cost_px2;
        if cost.is_finite() && best.as_ref().is_none_or(|b| cost < b.0) {
            let view_rms_px = (0..views.len())
                .map(|v| view_rms(&residuals(&solution.state, points, v, &bundle[v])[0]))
                .collect();
            let estimate = MonoEstimate {
                camera: solution.state.cameras[0].clone(),
                camera_from_board: solution.state.left_from_board,
                view_rms_px,
            };
            let good = plausible(estimate.camera.focal_px[0]);
            best = Some((cost, estimate));
            if good && plausible(guess) {
                break;
            }
        }
    }
    best.map(|b| b.1).ok_or_else(|| {
        VisionError::result(
            "calibrate a camera",
            "a finite solution",
            "none from any starting focal length",
        )
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
                let errors: Vec<_> = corners
                    .iter()
                    .zip(points)
                    .map(|(c, p)| {
                        Some(
                            (*c)?
                                - right
                                    .camera
                                    .project(&(all * nalgebra::Point3::from(*p)).coords)?,
                        )
                    })
                    .collect();
                view_rms(&errors)
            })
            .collect()
    };
    left.camera_from_board
        .iter()
        .zip(&right.camera_from_board)
        .map(|(l, r)| {
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
