//! `stereo-calibrate` from two folders: pictures, corners, the method of refinement chosen from the data, the solve, the document.

use crate::calibrate::alternatives::{Alternative, alternatives};
use crate::calibrate::board::{Board, Pattern, board_points};
use crate::calibrate::bundle::BoardView;
use crate::calibrate::document::{
    BoardDocument, RejectedView, STEREO_FORMAT, StereoDocument, camera_document,
};
use crate::calibrate::half_turn::half_turned;
use crate::calibrate::markers::{MarkerBoard, grid_places};
use crate::calibrate::noise::CornerNoise;
use crate::calibrate::refinement::{View, choose_refinement};
use crate::calibrate::solution::{StereoSolution, leave_one_out};
use crate::calibrate::statements::{BoardStatement, Optics, Others, calibrate_as_stated};
use crate::calibrate::views::{
    MarkerPairs, check_board, marker_pairs, usable, whole_board, with_guess, with_rejections,
};
use crate::camera::lens::Lens;
use crate::error::VisionError;
use crate::pairs::{PairFiles, list_pictures, pair_files};
use crate::rigid::rows;
use nalgebra::{Vector2, Vector3};
use std::collections::BTreeMap;

/// Calibrates cameras with lenses of one model from two folders or patterns. `progress` is called with each step.
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
    let mut found = match MarkerBoard::new(board)? {
        None => chessboard(&files, board, lens, progress)?,
        Some(markers) => marker_board(&files, board, &markers)?,
    };
    let solving = found.stated.views.as_ref().map_or(0, Vec::len);
    progress(&format!("{solving} pairs show the board; solving"));
    let points = found.stated.points.clone();
    let (mut solution, noise) = calibrate_as_stated(found.stated, (found.image_size, lens), &*found.others)
        .map_err(|e| with_rejections(e, &found.rejected))?;
    solution.warnings.append(&mut found.remarks);
    let mut document = document(board, found.image_size, &points, &solution, found.refinement, found.chosen);
    document.corner_noise_px = noise.rms_px.is_finite().then_some(noise.rms_px);
    document.rejected_views.splice(0..0, found.rejected);
    Ok((document, solution))
}

/// What the pictures show of the stated board, and how to ask for another one.
struct BoardSearch<'a> {
    stated: BoardStatement,
    image_size: [usize; 2],
    rejected: Vec<RejectedView>,
    remarks: Vec<String>,
    refinement: BTreeMap<String, f64>,
    chosen: String,
    others: Box<Others<'a>>,
}

fn chessboard<'a>(
    files: &'a [PairFiles],
    board: &'a Board,
    lens: &'static dyn Lens,
    progress: &(dyn Fn(&str) + Sync),
) -> Result<BoardSearch<'a>, VisionError> {
    check_board(files, board)?;
    let (mut rejected, mut remarks) = (Vec::new(), Vec::new());
    let (mut views, image_size) = usable(files, &mut rejected, &|p, i| whole_board(p, board.size, i))?;
    let points = board_points(board.size.columns, board.size.rows, board.square_mm);
    if !board.size.orientation_is_unique() {
        remarks.extend(in_one_order(&points, &mut views, (image_size, lens)));
    }
    let (refined, refinement, chosen) =
        choose_refinement(&points, board.size, &views, (image_size, lens), progress)?;
    let stated =
        BoardStatement { says: String::new(), points, places: grid_places(board.size), views: Ok(refined) };
    // A plain chessboard has its squares and nothing else to be wrong, but the print.
    Ok(BoardSearch {
        stated,
        image_size,
        rejected,
        remarks,
        refinement,
        chosen,
        others: Box::new(|_| Vec::new()),
    })
}

/// Reads the right corners of a board that looks alike after half a turn from the end at which the left ones begin.
fn in_one_order(points: &[Vector3<f64>], views: &mut [View], optics: Optics) -> Option<String> {
    let coarse: Vec<BoardView> = views.iter().map(View::coarse_corners).collect();
    let turned = half_turned(points, &coarse, optics)?;
    for (view, _) in views.iter_mut().zip(&turned).filter(|(_, turned)| **turned) {
        view.coarse[1].reverse();
    }
    let count = turned.iter().filter(|t| **t).count();
    Some(format!(
        "this board looks alike after half a turn: in {count} of {} pairs the right corners were taken from the other end, where the pairs agree",
        turned.len()
    ))
}

