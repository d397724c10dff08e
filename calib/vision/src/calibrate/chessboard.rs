//! Finds a chessboard's inner corners, in an order that the pattern itself fixes, and refines them.
//!
//! Beyond the outer corners the grid's homography predicts the squares' middles: alternating
//! contrast there, compared with that inside, means a larger board than stated.

use crate::calibrate::bundle::Corners;
use crate::calibrate::corner::fit_corner;
use crate::error::{OpenCvContext, VisionError};
use crate::homography::{homography, mapped};
use crate::median::median;
use crate::picture::Picture;
use nalgebra::Vector2;
use opencv::calib3d;
use opencv::core::{Point2f, Size, Vector};
use rayon::prelude::*;

/// Inner corners of a board: columns and rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardSize {
    /// Inner corners along a row.
    pub columns: usize,
    /// Inner corners along a column.
    pub rows: usize,
}

impl BoardSize {
    /// Whether the colours distinguish a turn by 180 degrees: one side even, the other odd.
    pub(crate) fn orientation_is_unique(&self) -> bool {
        (self.columns + self.rows) % 2 == 1
    }
}

impl std::fmt::Display for BoardSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.columns, self.rows)
    }
}

/// Window of a corner's refinement, as a share of the distance to its nearest neighbour. RMS of the
/// solve with 0.3, 0.5 and 0.7: OpenCV's thirteen pairs 0.164, 0.161 and 0.163 px, the rendered
/// bench 0.0088, 0.0070 and 0.0058 px.
const WINDOW: f64 = 0.7;
/// Smallest radius of that window, px.
const MIN_WINDOW_PX: f64 = 3.0;

/// Which of OpenCV's finders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finder {
    /// Quads of thresholded pictures: quick, also where there is no board.
    Classic,
    /// Sectors: copes with blur and light that the classic one does not; seconds where there is no
    /// board.
    Sectors,
}

/// Coarse corners (px), row by row; the order is right-handed and starts at a corner whose outer
/// square is dark where the board's colours determine. None where the board is not found whole.
///
/// # Errors
/// Where OpenCV fails.
pub fn find_chessboard(
    picture: &Picture,
    board: BoardSize,
    finder: Finder,
) -> Result<Option<Vec<Vector2<f64>>>, VisionError> {
    let mat = picture.to_mat()?;
    let size = Size::new(board.columns as i32, board.rows as i32);
    let mut found = Vector::<Point2f>::new();
    let ok = match finder {
        Finder::Classic => {
            let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH
                | calib3d::CALIB_CB_NORMALIZE_IMAGE
                | calib3d::CALIB_CB_FAST_CHECK;
            calib3d::find_chessboard_corners(&mat, size, &mut found, flags)
                .doing("findChessboardCorners")?
        }
        Finder::Sectors => {
            let flags = calib3d::CALIB_CB_NORMALIZE_IMAGE | calib3d::CALIB_CB_ACCURACY;
            calib3d::find_chessboard_corners_sb(&mat, size, &mut found, flags)
                .doing("findChessboardCornersSB")?
        }
    };
    if !ok || found.len() != board.columns * board.rows {
        return Ok(None);
    }
    let points: Vec<_> = found
        .iter()
        .map(|p| Vector2::new(f64::from(p.x), f64::from(p.y)))
        .collect();
    Ok(Some(normalise_order(picture, board, points)))
}

/// The two finders start at opposite ends and may run in either direction; the pattern decides.
fn normalise_order(
    picture: &Picture,
    board: BoardSize,
    mut points: Vec<Vector2<f64>>,
) -> Vec<Vector2<f64>> {
    let (c, r) = (board.columns, board.rows);
    let (u, v) = (points[c - 1] - points[0], points[(r - 1) * c] - points[0]);
    // With y down, rows and columns of a board seen from its front have u x v > 0.
    if u.perp(&v) < 0.0 {
        points = (0..r)
            .flat_map(|j| (0..c).rev().map(move |i| j * c + i))
            .map(|k| points[k])
            .collect();
    }
    if board.orientation_is_unique() {
        // Dark minus light over the inner squares, the first one counted as the colour of the first
        // outer square.
        let mut sum = 0.0;
        for j in 0..r - 1 {
            for i in 0..c - 1 {
                let k = j * c + i;
                let centre = (points[k] + points[k + 1] + points[k + c] + points[k + c + 1]) / 4.0;
                let sign = if (i + j) % 2 == 0 { 1.0 } else { -1.0 };
                sum += sign * picture.sample(centre.x, centre.y);
            }
        }
        if sum > 0.0 {
            points.reverse();
        }
    } else if (points[0].y, points[0].x) > (points[c * r - 1].y, points[c * r - 1].x) {
        // Ambiguous by 180 degrees: the end nearer to the top comes first, for both cameras alike.
        points.reverse();
    }
    points
}

