//! What an axis' table cannot hold: positions in another unit or sense than those commanded.

use crate::error::InputError;
use wcal_core::order_statistics::{extent, median};

/// Slope of the measured over the commanded positions, the middle one of the steps between
/// readings: an overflow value or a single wrong target does not move it.
fn slope(rows: &[[f64; 2]]) -> Option<f64> {
    /// Steps shorter than this share of the travel show the errors more than the scale.
    const MIN_STEP: f64 = 0.05;
    let [low, high] = extent(rows.iter().map(|r| r[0]));
    let half = rows.len().div_ceil(2);
    // Each reading with the next and with one half a table away: short and long steps.
    let pairs = (0..rows.len()).flat_map(|k| [k + 1, k + half].map(|j| (&rows[k], rows.get(j))));
    let slopes = pairs.filter_map(|(a, b)| {
        let (x, y) = (b?[0] - a[0], b?[1] - a[1]);
        (x.abs() > MIN_STEP * (high - low) && x != 0.0).then_some(y / x)
    });
    median(slopes)
}

/// The declared model is measured = commanded + constant, so their slope is close to 1. Another one
/// is a unit (um, m, inch, cm), a sense of counting, or a column of errors in place of positions.
pub(crate) fn unit_mismatch(file: &str, rows: &[[f64; 2]]) -> Result<(), InputError> {
    const UNITS: [f64; 7] = [1e3, 1e-3, 25.4, 1.0 / 25.4, 10.0, 0.1, -1.0];
    /// From here to 1 the slope is a scale error, as large as the catalogue lets it be.
    const MIN_SLOPE: f64 = 0.5;
    let Some(slope) = slope(rows) else {
        return Ok(());
    };
    let error =
        |expected: &str, found: String| InputError::new(file, expected, found).field("measured_mm");
    // Within 2 % of such a factor it is a unit or a sense of counting, and no scale error.
    if let Some(factor) = UNITS
        .into_iter()
        .find(|factor| (slope / factor - 1.0).abs() < 0.02)
    {
        let found = format!("a slope of {slope:.5} between the columns");
        let error = error(
            "measured and commanded positions in the same unit, mm, and sense",
            found,
        );
        return Err(error.hint(format!("--measured 'COLUMN*{}' at import", 1.0 / factor)));
    }
    if slope.abs() >= MIN_SLOPE {
        return Ok(());
    }
    if let Some(first) = rows
        .first()
        .filter(|first| rows.iter().all(|r| r[1] == first[1]))
    {
        let found = format!("{} in every row: the encoder stands still", first[1]);
        return Err(error("positions that follow the commanded ones", found));
    }
    let found = format!("values that do not follow commanded_mm (slope {slope:.5})");
    let hint = "errors, measured less commanded? import them with --covariate error_um=COLUMN (or error_mm, error_in), in place of --measured";
    Err(error("measured positions", found).hint(hint))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eleven positions up and down twice, with what `measured` makes of a position.
    fn rows(measured: impl Fn(f64, f64) -> f64) -> Vec<[f64; 2]> {
        let of = |k: usize| {
            let place = k % 22;
            let (step, way) = if place < 11 {
                (place, 1.0)
            } else {
                (21 - place, -1.0)
            };
            let x = 40.0 * step as f64;
            [x, measured(x, way)]
        };
        (0..44).map(of).collect()
    }

    #[test]
    fn what_is_no_column_of_positions_is_named_with_the_way_out() {
        let error = |x: f64, way: f64| 0.02 * x - 1.7 * way;
        let said = |measured: &dyn Fn(f64, f64) -> f64| {
            unit_mismatch("t.csv", &rows(measured))
                .unwrap_err()
                .to_string()
        };
        for factor in [1.0, 1e-3, 1e-3 / 25.4] {
            let said = said(&|x, way| factor * error(x, way));
            assert!(said.contains("error_um="), "{factor}: {said}");
        }
        for (factor, says) in [
            (1e3, "COLUMN*0.001'"),
            (1.0 / 25.4, "COLUMN*25.4'"),
            (-1.0, "COLUMN*-1'"),
        ] {
            let said = said(&|x, _| factor * x);
            assert!(said.contains(says), "{factor}: {said}");
        }
        assert!(said(&|_, _| 3.2).contains("stands still"));
        // Positions, with a large scale error or one wrong target, are positions.
        assert!(unit_mismatch("t.csv", &rows(|x, way| x + 1e-3 * error(x, way))).is_ok());
        assert!(unit_mismatch("t.csv", &rows(|x, _| 1.4 * x)).is_ok());
        assert!(unit_mismatch("t.csv", &rows(|x, _| if x == 40.0 { 9.9e37 } else { x })).is_ok());
    }
}
