//! Cells of one row of a session's table by the names of their columns, typed and checked.

use crate::error::{InputError, quote};
use crate::table::TextTable;
use crate::warning::{SessionWarning, WarningKind};
use std::collections::HashMap;
use wcal_core::Role;
use wcal_core::text::number;

/// One row of a table.
#[derive(Clone, Copy)]
pub(crate) struct Row<'a> {
    pub(crate) table: &'a TextTable,
    pub(crate) index: usize,
    pub(crate) line: usize,
}

type Outcome<T> = Result<T, InputError>;

/// Largest number of a point. Beyond this a table's numbers, read as 64-bit floats, are no longer
/// distinguished.
const MAX_POINT: f64 = 9_007_199_254_740_992.0;

impl<'a> Row<'a> {
    /// One of a table's rows.
    pub(crate) fn new(table: &'a TextTable, index: usize) -> Self {
        Self {
            table,
            index,
            line: table.rows[index].0,
        }
    }

    /// All of them.
    pub(crate) fn all(table: &'a TextTable) -> impl Iterator<Item = Self> {
        (0..table.rows.len()).map(|index| Self::new(table, index))
    }
}

impl Row<'_> {
    /// An error of this row's cell in column `field`.
    pub(crate) fn error(
        &self,
        field: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> InputError {
        InputError::new(&self.table.file, expected, found)
            .at(self.line)
            .field(field)
    }

    /// Text of a cell; empty where the column is absent.
    fn text(&self, name: &str) -> &str {
        self.table
            .place(name)
            .map_or("", |column| &self.table.rows[self.index].1[column])
    }

    /// Finite number; none where the column is absent or the cell empty.
    pub(crate) fn number(&self, name: &str) -> Outcome<Option<f64>> {
        self.table
            .place(name)
            .map_or(Ok(None), |column| self.table.number(self.index, column))
    }

    /// Finite number that must be there.
    pub(crate) fn required(&self, name: &str) -> Outcome<f64> {
        self.number(name)?
            .ok_or_else(|| self.error(name, "a number", "nothing"))
    }

    /// A number of which `good` holds.
    fn number_of(
        &self,
        name: &str,
        expected: &str,
        good: impl Fn(f64) -> bool,
    ) -> Outcome<Option<f64>> {
        match self.number(name)? {
            Some(v) if !good(v) => Err(self.error(name, expected, v.to_string())),
            value => Ok(value),
        }
    }

    /// Finite number, zero or more.
    pub(crate) fn not_negative(&self, name: &str) -> Outcome<Option<f64>> {
        self.number_of(name, "zero or more", |v| v >= 0.0)
    }

    /// Whole number that fits `u32`, at least `low`; `3.0` counts as 3.
    pub(crate) fn count(&self, name: &str, low: u32) -> Outcome<Option<u32>> {
        let fits = |v: f64| v.fract() == 0.0 && (f64::from(low)..=f64::from(u32::MAX)).contains(&v);
        let value = self.number_of(name, &format!("a whole number of at least {low}"), fits)?;
        Ok(value.map(|v| v as u32))
    }

    /// Point number, which must be there.
    pub(crate) fn point(&self) -> Outcome<i64> {
        let fits = |v: f64| v.fract() == 0.0 && v.abs() <= MAX_POINT;
        let value = self.number_of("point", "a whole number", fits)?;
        value
            .map(|v| v as i64)
            .ok_or_else(|| self.error("point", "a whole number", "nothing"))
    }

    /// Point number; the order of the row (from 0) in a table without numbers of points.
    pub(crate) fn point_or_order(&self) -> Outcome<i64> {
        self.table
            .place("point")
            .map_or(Ok(self.index as i64), |_| self.point())
    }

    /// +1 or -1.
    pub(crate) fn sign(&self, name: &str) -> Outcome<Option<f64>> {
        self.number_of(name, "1 or -1", |v| v.abs() == 1.0)
    }

    /// Role, which must be there.
    pub(crate) fn role(&self) -> Outcome<Role> {
        match self.text("role") {
            "rest" => Ok(Role::Rest),
            "calibration" => Ok(Role::Calibration),
            "verification" => Ok(Role::Verification),
            "holdout" => Ok(Role::Holdout),
            other => Err(self.error(
                "role",
                "rest, calibration, verification or holdout",
                quote(other),
            )),
        }
    }

    /// What happened in the reading's averaging window: `lost`, `late` or `moved`; `ok` where it
    /// was whole or the table does not say.
    pub(crate) fn stream(&self) -> Outcome<&str> {
        match self.text("stream") {
            "" => Ok("ok"),
            known @ ("ok" | "lost" | "late" | "moved") => Ok(known),
            other => Err(self.error("stream", "ok, lost, late or moved", quote(other))),
        }
    }

    /// Temperature, deg C; a value that can only be kelvin is refused.
    pub(crate) fn temperature(&self) -> Outcome<Option<f64>> {
        // Room temperature is 293 K, far above the range: kelvin are refused.
        const EXPECTED: &str = "a temperature between -60 and 200 deg C (kelvin?)";
        self.number_of("temperature_degc", EXPECTED, |v| {
            (-60.0..=200.0).contains(&v)
        })
    }
}

/// Point numbers of one file, each at the line where it was first seen.
#[derive(Default)]
pub(crate) struct PointNumbers(HashMap<i64, usize>);

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

/// A warning where time runs backwards in file order; rows by line and time.
pub(crate) fn clock_problem(
    file: &str,
    rows: impl Iterator<Item = (usize, Option<f64>)>,
) -> Option<SessionWarning> {
    let timed: Vec<(usize, f64)> = rows.filter_map(|(line, t_s)| Some((line, t_s?))).collect();
    let back: Vec<&[(usize, f64)]> = timed.windows(2).filter(|w| w[1].1 < w[0].1).collect();
    let first = back.first()?;
    let (times, back_s) = (back.len(), first[0].1 - first[1].1);
    let text = format!(
        "t_s runs backwards {times} time(s), first by {} s",
        number(back_s, 6)
    );
    let lines = back.iter().map(|w| w[1].0).collect();
    Some(SessionWarning::new(file, WarningKind::ClockProblem, text).at(lines))
}
