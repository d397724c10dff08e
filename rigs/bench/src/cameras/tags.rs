//! AprilTag pictures of the family 36h11 (Olson, "AprilTag: a robust and flexible visual fiducial
//! system", ICRA 2011).

/// Cells across a tag with its white margin; the black square is eight of them.
pub(crate) const TAG_CELLS: usize = 10;

/// First codes of the family as published: github.com/AprilRobotics/apriltag, version 3, tag36h11.c
/// (BSD licence).
const CODES: [u64; 8] = [
    0xd_7e00_984b,
    0xd_da66_4ca7,
    0xd_c4a1_c821,
    0xe_17b4_70e9,
    0xe_f91d_01b1,
    0xf_429c_dd73,
    0x0_5da2_9225,
    0x1_106c_ba43,
];

/// Cells (column, row) of a quarter's nine bits, counted from the black border's corner; the other
/// quarters are turned (tag36h11.c).
const QUARTER: [(usize, usize); 9] = [
    (1, 1),
    (2, 1),
    (3, 1),
    (4, 1),
    (5, 1),
    (2, 2),
    (3, 2),
    (4, 2),
    (3, 3),
];

/// White cells of tag `id`, row by row from the top left; `None` for an id that is not in the
/// table.
pub fn tag_cells(id: u32) -> Option<[[bool; TAG_CELLS]; TAG_CELLS]> {
    let code = *CODES.get(id as usize)?;
    // White margin, black border.
    let mut cells = [[false; TAG_CELLS]; TAG_CELLS];
    for (row, line) in cells.iter_mut().enumerate() {
        for (column, cell) in line.iter_mut().enumerate() {
            *cell = [row, column].iter().any(|k| *k == 0 || *k == TAG_CELLS - 1);
        }
    }
    // The highest bit comes first; each quarter is the last one turned clockwise.
    for quarter in 0..4 {
        for (k, place) in QUARTER.iter().enumerate() {
            let (column, row) = (0..quarter).fold(*place, |(x, y), _| (7 - y, x));
            cells[row + 1][column + 1] = code >> (35 - (9 * quarter + k)) & 1 == 1;
        }
    }
    Some(cells)
}
