//! Numbers that the columns of a table may hold, by their names: one list for every table that is read.
//!
//! Overflow codes of instruments (9.9e37, the largest float) have to get through where a reader leaves their rows out by name; squares and
//! fourth powers of what gets through are still numbers.

use wcal_core::ranges::{OutOfRange, Range, range_of};

/// Most columns of a table; they are counted before the first row is read.
pub const MAX_COLUMNS: usize = 1000;

/// A column of any other name, and what instruments fill with codes.
const ANY: Range = Range::real("", -1e60, 1e60);

/// Both signs throughout: what may not be negative is said where the column means something.
const RANGES: &[Range] = &[
    Range::real("t_s", -1e11, 1e11),
    Range::real("dwell_s", -1e9, 1e9),
    Range::real("average_s", -1e6, 1e6),
    // A table in um passes: it is named as one beside the whisker's length and the trajectories.
    Range::real("stage_mm", -1e5, 1e5),
    Range::real("speed_mm_s", -1e5, 1e5),
    Range::real("groove_x_mm", -1e7, 1e7),
    Range::real("groove_y_mm", -1e7, 1e7),
    Range::real("groove_z_mm", -1e7, 1e7),
    Range::real("fbg_1_sd_pm", -1e9, 1e9),
    Range::real("fbg_2_sd_pm", -1e9, 1e9),
    Range::real("moment_1_nmm", -1e6, 1e6),
    Range::real("moment_2_nmm", -1e6, 1e6),
    Range::real("object_x_mm", -1e7, 1e7),
    Range::real("object_y_mm", -1e7, 1e7),
    Range::real("object_z_mm", -1e7, 1e7),
    Range::real("object_x_m", -1e4, 1e4),
    Range::real("object_y_m", -1e4, 1e4),
    Range::real("object_z_m", -1e4, 1e4),
    Range::real("base_x_mm", -1e7, 1e7),
    Range::real("base_y_mm", -1e7, 1e7),
    Range::real("base_z_mm", -1e7, 1e7),
    Range::real("base_x_m", -1e4, 1e4),
    Range::real("base_y_m", -1e4, 1e4),
    Range::real("base_z_m", -1e4, 1e4),
    Range::real("base_qw", -2.0, 2.0),
    Range::real("base_qx", -2.0, 2.0),
    Range::real("base_qy", -2.0, 2.0),
    Range::real("base_qz", -2.0, 2.0),
    Range::real("x_mm", -1e7, 1e7),
    Range::real("y_mm", -1e7, 1e7),
    Range::real("z_mm", -1e7, 1e7),
    ANY,
];

/// The range of a column.
pub fn column_range(name: &str) -> &'static Range {
    range_of(name, RANGES).unwrap_or(&ANY)
}

/// Judges the number in a cell of a column.
///
/// # Errors
/// Where the column cannot have it.
pub fn judge_cell(name: &str, value: f64) -> Result<(), OutOfRange> {
    column_range(name).judge(name, value, value.fract() == 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_a_range_and_codes_of_instruments_get_through() {
        for name in ["stage_mm", "t_s", "groove_x_mm", "response", "a column of the user's", ""] {
            for value in [1e300, -1e300, f64::NAN, f64::INFINITY] {
                assert!(judge_cell(name, value).is_err(), "{name} {value}");
            }
            assert_eq!(judge_cell(name, 1.0), Ok(()), "{name}: negative control");
        }
        assert_eq!(judge_cell("response", 9.91e37), Ok(()));
        let error = judge_cell("stage_mm", 1e9).unwrap_err().to_string();
        assert_eq!(error, "stage_mm: expected a number between -100000 and 100000, found 1e9");
    }
}
