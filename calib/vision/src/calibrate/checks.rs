//! Why a calibration is refused, and what makes a result weak.

use crate::calibrate::bundle::{BoardView, BundleSolution, BundleState, Corners};
use crate::calibrate::initial::{MonoEstimate, calibrate_alone, consensus};
use crate::camera::{Camera, PINHOLE_NAMES};
use crate::error::VisionError;
use crate::median::median;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// The error for pairs of which no majority agrees on one relative pose.
pub(crate) fn explain_disagreement(
    points: &[Vector3<f64>],
    views: &[BoardView],
    mono: &[MonoEstimate],
    mono_rms_px: f64,
    joint_rms_px: f64,
) -> VisionError {
    let right: Vec<Corners> = views.iter().map(|v| v.corners[1].clone()).collect();
    let n = views.len();
    let (image_size_px, lens) = (mono[0].camera.image_size_px, mono[0].camera.lens);
    let score = |left: &MonoEstimate, right: &MonoEstimate, corners: &[Corners]| {
        median(consensus(points, left, right, corners).1)
    };
    let now = score(&mono[0], &mono[1], &right);
    let mut causes: Vec<(f64, String)> = Vec::new();
    for (shift, frames) in [(1, "late"), (n - 1, "early")] {
        let (mut other, mut corners) = (mono[1].clone(), right.clone());
        other.camera_from_board.rotate_left(shift);
        corners.rotate_left(shift);
        causes.push((
            score(&mono[0], &other, &corners),
            format!("the pairs are shifted: the left pictures are one picture {frames} against the right ones"),
        ));
    }
    let mirrored: Vec<Corners> = right
        .iter()
        .map(|c| mirror(points, c, image_size_px[0] as f64))
        .collect();
    if let Ok(other) = calibrate_alone(points, &mirrored, image_size_px, lens) {
        causes.push((
            score(&mono[0], &other, &mirrored),
            "one camera's pictures are mirrored left to right".into(),
        ));
    }
    let best = causes
        .into_iter()
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|b| b.0 < 0.3 * now);
    let untilted = mono.iter().find_map(|m| parallel(&m.camera_from_board));
    let why = best.map(|b| b.1).or(untilted).unwrap_or_else(|| {
        "board moved between left and right, wrong pairing, or mirrored pictures".to_string()
    });
    VisionError::result(
        "calibrate two cameras",
        format!(
            "pairs that agree on one relative pose of the cameras (each camera alone fits to {mono_rms_px:.2} px)"
        ),
        format!("pairs that contradict each other (joint fit {joint_rms_px:.2} px): {why}"),
    )
}

/// Corners as in the mirrored picture: x flipped, and each row of the grid read from its other end.
fn mirror(points: &[Vector3<f64>], corners: &Corners, width: f64) -> Corners {
    let columns = points
        .iter()
        .take_while(|p| p.y == points[0].y)
        .count()
        .max(1);
    corners
        .chunks(columns)
        .flat_map(|row| {
            row.iter()
                .rev()
                // Pixel centres are at integers: column 0 goes to width - 1.
                .map(|c| c.map(|c| Vector2::new(width - 1.0 - c.x, c.y)))
        })
        .collect()
}

