//! Boards with markers: ChArUco by OpenCV's detector, AprilGrid by AprilTag. Partly hidden boards are welcome.

use crate::calibrate::board::{Board, Pattern, board_points};
use crate::calibrate::corner::fit_corner;
use crate::calibrate::initial::Corners;
use crate::error::{OpenCvContext, VisionError};
use crate::picture::Picture;
use crate::tags::detection::{Search, find_tags, tag_corners};
use nalgebra::{Vector2, Vector3};
use opencv::aruco::{
    CharucoBoard, Dictionary, detect_markers_def, get_predefined_dictionary_i32,
    interpolate_corners_charuco_def,
};
use opencv::core::{Point2f, Ptr, Vector};

/// A marker board ready for detection.
pub struct MarkerBoard {
    /// Points, mm, one entry a corner.
    pub points: Vec<Vector3<f64>>,
    board: Board,
    dictionary: i32,
}

/// OpenCV's predefined dictionaries in the order of its enumeration.
const DICTIONARIES: [&str; 21] = [
    "DICT_4X4_50",
    "DICT_4X4_100",
    "DICT_4X4_250",
    "DICT_4X4_1000",
    "DICT_5X5_50",
    "DICT_5X5_100",
    "DICT_5X5_250",
    "DICT_5X5_1000",
    "DICT_6X6_50",
    "DICT_6X6_100",
    "DICT_6X6_250",
    "DICT_6X6_1000",
    "DICT_7X7_50",
    "DICT_7X7_100",
    "DICT_7X7_250",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
];

impl MarkerBoard {
    /// Checks the description and lays out the points.
    ///
    /// # Errors
    /// Where a dictionary or family is unknown, or sizes contradict each other.
    pub fn new(board: &Board) -> Result<Self, VisionError> {
        let (c, r, square) = (board.size.columns, board.size.rows, board.square_mm);
        let (points, dictionary) = match &board.pattern {
            Pattern::Charuco { marker_mm, dictionary } => {
                if !(*marker_mm > 0.0 && *marker_mm < square) {
                    return Err(VisionError::result(
                        "lay out the board",
                        format!("a marker smaller than the square of {square} mm"),
                        format!("{marker_mm} mm"),
                    ));
                }
                let index = DICTIONARIES.iter().position(|d| d.eq_ignore_ascii_case(dictionary)).ok_or_else(
                    || {
                        VisionError::result(
                            "lay out the board",
                            format!("one of {}", DICTIONARIES.join(", ")),
                            dictionary,
                        )
                    },
                )?;
                (board_points(c, r, square), index as i32)
            }
            Pattern::AprilGrid { gap_mm, .. } => {
                // Tags stand upright and are numbered from the lower left, as in Kalibr's grids; y points down.
                let points = (0..c * r)
                    .flat_map(|k| {
                        let (x, y) = ((k % c) as f64, -((k / c) as f64));
                        let centre = Vector3::new(x, y, 0.0) * (square + gap_mm);
                        tag_corners(square).map(|p| p + centre)
                    })
                    .collect();
                (points, 0)
            }
            Pattern::Chessboard => (board_points(c, r, square), 0),
        };
        Ok(Self { points, board: board.clone(), dictionary })
    }
}

/// Corners of the board in a picture, or why there are too few.
///
/// # Errors
/// A sentence.
pub fn corners(board: &MarkerBoard, picture: &Picture) -> Result<Corners, String> {
    let found = match &board.board.pattern {
        Pattern::Charuco { marker_mm, .. } => {
            charuco(board, picture, *marker_mm).map_err(|e| e.to_string())?
        }
        Pattern::AprilGrid { family, .. } => april_grid(board, picture, family).map_err(|e| e.to_string())?,
        Pattern::Chessboard => vec![None; board.points.len()],
    };
    let count = found.iter().flatten().count();
    if count < 8 {
        return Err(format!("expected at least 8 corners of the board, found {count}"));
    }
    Ok(found)
}

fn charuco(board: &MarkerBoard, picture: &Picture, marker_mm: f64) -> Result<Corners, VisionError> {
    let (c, r, square) = (board.board.size.columns, board.board.size.rows, board.board.square_mm);
    let dictionary: Ptr<Dictionary> =
        get_predefined_dictionary_i32(board.dictionary).doing("getPredefinedDictionary")?;
    let layout =
        CharucoBoard::create(c as i32 + 1, r as i32 + 1, square as f32, marker_mm as f32, &dictionary)
            .doing("CharucoBoard")?;
    let mat = picture.to_mat()?;
    let (mut marker_corners, mut marker_ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
    detect_markers_def(&mat, &dictionary, &mut marker_corners, &mut marker_ids).doing("detectMarkers")?;
    let mut out = vec![None; board.points.len()];
    if marker_ids.is_empty() {
        return Ok(out);
    }
    let (mut points, mut ids) = (Vector::<Point2f>::new(), Vector::<i32>::new());
    interpolate_corners_charuco_def(&marker_corners, &marker_ids, &mat, &layout, &mut points, &mut ids)
        .doing("interpolateCornersCharuco")?;
    for (id, p) in ids.iter().zip(points.iter()) {
        if let Some(slot) = usize::try_from(id).ok().and_then(|k| out.get_mut(k)) {
            *slot = Some(Vector2::new(f64::from(p.x), f64::from(p.y)));
        }
    }
    // The window stays clear of the markers.
    let clear = 0.8 * 0.5 * (1.0 - marker_mm / square);
    let coarse = out.clone();
    for (k, slot) in out.iter_mut().enumerate() {
        let Some(here) = coarse[k] else { continue };
        let offset_to = |other: Option<usize>| other.and_then(|o| coarse[o]).map(|p| p - here);
        let row = offset_to((k % c + 1 < c).then_some(k + 1)).or(offset_to((k % c > 0).then(|| k - 1)));
        let column = offset_to((k + c < coarse.len()).then_some(k + c)).or(offset_to(k.checked_sub(c)));
        *slot = row
            .zip(column)
            .and_then(|(u, v)| fit_corner(picture, &here, [u, v], (clear * u.norm().min(v.norm())).max(3.0)))
            .map(|f| f.position_px)
            .or(Some(here));
    }
    Ok(out)
}

fn april_grid(board: &MarkerBoard, picture: &Picture, family: &str) -> Result<Corners, VisionError> {
    let mut out = vec![None; board.points.len()];
    for tag in find_tags(picture, family, None, Search::Whole)? {
        let first = 4 * tag.id as usize;
        if tag.refined && first + 4 <= out.len() {
            for (slot, corner) in out[first..first + 4].iter_mut().zip(tag.corners_px) {
                *slot = Some(corner);
            }
        }
    }
    Ok(out)
}