fn marker_board<'a>(
    files: &'a [PairFiles],
    board: &Board,
    markers: &MarkerBoard,
) -> Result<BoardSearch<'a>, VisionError> {
    let MarkerPairs { size, views, rejected, mut remarks, marker_share } = marker_pairs(files, markers);
    remarks.extend(markers.contradicts(marker_share));
    let Some(image_size) = size else {
        return Err(views.err().map_or_else(
            || VisionError::result("calibrate two cameras", "pictures", "none"),
            |e| with_rejections(e, &rejected),
        ));
    };
    let views = views.map_err(|e| with_guess(e, files, board));
    let (own, seen) = (markers.clone(), views.as_ref().ok().cloned());
    let others = move |noise: &CornerNoise| {
        let statement = |other: Alternative| {
            // Tags are read without their places, markers' corners with them.
            let views = match &seen {
                Some(seen) if own.corners_by_number() => Ok(seen.clone()),
                _ => marker_pairs(files, &other.board).views,
            };
            BoardStatement { says: other.says, points: other.board.points, places: other.board.places, views }
        };
        if own.corners_by_number() && seen.is_none() {
            return Vec::new();
        }
        alternatives(&own, noise).into_iter().map(statement).collect()
    };
    Ok(BoardSearch {
        stated: BoardStatement {
            says: String::new(),
            points: markers.points.clone(),
            places: markers.places.clone(),
            views,
        },
        image_size,
        rejected,
        remarks,
        refinement: BTreeMap::new(),
        chosen: "markers".to_string(),
        others: Box::new(others),
    })
}

fn document(
    board: &Board,
    image_size_px: [usize; 2],
    points: &[Vector3<f64>],
    solution: &StereoSolution,
    refinement: BTreeMap<String, f64>,
    refinement_chosen: String,
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
            warp_sd_mm: if solution.warp_used { [sd(warp), sd(warp + 1)] } else { [0.0; 2] },
        },
        refinement,
        refinement_chosen,
        projection_sd_px: projection_sd(points, solution),
        covariance: (0..warp).map(|i| (0..warp).map(|j| covariance[(i, j)]).collect()).collect(),
        warnings: solution.warnings.clone(),
        provenance: wcal_core::Provenance::default(),
    }
}

/// Sd (px) of where a point at the boards' mean depth appears, over a 3x3 grid of each picture, from the intrinsics' covariance.
fn projection_sd(points: &[Vector3<f64>], solution: &StereoSolution) -> Vec<Vec<f64>> {
    let state = &solution.bundle.state;
    let centre = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let depth = state.left_from_board.iter().map(|p| (p * nalgebra::Point3::from(centre)).z).sum::<f64>()
        / state.left_from_board.len().max(1) as f64;
    (0..2)
        .map(|c| {
            let camera = &state.cameras[c];
            let intrinsics = camera.intrinsics();
            let block = solution
                .bundle
                .shared_covariance
                .view((c * intrinsics, c * intrinsics), (intrinsics, intrinsics));
            let [w, h] = camera.image_size_px.map(|v| v as f64);
            (0..9)
                .map(|k| {
                    let px =
                        Vector2::new(w * (f64::from(k % 3) + 0.5) / 3.0, h * (f64::from(k / 3) + 0.5) / 3.0);
                    camera
                        .undistort(&px)
                        .and_then(|n| {
                            camera.project_with_jacobian(&Vector3::new(n.x * depth, n.y * depth, depth))
                        })
                        .map_or(f64::NAN, |(_, _, j)| {
                            let j = j.columns(0, intrinsics);
                            ((j * block * j.transpose()).trace() / 2.0).sqrt()
                        })
                })
                .collect()
        })
        .collect()
}