/// Refuses results that are impossible for a lens or a pair of cameras, whatever their RMS.
pub(crate) fn refuse_unphysical(
    points: &[Vector3<f64>],
    solution: &BundleSolution,
    views: &[BoardView],
) -> Result<(), VisionError> {
    let parallel = parallel(&solution.state.left_from_board)
        .map_or_else(String::new, |why| format!("; {why}"));
    let refuse = |expected: String, found: String| {
        Err(VisionError::result(
            "accept the calibration",
            expected,
            format!(
                "{found} (RMS {:.3} px nevertheless){parallel}",
                solution.rms_px()
            ),
        ))
    };
    if !solution.converged {
        return refuse("a solve that converges".into(), "one that does not".into());
    }
    for (side, name) in ["left", "right"].iter().enumerate() {
        let camera = &solution.state.cameras[side];
        let [w, h] = camera.image_size_px.map(|v| v as f64);
        let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.centre_px);
        if !(fx > 0.1 * w && fy > 0.1 * w && fx < 100.0 * w && fy < 100.0 * w) {
            return refuse(
                format!("{name} camera: focal lengths of 0.1 to 100 picture widths"),
                format!("{fx:.1} and {fy:.1} px at {w} px width"),
            );
        }
        if (fx / fy - 1.0).abs() > 0.2 {
            return refuse(
                format!("{name} camera: nearly square pixels"),
                format!("fx/fy = {:.3}", fx / fy),
            );
        }
        if !(cx > -0.5 * w && cx < 1.5 * w && cy > -0.5 * h && cy < 1.5 * h) {
            return refuse(
                format!("{name} camera: principal point in or near the picture"),
                format!("({cx:.1}, {cy:.1})"),
            );
        }
        if let Some(radius_px) = fold_radius(
            camera,
            views.iter().flat_map(|v| v.corners[side].iter().flatten()),
        ) {
            return refuse(
                format!(
                    "{name} camera: a distortion that does not fold over where the corners lie"
                ),
                format!("one that folds at {radius_px:.0} px from the centre"),
            );
        }
    }
    let baseline = solution.state.right_from_left.translation.vector.norm();
    let depths = middle_depths(points, &solution.state);
    let depth = depths.iter().sum::<f64>() / depths.len() as f64;
    let turn = solution.state.right_from_left.rotation.angle();
    // Without a baseline depth has no measure: its error goes with depth^2 / baseline.
    if baseline < 0.002 * depth && turn < 0.002 {
        return refuse(
            "two cameras in different places".into(),
            format!(
                "a baseline of {baseline:.4} board units at a depth of {depth:.1} (the same pictures twice?)"
            ),
        );
    }
    let one_view = tilt_spread_deg(&solution.state.left_from_board) < SAME_DEG;
    if one_view || solution.shared_covariance.iter().any(|v| !v.is_finite()) {
        return refuse(
            "views that determine every parameter".into(),
            "a singular system (all boards parallel, or the same view again and again?)".into(),
        );
    }
    for (side, name) in [(0, "left"), (1, "right")] {
        let relative =
            solution.variance_of(side, 0).sqrt() / solution.state.cameras[side].focal_px[0];
        if relative > 0.1 {
            return refuse(
                format!("{name} camera: a focal length known to 10 %"),
                format!(
                    "known to {:.0} % only (boards too parallel?)",
                    100.0 * relative
                ),
            );
        }
    }
    Ok(())
}

/// Radius (px) at which the distorted radius stops growing, if that lies within the corners.
fn fold_radius<'a>(
    camera: &Camera,
    corners: impl Iterator<Item = &'a Vector2<f64>>,
) -> Option<f64> {
    let reach = corners
        .map(|c| camera.undistort(c).map_or(f64::INFINITY, |n| n.norm()))
        .fold(0.0, f64::max);
    // Beyond 71 degrees from the axis a pinhole's radius says nothing of the picture.
    let limit = reach.min(3.0);
    (1..=200)
        .map(|k| f64::from(k) / 200.0 * limit)
        .find_map(|r| {
            (camera.lens.radial_slope(&camera.distortion, r) <= 0.0)
                .then_some(r * camera.focal_px[0])
        })
}

/// Depths of the boards' middles.
fn middle_depths(points: &[Vector3<f64>], state: &BundleState) -> Vec<f64> {
    let centre = Point3::from(points.iter().sum::<Vector3<f64>>() / points.len() as f64);
    state
        .left_from_board
        .iter()
        .map(|p| (p * centre).z)
        .collect()
}

