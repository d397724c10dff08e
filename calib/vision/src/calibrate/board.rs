//! The board as its user states it, and where its corners lie.

use crate::calibrate::chessboard::BoardSize;
use nalgebra::Vector3;

/// What is on the board.
#[derive(Debug, Clone, PartialEq)]
pub enum Pattern {
    /// Plain squares.
    Chessboard,
    /// Squares with ArUco markers in the light ones.
    Charuco {
        /// Side of a marker, mm.
        marker_mm: f64,
        /// OpenCV's dictionary name, e.g. `DICT_4X4_50`.
        dictionary: String,
    },
    /// A grid of AprilTags; columns and rows count tags, the square is the tag's side.
    AprilGrid {
        /// Gap between tags, mm.
        gap_mm: f64,
        /// Family, e.g. `tag36h11`.
        family: String,
    },
}

/// Board as stated by the user.
#[derive(Debug, Clone, PartialEq)]
pub struct Board {
    /// Inner corners (tags for an AprilGrid).
    pub size: BoardSize,
    /// Side of a square (of a tag), mm.
    pub square_mm: f64,
    /// Pattern.
    pub pattern: Pattern,
}

/// Flat board points, row by row, z = 0.
#[must_use]
pub fn board_points(columns: usize, rows: usize, square: f64) -> Vec<Vector3<f64>> {
    (0..rows)
        .flat_map(|j| (0..columns).map(move |i| Vector3::new(i as f64 * square, j as f64 * square, 0.0)))
        .collect()
}
