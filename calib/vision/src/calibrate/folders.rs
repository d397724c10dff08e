//! `stereo-calibrate` from two folders: pictures, corners, the solve, the document.

use crate::calibrate::board::{Board, Pattern};
use crate::calibrate::document::{BoardDocument, STEREO_FORMAT, StereoDocument, camera_document};
use crate::calibrate::markers::{BoardLayout, other_board, renumbered};
use crate::calibrate::solution::{StereoSolution, leave_one_out};
use crate::calibrate::statements::calibrate_as_stated;
use crate::calibrate::views::{BoardPairs, board_pairs, with_rejections};
use crate::camera::Lens;
use crate::error::VisionError;
use crate::pairs::{list_pictures, pair_files};
use crate::rigid::rows;
use nalgebra::{Vector2, Vector3};
use std::path::Path;

/// Calibrates cameras with lenses of one model from two folders or patterns. `progress` is called
/// with each step.
///
/// # Errors
/// Where the folders hold no pairs, no board is found, or the calibration is refused.
pub fn calibrate_folders(
    left: &str,
    right: &str,
    board: &Board,
    lens: &'static dyn Lens,
    progress: &(dyn Fn(&str) + Sync),
) -> Result<(StereoDocument, StereoSolution), VisionError> {
    let files = pair_files(&list_pictures(left)?, &list_pictures(right)?)?;
    progress(&format!("{} pairs", files.len()));
    let left: Vec<&Path> = files.iter().filter_map(|f| f.left.as_deref()).collect();
    if let Some(seen) = other_board(board, &left) {
        return Err(VisionError::result(
            "find the board",
            format!("a board of {}", board.size),
            seen,
        ));
    }
    let (other, said) = renumbered(board, &left).unzip();
    let board = &other.flatten().unwrap_or(board.clone());
    let layout = BoardLayout::new(board)?;
    let BoardPairs {
        size,
        views,
        rejected,
        mut remarks,
        marker_share,
    } = board_pairs(&files, &layout);
    remarks.extend(layout.contradicts(marker_share));
    remarks.extend(said.clone());
    let Some(image_size) = size else {
        let none = VisionError::result("calibrate two cameras", "pictures", "none");
        return Err(with_rejections(
            views.err().unwrap_or(none),
            said.as_deref(),
            &rejected,
        ));
    };
    progress(&format!(
        "{} pairs show the board; solving",
        views.as_ref().map_or(0, Vec::len)
    ));
    let enough = views.is_ok();
    let (mut solution, noise) = calibrate_as_stated(&files, &layout, views, image_size, lens)
        .map_err(|e| {
            let size = board.size;
            let alike = board.pattern == Pattern::Chessboard && !size.orientation_is_unique();
            let e = match enough && alike {
                true => e.and(&format!(
                    "; a board of {size} looks alike after half a turn: take one whose numbers of inner corners are odd and even"
                )),
                false => e,
            };
            with_rejections(e, said.as_deref(), &rejected)
        })?;
    solution.warnings.append(&mut remarks);
    let mut document = document(board, image_size, &layout.points, &solution);
    document.corner_noise_px = noise.rms_px.is_finite().then_some(noise.rms_px);
    document.rejected_views.splice(0..0, rejected);
    Ok((document, solution))
}

fn document(
    board: &Board,
    image_size_px: [usize; 2],
    points: &[Vector3<f64>],
    solution: &StereoSolution,
) -> StereoDocument {
    let (state, covariance) = (&solution.bundle.state, &solution.bundle.shared_covariance);
    let sd = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    // Shared parameters: left, right, relative pose (6), warp (2).
    let intrinsics = state.cameras[0].intrinsics();
    let (extrinsic, warp) = (2 * intrinsics, 2 * intrinsics + 6);
    let camera = |c: usize, name: &str| {
        let sds: Vec<f64> = (0..intrinsics).map(|k| sd(c * intrinsics + k)).collect();
        camera_document(name, &state.cameras[c], &sds)
    };
    StereoDocument {
        format: STEREO_FORMAT.into(),
        image_size_px,
        cameras: vec![camera(0, "left"), camera(1, "right")],
        right_from_left: rows(&state.right_from_left),
        right_from_left_sd: (extrinsic..warp).map(sd).collect(),
        rms_px: solution.bundle.rms_px(),
        corner_noise_px: None,
        per_view_rms_px: solution.per_view_rms_px.clone(),
        views: solution.views.iter().map(|v| v.name.clone()).collect(),
        rejected_views: solution.rejected.clone(),
        held_out: leave_one_out(points, solution),
        board: BoardDocument {
            pattern: match board.pattern {
                Pattern::Chessboard => "chessboard",
                Pattern::Charuco { .. } => "charuco",
                Pattern::AprilGrid { .. } => "aprilgrid",
            }
            .into(),
            columns: board.size.columns,
            rows: board.size.rows,
            square_mm: board.square_mm,
            warp_mm: state.warp,
            warp_sd_mm: if solution.warp_used {
                [sd(warp), sd(warp + 1)]
            } else {
                [0.0; 2]
            },
        },
        projection_sd_px: projection_sd(solution),
        covariance: (0..warp)
            .map(|i| covariance.row(i).columns(0, warp).iter().copied().collect())
            .collect(),
        warnings: solution.warnings.clone(),
        provenance: wcal_core::Provenance::default(),
    }
}

/// Sd (px) of where a ray appears, over a 3x3 grid of each picture, from the intrinsics'
/// covariance; none where the lens sees nothing.
fn projection_sd(solution: &StereoSolution) -> Vec<Vec<Option<f64>>> {
    let of_camera = |c: usize| {
        let camera = &solution.bundle.state.cameras[c];
        let intrinsics = camera.intrinsics();
        let shared = &solution.bundle.shared_covariance;
        let block = shared.view((c * intrinsics, c * intrinsics), (intrinsics, intrinsics));
        let [w, h] = camera.image_size_px.map(|v| v as f64);
        let at = |k: u32| {
            let place = |size: f64, k: u32| size * (f64::from(k) + 0.5) / 3.0;
            let ray = camera.ray(&Vector2::new(place(w, k % 3), place(h, k / 3)))?;
            let (_, _, by_camera) = camera.project_with_jacobian(&ray)?;
            // Propagation of the intrinsics' covariance, mean over both coordinates.
            let j = by_camera.columns(0, intrinsics);
            Some(((j * block * j.transpose()).trace() / 2.0).sqrt()).filter(|sd| sd.is_finite())
        };
        (0..9).map(at).collect()
    };
    (0..2).map(of_camera).collect()
}
