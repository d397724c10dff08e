//! `stereo-calibrate` from two folders: pictures, corners, the method of refinement chosen from the data, the solve, the document.

use crate::calibrate::board::{Board, Pattern, board_points};
use crate::calibrate::bundle::BoardView;
use crate::calibrate::chessboard::{BoardSize, Finder, continues_beyond, find_chessboard};
use crate::calibrate::document::{
    BoardDocument, RejectedView, STEREO_FORMAT, StereoDocument, camera_document,
};
use crate::calibrate::markers::{self, MarkerBoard};
use crate::calibrate::refinement::{View, choose_refinement};
use crate::calibrate::solution::{StereoSolution, calibrate_stereo, leave_one_out};
use crate::camera::lens::Lens;
use crate::error::VisionError;
use crate::pairs::{PairFiles, list_pictures, pair_files};
use crate::picture::Picture;
use crate::rigid::rows;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
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
    let mut rejected = Vec::new();
    let (points, views, image_size, refinement, chosen) = match &board.pattern {
        Pattern::Chessboard => {
            check_size(&files, board.size)?;
            let (views, size) = usable(&files, &mut rejected, &|p, i| whole_board(p, board.size, i))?;
            let points = board_points(board.size.columns, board.size.rows, board.square_mm);
            let (refined, tried, chosen) =
                choose_refinement(&points, board.size, &views, (size, lens), progress)?;
            (points, refined, size, tried, chosen)
        }
        Pattern::Charuco { .. } | Pattern::AprilGrid { .. } => {
            let markers = MarkerBoard::new(board)?;
            let points = markers.points.clone();
            let (views, size) = marker_views(&files, &mut rejected, &markers)?;
            (points, views, size, BTreeMap::new(), "markers".to_string())
        }
    };
    progress(&format!("{} pairs show the board; solving", views.len()));
    let solution =
        calibrate_stereo(&points, views, image_size, lens).map_err(|e| with_rejections(e, &rejected))?;
    let mut document = document(board, image_size, &points, &solution, refinement, chosen);
    document.rejected_views.splice(0..0, rejected);
    Ok((document, solution))
}

/// Adds to a refusal the reasons why views were missing.
fn with_rejections(error: VisionError, rejected: &[RejectedView]) -> VisionError {
    match error {
        VisionError::Result { action, expected, found } if !rejected.is_empty() => {
            let mut reasons: Vec<String> =
                rejected.iter().take(4).map(|r| format!("{}: {}", r.view, r.why)).collect();
            if rejected.len() > 4 {
                reasons.push(format!("and {} more", rejected.len() - 4));
            }
            VisionError::Result { action, expected, found: format!("{found} ({})", reasons.join("; ")) }
        }
        other => other,
    }
}

/// Reads both pictures of a pair; the reason where it cannot be used.
fn read_pair(files: &PairFiles) -> Result<[Picture; 2], String> {
    let (Some(left), Some(right)) = (&files.left, &files.right) else {
        return Err(format!(
            "the {} picture is missing",
            if files.left.is_none() { "left" } else { "right" }
        ));
    };
    let pictures = [left, right].map(|p| Picture::read(p).map_err(|e| e.to_string()));
    let [left_picture, right_picture] = pictures;
    let pictures = [left_picture?, right_picture?];
    for (picture, path) in pictures.iter().zip([left, right]) {
        if let Some(why) = picture.unusable() {
            return Err(format!("{}: {why}", path.display()));
        }
    }
    if [pictures[0].width, pictures[0].height] != [pictures[1].width, pictures[1].height] {
        return Err(format!(
            "different sizes: left {}x{}, right {}x{} px",
            pictures[0].width, pictures[0].height, pictures[1].width, pictures[1].height
        ));
    }
    if pictures[0] == pictures[1] {
        return Err("the left and the right picture are the same".into());
    }
    Ok(pictures)
}

/// The size that most pictures have; others are rejected.
fn common_size(sizes: impl Iterator<Item = [usize; 2]>) -> Option<[usize; 2]> {
    let mut counts: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    for s in sizes {
        *counts.entry(s).or_default() += 1;
    }
    counts.into_iter().max_by_key(|c| c.1).map(|c| c.0)
}

/// Width to which pictures are reduced where only the board's size is in question, px.
const PROBE_PX: usize = 800;

/// Coarse corners of one side's picture, or why it is of no use.
type CornerReader<'a> = dyn Fn(&Picture, &str) -> Result<Vec<Vector2<f64>>, String> + Sync + 'a;