/// Angle between boards below which they are one view, whatever the corners' noise determines,
/// degrees.
const SAME_DEG: f64 = 0.1;
/// Angle between boards that tells the focal length from the distance, degrees.
const TILT_DEG: f64 = 20.0;

/// Largest angle between two boards' normals, degrees. Parallel boards have one vanishing line, so
/// that they show parallel by any focal length.
fn tilt_spread_deg(camera_from_board: &[Isometry3<f64>]) -> f64 {
    let normals: Vec<Vector3<f64>> = camera_from_board
        .iter()
        .map(|p| p.rotation * Vector3::z())
        .collect();
    normals
        .iter()
        .flat_map(|a| normals.iter().map(move |b| a.angle(b).to_degrees()))
        .fold(0.0, f64::max)
}

/// Why boards without tilt determine no camera.
fn parallel(camera_from_board: &[Isometry3<f64>]) -> Option<String> {
    let spread = tilt_spread_deg(camera_from_board);
    (spread < TILT_DEG).then(|| {
        format!("all boards are nearly parallel ({spread:.1} deg at most): focal length and distance cannot be separated; tilt them by {TILT_DEG} deg")
    })
}

/// Remarks on geometry that leaves parameters weak.
pub(crate) fn weak_geometry(
    points: &[Vector3<f64>],
    solution: &BundleSolution,
    views: &[BoardView],
) -> Vec<String> {
    let mut warnings = Vec::new();
    let state = &solution.state;
    if views.len() < 8 {
        warnings.push(format!(
            "only {} views: 8 or more average the corners' errors better",
            views.len()
        ));
    }
    let spread = tilt_spread_deg(&state.left_from_board);
    if spread < TILT_DEG {
        warnings.push(format!("few tilts: the boards' normals differ by at most {spread:.1} deg; {TILT_DEG} deg or more fix the focal length"));
    }
    let depths = |p: &Isometry3<f64>| points.iter().map(|q| (p * Point3::from(*q)).z).collect();
    let depths = state.left_from_board.iter().flat_map::<Vec<f64>, _>(depths);
    let (near, far) = depths.fold((f64::MAX, 0.0f64), |(n, f), d| (n.min(d), f.max(d)));
    if (far - near) < 0.05 * middle_depths(points, state)[0] {
        warnings.push(format!(
            "one depth: all corners lie between {near:.1} and {far:.1} board units"
        ));
    }
    for (name, side) in [("left", 0), ("right", 1)] {
        let [w, h] = state.cameras[side].image_size_px.map(|v| v as f64);
        let mut cells = [false; 48];
        for c in views.iter().flat_map(|v| v.corners[side].iter().flatten()) {
            let (i, j) = ((c.x / w * 8.0) as usize, (c.y / h * 6.0) as usize);
            cells[j.min(5) * 8 + i.min(7)] = true;
        }
        let covered = cells.iter().filter(|&&c| c).count();
        if covered < 24 {
            warnings.push(format!("{name} camera: corners cover {covered} of 48 fields of the picture; the distortion is a guess elsewhere"));
        }
        for k in 0..4 {
            let sd = solution.variance_of(side, k).sqrt();
            let focal = state.cameras[side].focal_px[0];
            if sd > 0.01 * focal {
                warnings.push(format!(
                    "{name} camera: {} is known to {sd:.1} px only",
                    PINHOLE_NAMES[k]
                ));
            }
        }
    }
    // Each camera sees the other on the wrong side: one that is mounted upside down makes them
    // differ.
    let in_right = state.right_from_left.translation.vector;
    let in_left = state.right_from_left.inverse().translation.vector;
    let beside = |t: &Vector3<f64>| t.x.abs() >= t.y.abs().max(t.z.abs());
    if in_right.x > 0.0 && in_left.x < 0.0 && beside(&in_right) && beside(&in_left) {
        warnings.push("swapped cameras, or both mirrored left to right? the right camera is to the left of the left one".into());
    }
    warnings
}
