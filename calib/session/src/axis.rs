//! Sessions of kind "axis": commanded against measured position.

use crate::error::SessionError;
use crate::row::{Clock, PointNumbers};
use crate::screening::{Names, Screened, View, screen};
use crate::table::Table;
use crate::warning::SessionWarning;
use crate::whisker::unused_columns;
use std::path::Path;
use wcal_core::{AxisRow, InputFile};

impl Screened for AxisRow {
    fn view(&self) -> View {
        View {
            line: self.line,
            point: self.point,
            role: self.role,
            setting: self.commanded_mm,
            reading: self.measured_mm,
            t_s: self.t_s,
            direction: self.direction,
            temperature_degc: self.temperature_degc,
            more: Vec::new(),
        }
    }
}

/// Reads a table; `reference` are the rows of the points table, where this is another one.
pub(crate) fn read_rows(
    path: &Path,
    name: &str,
    reference: &[AxisRow],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(Vec<AxisRow>, InputFile), SessionError> {
    let mut table = Table::open(path, name)?;
    let (point, role) = (table.required("point")?, table.required("role")?);
    let (commanded, measured) = (table.required("commanded_mm")?, table.required("measured_mm")?);
    let (t_s, direction) = (table.optional("t_s")?, table.optional("direction")?);
    // The repetition of a stroke is its cycle.
    let cycle = table.group()?;
    let temperature = table.optional("temperature_degc")?;
    warnings.extend(unused_columns(&table));
    let (mut points, mut rows) = (PointNumbers::default(), Vec::new());
    while let Some(row) = table.next_row()? {
        let reading = AxisRow {
            source: name.to_owned(),
            line: row.line,
            point: row.point(point)?,
            role: row.role(role)?,
            commanded_mm: row.required(commanded)?,
            measured_mm: row.required(measured)?,
            t_s: row.number(t_s)?,
            direction: row.sign(direction)?,
            cycle: row.count(cycle, 0)?,
            temperature_degc: row.number(temperature)?,
        };
        points.note(&row, reading.point)?;
        rows.push(reading);
    }
    let names = Names { setting: "commanded_mm", reading: "measured_mm", more: &[] };
    // A column that holds something else is named as that before its single values are judged.
    unit_mismatch(name, &rows)?;
    screen(name, &names, &mut rows, reference, warnings)?;
    warnings.extend(Clock::of(rows.iter().map(|r| (r.line, r.t_s))).warning(name));
    warnings.extend(table.open_end());
    Ok((rows, table.finish()?))
}

/// Steps between readings from which the slope of the measured over the commanded positions is taken: the middle one is not moved by an
/// overflow value or a single wrong target.
fn slope(rows: &[AxisRow]) -> Option<f64> {
    /// Steps shorter than this share of the travel show the errors more than the scale.
    const MIN_STEP: f64 = 0.05;
    let low = rows.iter().map(|r| r.commanded_mm).fold(f64::INFINITY, f64::min);
    let high = rows.iter().map(|r| r.commanded_mm).fold(f64::NEG_INFINITY, f64::max);
    let half = rows.len().div_ceil(2);
    // Each reading with the next and with one half a table away: short and long steps.
    let pairs = (0..rows.len()).flat_map(|k| [k + 1, k + half].map(|j| (&rows[k], rows.get(j))));
    let mut slopes: Vec<f64> = pairs
        .filter_map(|(a, b)| {
            let (x, y) = (b?.commanded_mm - a.commanded_mm, b?.measured_mm - a.measured_mm);
            (x.abs() > MIN_STEP * (high - low) && x != 0.0).then_some(y / x)
        })
        .collect();
    slopes.sort_by(f64::total_cmp);
    slopes.get(slopes.len() / 2).copied()
}

/// The declared model is measured = commanded + constant, so their slope is close to 1. Another one is a unit, a sense of counting, or a column
/// of errors in place of positions.
fn unit_mismatch(name: &str, rows: &[AxisRow]) -> Result<(), crate::error::InputError> {
    /// From here to 1 the slope is a scale error, as large as the catalogue lets it be.
    const MIN_SLOPE: f64 = 0.5;
    let Some(slope) = slope(rows) else { return Ok(()) };
    let error = |expected: &str, found: String| {
        crate::error::InputError::new(name, expected, found).field("measured_mm")
    };
    let found = || format!("a slope of {slope:.5} between the columns");
    for (factor, hint) in [
        (1e3, "measured values in um? --measured 'COLUMN*0.001' at import"),
        (
            1e-3,
            "measured values in m, or commanded in um? --measured 'COLUMN*1000' or --commanded 'COLUMN*0.001' at import",
        ),
        (25.4, "commanded values in inch? --commanded 'COLUMN*25.4' at import"),
        (1.0 / 25.4, "measured values in inch? --measured 'COLUMN*25.4' at import"),
        (10.0, "commanded values in cm? --commanded 'COLUMN*10' at import"),
        (0.1, "measured values in cm? --measured 'COLUMN*10' at import"),
        (-1.0, "counted the other way? --measured 'COLUMN*-1' at import"),
    ] {
        if (slope / factor - 1.0).abs() < 0.02 {
            return Err(error("measured and commanded positions in the same unit, mm", found()).hint(hint));
        }
    }
    if slope.abs() >= MIN_SLOPE {
        return Ok(());
    }
    let first = rows.first().map_or(0.0, |r| r.measured_mm);
    if rows.iter().all(|r| r.measured_mm == first) {
        let found = format!("{first} in every row: the encoder stands still");
        return Err(error("positions that follow the commanded ones", found));
    }
    let largest = rows.iter().map(|r| r.measured_mm.abs()).fold(0.0, f64::max);
    let found = format!("values up to {largest} that do not follow commanded_mm (slope {slope:.5})");
    let hint = "errors, measured less commanded? import them with --covariate error_um=COLUMN (or error_mm, error_in), in place of --measured";
    Err(error("measured positions", found).hint(hint))
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_core::Role;

    /// Eleven positions up and down twice, with what `measured` makes of a position.
    fn rows(measured: impl Fn(f64, f64) -> f64) -> Vec<AxisRow> {
        let of = |k: usize| {
            let place = k % 22;
            let (step, way) = if place < 11 { (place, 1.0) } else { (21 - place, -1.0) };
            let x = 40.0 * step as f64;
            AxisRow {
                source: "t.csv".to_owned(),
                line: k + 2,
                point: 0,
                role: Role::Calibration,
                commanded_mm: x,
                measured_mm: measured(x, way),
                t_s: None,
                direction: None,
                cycle: None,
                temperature_degc: None,
            }
        };
        (0..44).map(of).collect()
    }

    #[test]
    fn what_is_no_column_of_positions_is_named_with_the_way_out() {
        let error = |x: f64, way: f64| 0.02 * x - 1.7 * way;
        for (factor, says) in [(1.0, "error_um="), (1e-3, "error_um="), (1e-3 / 25.4, "error_um=")] {
            let told =
                unit_mismatch("t.csv", &rows(|x, way| factor * error(x, way))).unwrap_err().to_string();
            assert!(told.contains(says), "{factor}: {told}");
        }
        for (factor, says) in [
            (1e3, "--measured 'COLUMN*0.001'"),
            (1.0 / 25.4, "--measured 'COLUMN*25.4'"),
            (25.4, "--commanded 'COLUMN*25.4'"),
            (-1.0, "--measured 'COLUMN*-1'"),
        ] {
            let told = unit_mismatch("t.csv", &rows(|x, _| factor * x)).unwrap_err().to_string();
            assert!(told.contains(says), "{factor}: {told}");
        }
        let still = unit_mismatch("t.csv", &rows(|_, _| 3.2)).unwrap_err().to_string();
        assert!(still.contains("stands still"), "{still}");
        // Positions, with a large scale error or one wrong target, are positions.
        assert!(unit_mismatch("t.csv", &rows(|x, way| x + 1e-3 * error(x, way))).is_ok());
        assert!(unit_mismatch("t.csv", &rows(|x, _| 1.4 * x)).is_ok());
        assert!(unit_mismatch("t.csv", &rows(|x, _| if x == 40.0 { 9.9e37 } else { x })).is_ok());
    }
}
