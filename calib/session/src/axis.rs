//! Sessions of kind "axis": commanded against measured position.

use crate::error::SessionError;
use crate::row::{Clock, PointNumbers};
use crate::table::Table;
use crate::warning::SessionWarning;
use crate::whisker::unused_columns;
use std::path::Path;
use wcal_core::{AxisRow, InputFile};

/// Reads a table.
pub(crate) fn read_rows(
    path: &Path,
    name: &str,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(Vec<AxisRow>, InputFile), SessionError> {
    let mut table = Table::open(path, name)?;
    let (point, role) = (table.required("point")?, table.required("role")?);
    let (commanded, measured) = (table.required("commanded_mm")?, table.required("measured_mm")?);
    let (t_s, direction) = (table.optional("t_s")?, table.optional("direction")?);
    // The repetition of a stroke is its cycle.
    let cycle = match table.optional("cycle")? {
        None => table.optional("replicate")?,
        cycle => cycle,
    };
    let temperature = table.optional("temperature_degc")?;
    warnings.extend(unused_columns(&table));
    let (mut points, mut clock, mut rows) = (PointNumbers::default(), Clock::default(), Vec::new());
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
            temperature_degc: row.temperature(temperature)?,
        };
        points.note(&row, reading.point)?;
        clock.note(row.line, reading.t_s);
        rows.push(reading);
    }
    warnings.extend(clock.warning(name));
    unit_mismatch(name, &rows)?;
    Ok((rows, table.finish()?))
}

/// The declared model is measured = commanded + constant: a slope of 1000 or 1/1000 is a unit error.
fn unit_mismatch(name: &str, rows: &[AxisRow]) -> Result<(), crate::error::InputError> {
    #[allow(clippy::cast_precision_loss)]
    let n = rows.len().max(1) as f64;
    let mean = |value: fn(&AxisRow) -> f64| rows.iter().map(value).sum::<f64>() / n;
    let (commanded, measured) = (mean(|r| r.commanded_mm), mean(|r| r.measured_mm));
    let mut sums = (0.0, 0.0);
    for row in rows {
        sums.0 += (row.commanded_mm - commanded).powi(2);
        sums.1 += (row.commanded_mm - commanded) * (row.measured_mm - measured);
    }
    let slope = sums.1 / sums.0;
    for (factor, hint) in
        [(1e3, "measured values in um?"), (1e-3, "measured values in m, or commanded in um?")]
    {
        if (slope / factor - 1.0).abs() < 0.02 {
            let found = format!("a slope of {slope:.5} between the columns");
            let error = crate::error::InputError::new(
                name,
                "measured and commanded positions in the same unit, mm",
                found,
            );
            return Err(error.field("measured_mm").hint(hint));
        }
    }
    Ok(())
}
