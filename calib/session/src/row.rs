//! Cells of one row, typed and checked.

use crate::error::{InputError, not_utf8_table, quote};
use crate::warning::{SessionWarning, WarningKind};
use csv::ByteRecord;
use wcal_core::Role;
use wcal_core::ranges::Range;
use wcal_core::text::LATIN_1;

/// A column that was found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column {
    pub(crate) index: usize,
    pub(crate) name: &'static str,
}

/// One row of a table.
pub(crate) struct Row<'a> {
    pub(crate) file: &'a str,
    pub(crate) line: usize,
    pub(crate) columns: &'a [String],
    pub(crate) ranges: &'a [&'static Range],
    pub(crate) record: &'a ByteRecord,
}

type Outcome<T> = Result<T, InputError>;

/// Largest number of a point.
const MAX_POINT: i64 = 1 << 53;

impl Row<'_> {
    /// An error of this row's cell in column `field`.
    pub(crate) fn error(
        &self,
        field: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> InputError {
        InputError::new(self.file, expected, found).at(self.line).field(field)
    }

    fn text(&self, index: usize) -> Outcome<&str> {
        let bytes = self.record.get(index).unwrap_or_default();
        let name = || self.columns.get(index).map_or("", String::as_str);
        let text = std::str::from_utf8(bytes)
            .map_err(|_| not_utf8_table(self.file, LATIN_1).at(self.line).field(name()))?;
        Ok(text.trim())
    }

    /// Finite number at a column index; none when empty.
    pub(crate) fn number_at(&self, index: usize, name: &str) -> Outcome<Option<f64>> {
        let text = self.text(index)?;
        if text.is_empty() {
            return Ok(None);
        }
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => match self.ranges[index].judge(name, value, true) {
                Ok(()) => Ok(Some(value)),
                Err(e) => Err(InputError::range(self.file, e).at(self.line)),
            },
            Ok(_) => Err(self.error(name, "a finite number", quote(text))),
            Err(_) if text.contains(',') => {
                Err(self.error(name, "a number", quote(text)).hint("decimals are written with a dot"))
            }
            Err(_) => Err(self.error(name, "a number", quote(text))),
        }
    }

    /// Finite number; none when the column is absent or the cell empty.
    pub(crate) fn number(&self, column: Option<Column>) -> Outcome<Option<f64>> {
        column.map_or(Ok(None), |c| self.number_at(c.index, c.name))
    }

    /// Finite number that must be there.
    pub(crate) fn required(&self, column: Column) -> Outcome<f64> {
        self.number_at(column.index, column.name)?
            .ok_or_else(|| self.error(column.name, "a number", "nothing"))
    }

    /// Finite number, zero or more.
    pub(crate) fn not_negative(&self, column: Option<Column>) -> Outcome<Option<f64>> {
        let value = self.number(column)?;
        match (column, value) {
            (Some(c), Some(v)) if v < 0.0 => Err(self.error(c.name, "zero or more", format!("{v}"))),
            _ => Ok(value),
        }
    }

    /// Whole number within `[low, high]`; `3.0` counts as 3.
    pub(crate) fn whole(&self, column: Option<Column>, low: i64, high: i64) -> Outcome<Option<i64>> {
        let Some(column) = column else { return Ok(None) };
        let text = self.text(column.index)?;
        if text.is_empty() {
            return Ok(None);
        }
        let exact = text.parse::<i64>().ok();
        #[allow(clippy::cast_possible_truncation)]
        let value = exact.or_else(|| {
            let number = text.parse::<f64>().ok()?;
            (number.fract() == 0.0 && number.abs() < 9e15).then_some(number as i64)
        });
        match value {
            Some(v) if (low..=high).contains(&v) => Ok(Some(v)),
            Some(v) => {
                let end = if v < low { format!("at least {low}") } else { format!("at most {high}") };
                Err(self.error(column.name, format!("a whole number of {end}"), format!("{v}")))
            }
            None => Err(self.error(column.name, "a whole number", quote(text))),
        }
    }

    /// Whole number that fits `u32`, at least `low`.
    pub(crate) fn count(&self, column: Option<Column>, low: u32) -> Outcome<Option<u32>> {
        let value = self.whole(column, i64::from(low), i64::from(u32::MAX))?;
        Ok(value.and_then(|v| u32::try_from(v).ok()))
    }

    /// Point number, which must be there.
    pub(crate) fn point(&self, column: Column) -> Outcome<i64> {
        // Beyond this a table's numbers, read as 64-bit floats elsewhere, are no longer told apart.
        let value = self.whole(Some(column), -MAX_POINT, MAX_POINT)?;
        value.ok_or_else(|| self.error(column.name, "a whole number", "nothing"))
    }

    /// +1 or -1.
    pub(crate) fn sign(&self, column: Option<Column>) -> Outcome<Option<f64>> {
        let value = self.number(column)?;
        match (column, value) {
            (Some(c), Some(v)) if v != 1.0 && v != -1.0 => Err(self.error(c.name, "1 or -1", format!("{v}"))),
            _ => Ok(value),
        }
    }

    /// Role, which must be there.
    pub(crate) fn role(&self, column: Column) -> Outcome<Role> {
        match self.text(column.index)? {
            "rest" => Ok(Role::Rest),
            "calibration" => Ok(Role::Calibration),
            "verification" => Ok(Role::Verification),
            "holdout" => Ok(Role::Holdout),
            other => Err(self.error(column.name, "rest, calibration, verification or holdout", quote(other))),
        }
    }

    /// What happened in the reading's averaging window: `lost`, `late` or `moved`; none where it was whole or the table does not say.
    pub(crate) fn stream(&self, column: Option<Column>) -> Outcome<Option<&'static str>> {
        let Some(column) = column else { return Ok(None) };
        match self.text(column.index)? {
            "" | "ok" => Ok(None),
            "lost" => Ok(Some("lost")),
            "late" => Ok(Some("late")),
            "moved" => Ok(Some("moved")),
            other => Err(self.error(column.name, "ok, lost, late or moved", quote(other))),
        }
    }

    /// Temperature, deg C; a value that can only be kelvin is refused.
    pub(crate) fn temperature(&self, column: Option<Column>) -> Outcome<Option<f64>> {
        let value = self.number(column)?;
        match (column, value) {
            (Some(c), Some(v)) if !(-60.0..=200.0).contains(&v) => {
                let expected = "a temperature between -60 and 200 deg C";
                Err(self.error(c.name, expected, format!("{v}")).hint("kelvin?"))
            }
            _ => Ok(value),
        }
    }
}