fn usable(
    files: &[PairFiles],
    rejected: &mut Vec<RejectedView>,
    find: &CornerReader<'_>,
) -> Result<(Vec<View>, [usize; 2]), VisionError> {
    let found: Vec<Result<View, String>> = files
        .par_iter()
        .map(|f| {
            let pictures = read_pair(f)?;
            let coarse = [find(&pictures[0], "left")?, find(&pictures[1], "right")?];
            Ok(View { name: f.name.clone(), pictures, coarse })
        })
        .collect();
    let size = common_size(found.iter().flatten().map(|v| [v.pictures[0].width, v.pictures[0].height]));
    let mut views: Vec<View> = Vec::new();
    for (file, view) in files.iter().zip(found) {
        let why = match view {
            Err(why) => why,
            Ok(v) if Some([v.pictures[0].width, v.pictures[0].height]) != size => {
                format!("size {}x{} px, other pairs differ", v.pictures[0].width, v.pictures[0].height)
            }
            Ok(v) => {
                let same =
                    views.iter().find(|o| o.pictures[0] == v.pictures[0] || o.pictures[1] == v.pictures[1]);
                match same {
                    Some(other) => format!("shares a picture with {}", other.name),
                    None => {
                        views.push(v);
                        continue;
                    }
                }
            }
        };
        rejected.push(RejectedView { view: file.name.clone(), why });
    }
    match size {
        Some(size) if views.len() >= 3 => Ok((views, size)),
        _ => {
            let count = views.len();
            Err(with_rejections(
                VisionError::result(
                    "calibrate two cameras",
                    "at least 3 pairs that show the whole board in both pictures",
                    format!("{count} of {} pairs", files.len()),
                ),
                rejected,
            ))
        }
    }
}

/// Coarse corners of the whole board, or why there are none.
fn whole_board(picture: &Picture, size: BoardSize, side: &str) -> Result<Vec<Vector2<f64>>, String> {
    let find = |finder: Finder| find_chessboard(picture, size, finder).map_err(|e| e.to_string());
    let whole = |points: Vec<Vector2<f64>>| match continues_beyond(picture, size, &points) {
        None => Ok(points),
        Some(edge) => Err(format!(
            "{side} picture: wrong board size? {size} inner corners found, but the pattern continues beyond its {edge} edge"
        )),
    };
    let found = match find(Finder::Classic)? {
        Some(points) => Some(points),
        None => find(Finder::Sectors)?,
    };
    match found {
        Some(points) => whole(points),
        None => Err(format!("{side} picture: no board of {size} inner corners (absent, cut off or blurred)")),
    }
}

/// Left pictures, spread over the folder, that are examined before the stated size is doubted.
const PROBES: usize = 3;

/// Refuses a size that no probe shows while all of them show one other whole size: the finders take minutes to fail on a whole folder, and a
/// board cut off in one picture appears smaller than it is.
fn check_size(files: &[PairFiles], size: BoardSize) -> Result<(), VisionError> {
    let count = PROBES.min(files.len());
    let probes: Vec<Picture> = (0..count)
        .filter_map(|k| files[k * files.len() / count].left.as_ref())
        .filter_map(|path| Some(Picture::read(path).ok()?.reduced(PROBE_PX)))
        .collect();
    let shows = |picture: &Picture, size: BoardSize| -> Result<bool, VisionError> {
        let found = find_chessboard(picture, size, Finder::Classic)?;
        Ok(found.is_some_and(|points| continues_beyond(picture, size, &points).is_none()))
    };
    let all_show = |size: BoardSize| -> Result<bool, VisionError> {
        for picture in &probes {
            if !shows(picture, size)? {
                return Ok(false);
            }
        }
        Ok(!probes.is_empty())
    };
    let stated: Result<Vec<bool>, VisionError> = probes
        .par_iter()
        .map(|picture| Ok(find_chessboard(picture, size, Finder::Classic)?.is_some()))
        .collect();
    if stated?.contains(&true) {
        return Ok(());
    }
    let (c, r) = (size.columns as i64, size.rows as i64);
    let others = [
        (c - 1, r),
        (c, r - 1),
        (c - 1, r - 1),
        (c + 1, r),
        (c, r + 1),
        (c + 1, r + 1),
        (c - 2, r),
        (c, r - 2),
    ];
    for (columns, rows) in others.into_iter().filter(|(c, r)| c.min(r) >= &3) {
        let other = BoardSize { columns: columns as usize, rows: rows as usize };
        if all_show(other)? {
            return Err(VisionError::result(
                "find the board",
                format!("{size} inner corners"),
                format!("a whole board of {other} in {} pictures: wrong board size?", probes.len()),
            ));
        }
    }
    Ok(())
}

fn marker_views(
    files: &[PairFiles],
    rejected: &mut Vec<RejectedView>,
    board: &MarkerBoard,
) -> Result<(Vec<BoardView>, [usize; 2]), VisionError> {
    type Found = Result<(BoardView, [usize; 2]), String>;
    let found: Vec<Found> = files
        .par_iter()
        .map(|f| {
            let pictures = read_pair(f)?;
            let left = markers::corners(board, &pictures[0]).map_err(|w| format!("left picture: {w}"))?;
            let right = markers::corners(board, &pictures[1]).map_err(|w| format!("right picture: {w}"))?;
            Ok((BoardView { name: f.name.clone(), left, right }, [pictures[0].width, pictures[0].height]))
        })
        .collect();
    let size = common_size(found.iter().flatten().map(|v| v.1));
    let mut views = Vec::new();
    for (file, view) in files.iter().zip(found) {
        match view {
            Ok((v, s)) if Some(s) == size => views.push(v),
            Ok(_) => rejected
                .push(RejectedView { view: file.name.clone(), why: "size differs from other pairs".into() }),
            Err(why) => rejected.push(RejectedView { view: file.name.clone(), why }),
        }
    }
    match size {
        Some(size) if views.len() >= 3 => Ok((views, size)),
        _ => Err(with_rejections(
            VisionError::result(
                "calibrate two cameras",
                "at least 3 pairs that show the board in both pictures",
                format!("{} of {} pairs", views.len(), files.len()),
            ),
            rejected,
        )),
    }
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