/// Distance (px) to the nearest neighbour in the grid, and the directions of the grid's rows and
/// columns at a corner.
fn neighbourhood(board: BoardSize, points: &[Vector2<f64>], k: usize) -> (f64, [Vector2<f64>; 2]) {
    let (c, i, j) = (board.columns, k % board.columns, k / board.columns);
    let mut nearest = f64::INFINITY;
    let mut along = |here: usize, count: usize, stride: usize| {
        let before = points[if here > 0 { k - stride } else { k }];
        let after = points[if here + 1 < count { k + stride } else { k }];
        for d in [(before - points[k]).norm(), (after - points[k]).norm()] {
            if d > 0.0 {
                nearest = nearest.min(d);
            }
        }
        after - before
    };
    let sides = [along(i, c, 1), along(j, board.rows, c)];
    (nearest, sides)
}

/// Refined corners ([`fit_corner`], twice: the finder's places are a pixel off); a corner that
/// cannot be refined is none.
pub fn refine(picture: &Picture, board: BoardSize, coarse: &[Vector2<f64>]) -> Corners {
    let once = |start: &[Vector2<f64>]| -> Corners {
        (0..start.len())
            .into_par_iter()
            .map(|k| {
                let (distance, sides) = neighbourhood(board, start, k);
                fit_corner(
                    picture,
                    &start[k],
                    sides,
                    (WINDOW * distance).max(MIN_WINDOW_PX),
                )
            })
            .collect()
    };
    let found = once(coarse);
    let start: Vec<Vector2<f64>> = found
        .iter()
        .zip(coarse)
        .map(|(f, c)| f.unwrap_or(*c))
        .collect();
    once(&start)
}

/// Whether the pattern continues beyond the corners found: then the board is larger than stated.
/// Names the side.
pub(crate) fn continues_beyond(
    picture: &Picture,
    board: BoardSize,
    points: &[Vector2<f64>],
) -> Option<&'static str> {
    let (c, r) = (board.columns as i64, board.rows as i64);
    let cell = |k: i64| Vector2::new((k % c) as f64, (k / c) as f64);
    let cells: Vec<_> = (0..r * c).map(cell).collect();
    let homography = homography(&cells, points)?;
    // Contrast between the diagonals of a corner's four squares, with the sign of its place in the
    // grid; with `out` of the squares on that side only.
    let contrast = |i: i64, j: i64, out: [f64; 2]| -> Option<f64> {
        let mut sum = 0.0;
        for (dx, dy, sign) in [
            (-0.35, -0.35, 1.0),
            (0.35, 0.35, 1.0),
            (-0.35, 0.35, -1.0),
            (0.35, -0.35, -1.0),
        ] {
            if dx * out[0] + dy * out[1] < 0.0 {
                continue;
            }
            let at = mapped(&homography, &Vector2::new(i as f64 + dx, j as f64 + dy))?;
            if !picture.contains(at.x, at.y, 1.0) {
                return None;
            }
            sum += sign * picture.sample(at.x, at.y);
        }
        Some(if (i + j).rem_euclid(2) == 0 {
            sum
        } else {
            -sum
        })
    };
    let typical = |cells: Vec<(i64, i64)>, out: [f64; 2]| -> Option<f64> {
        let values: Vec<f64> = cells
            .iter()
            .filter_map(|&(i, j)| contrast(i, j, out))
            .collect();
        // A side that is half outside the picture says nothing of what lies beyond.
        (2 * values.len() >= cells.len().max(2)).then(|| median(values))
    };
    // On a side only two of a corner's four squares count: half the contrast.
    let inside = 0.5
        * typical(
            (0..r).flat_map(|j| (0..c).map(move |i| (i, j))).collect(),
            [0.0; 2],
        )?;
    let sides = [
        (
            "left",
            [-1.0, 0.0],
            (0..r).map(|j| (-1, j)).collect::<Vec<_>>(),
        ),
        ("right", [1.0, 0.0], (0..r).map(|j| (c, j)).collect()),
        ("top", [0.0, -1.0], (0..c).map(|i| (i, -1)).collect()),
        ("bottom", [0.0, 1.0], (0..c).map(|i| (i, r)).collect()),
    ];
    // Outside a true board lies its uniform margin or something that does not alternate with the
    // squares: no contrast, against all of it.
    sides
        .into_iter()
        .find_map(|(name, out, cells)| (typical(cells, out)? / inside > 0.6).then_some(name))
}
