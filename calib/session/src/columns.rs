//! Numbers that the columns of a table may hold, by their names: one list for every table that is
//! read.
//!
//! Overflow codes of instruments (9.9e37, the largest float) have to get through where a reader
//! leaves their rows out by name; squares and fourth powers of what gets through are still numbers.

use wcal_core::ranges::Range;

/// The range of a column. Both signs throughout: what may not be negative is said where the column
/// means something.
pub(crate) fn column_range(name: &str) -> Range {
    let most = match name {
        "t_s" => 1e11,
        "dwell_s" | "fbg_1_sd_pm" | "fbg_2_sd_pm" => 1e9,
        "average_s" | "moment_1_nmm" | "moment_2_nmm" => 1e6,
        // A table in um passes: it is named as one beside the whisker's length and the
        // trajectories.
        "stage_mm" | "speed_mm_s" => 1e5,
        "groove_x_mm" | "groove_y_mm" | "groove_z_mm" => 1e7,
        "object_x_mm" | "object_y_mm" | "object_z_mm" => 1e7,
        "object_x_m" | "object_y_m" | "object_z_m" => 1e4,
        "base_x_mm" | "base_y_mm" | "base_z_mm" => 1e7,
        "base_x_m" | "base_y_m" | "base_z_m" => 1e4,
        "base_qw" | "base_qx" | "base_qy" | "base_qz" => 2.0,
        "x_mm" | "y_mm" | "z_mm" => 1e7,
        // A column of any other name, and what instruments fill with codes.
        _ => 1e60,
    };
    Range::real("", -most, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_a_range_and_codes_of_instruments_get_through() {
        let judge = |name: &str, value| column_range(name).judge(name, value, true);
        for name in [
            "stage_mm",
            "t_s",
            "groove_x_mm",
            "response",
            "a column of the user's",
            "",
        ] {
            for value in [1e300, -1e300, f64::NAN, f64::INFINITY] {
                assert!(judge(name, value).is_err(), "{name} {value}");
            }
            assert_eq!(judge(name, 1.0), Ok(()), "{name}: negative control");
        }
        assert_eq!(judge("response", 9.91e37), Ok(()));
        let error = judge("stage_mm", 1e9).unwrap_err().to_string();
        assert_eq!(
            error,
            "stage_mm: expected a number between -100000 and 100000, found 1e9"
        );
    }
}
