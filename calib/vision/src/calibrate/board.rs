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
        /// Laid out as before OpenCV 4.6: with an even number of rows of squares it begins with a
        /// light one.
        legacy: bool,
    },
    /// A grid of AprilTags; columns and rows count tags, the square is the tag's side.
    AprilGrid {
        /// Gap between tags, mm.
        gap_mm: f64,
        /// Family, e.g. `tag36h11`.
        family: String,
        /// How the tags are numbered.
        order: TagOrder,
    },
}

/// How upright tags are numbered over a grid; by default as in Kalibr's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TagOrder {
    /// Column by column, not row by row.
    pub by_columns: bool,
    /// The first tag is at the right.
    pub from_right: bool,
    /// The first tag is at the top.
    pub from_top: bool,
    /// Number of the first tag.
    pub first: u32,
}

impl TagOrder {
    const NAMES: [&str; 8] = [
        "aprilgrid",
        "aprilgrid-rows-from-upper-left",
        "aprilgrid-rows-from-lower-right",
        "aprilgrid-rows-from-upper-right",
        "aprilgrid-columns-from-lower-left",
        "aprilgrid-columns-from-upper-left",
        "aprilgrid-columns-from-lower-right",
        "aprilgrid-columns-from-upper-right",
    ];

    /// All eight with the names of their patterns, the default one first; the first tag is 0.
    pub fn all() -> impl Iterator<Item = (&'static str, Self)> {
        let order = |k: usize| Self {
            by_columns: k & 4 != 0,
            from_right: k & 2 != 0,
            from_top: k & 1 != 0,
            first: 0,
        };
        Self::NAMES
            .into_iter()
            .enumerate()
            .map(move |(k, name)| (name, order(k)))
    }
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
pub fn board_points(columns: usize, rows: usize, square: f64) -> Vec<Vector3<f64>> {
    (0..rows)
        .flat_map(|j| {
            (0..columns).map(move |i| Vector3::new(i as f64 * square, j as f64 * square, 0.0))
        })
        .collect()
}