/// Point numbers of one file, each at the line where it was first seen.
#[derive(Default)]
pub(crate) struct PointNumbers(std::collections::HashMap<i64, usize>);

impl PointNumbers {
    /// Notes the row's point number; a second use of it is an error.
    pub(crate) fn note(&mut self, row: &Row<'_>, point: i64) -> Outcome<()> {
        match self.0.insert(point, row.line) {
            None => Ok(()),
            Some(line) => {
                let found = format!("point {point} again (first at line {line})");
                Err(row.error("point", "every point number once in a file", found))
            }
        }
    }
}

/// Watches that time does not run backwards in file order.
#[derive(Default)]
pub(crate) struct Clock {
    latest_s: Option<f64>,
    first_jump: Option<(usize, f64)>,
    jumps: usize,
}

impl Clock {
    /// Notes the time of one row.
    pub(crate) fn note(&mut self, line: usize, t_s: Option<f64>) {
        let Some(t_s) = t_s else { return };
        if let Some(latest_s) = self.latest_s.filter(|latest_s| t_s < *latest_s) {
            self.jumps += 1;
            self.first_jump.get_or_insert((line, latest_s - t_s));
        }
        self.latest_s = Some(t_s);
    }

    /// Of rows by line.
    pub(crate) fn of(rows: impl Iterator<Item = (usize, Option<f64>)>) -> Self {
        let mut clock = Self::default();
        rows.for_each(|(line, t_s)| clock.note(line, t_s));
        clock
    }

    /// A warning, if time ran backwards.
    pub(crate) fn warning(&self, file: &str) -> Option<SessionWarning> {
        let (line, back_s) = self.first_jump?;
        Some(SessionWarning::new(file, WarningKind::ClockProblem { times: self.jumps, line, back_s }))
    }
}
