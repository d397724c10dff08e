//! Rows of a whisker's table that are no readings: an instrument's overflow value, or a copy of an earlier row.

use crate::error::InputError;
use crate::row::Row;
use crate::table::Column;
use crate::warning::{SessionWarning, WarningKind};
use std::collections::{BTreeMap, HashMap};

/// From here on a number is no reading: SCPI instruments write 9.9E37 for overflow and 9.91E37 for "not a number" (SCPI-1999, 7.2.1).
const SCPI_OVERFLOW: f64 = 9e36;
/// What thermometers and loggers write for a reading that failed (Maxim DS18B20: -127 deg C by its common library).
const FAILED: [f64; 4] = [-127.0, -999.0, -9999.0, 9999.0];
/// Rows of a block that repeats an earlier one without a clock: rounded readings agree now and then, so many in a row do not.
const MIN_BLOCK: usize = 6;

/// Whether a number stands for "no reading".
fn is_overflow(value: f64) -> bool {
    value.abs() >= SCPI_OVERFLOW || FAILED.contains(&value)
}

/// Rows left out of a table, with the reason.
#[derive(Default)]
pub(crate) struct LeftOut {
    /// Columns with overflow values, and the points that have one there.
    overflowed: BTreeMap<&'static str, Vec<i64>>,
    /// Cells of each row, with and without its point number, and the row's place.
    seen: HashMap<Vec<u8>, usize>,
    /// For each row of the table the place of the row that it repeats, and whether the copy is beyond doubt.
    repeats: Vec<(Option<usize>, bool)>,
}

impl LeftOut {
    /// The first of `columns` that holds an overflow value in this row.
    pub(crate) fn overflowed(
        &self,
        row: &Row<'_>,
        columns: impl Iterator<Item = Column>,
    ) -> Result<Option<Column>, InputError> {
        for column in columns {
            if row.number(Some(column))?.is_some_and(is_overflow) {
                return Ok(Some(column));
            }
        }
        Ok(None)
    }

    /// Notes a row that is left out for its value in `column`.
    pub(crate) fn note_overflow(&mut self, column: Column, point: i64) {
        self.overflowed.entry(column.name).or_default().push(point);
    }

    /// Notes a row's cells; `point` is the column of the point numbers, `timed` whether the row has a clock. True where the row is a copy
    /// beyond doubt: it repeats an earlier one with its point number or its time.
    pub(crate) fn note_cells(&mut self, row: &Row<'_>, point: Option<Column>, timed: bool) -> bool {
        let cells = |without: Option<usize>| -> Vec<u8> {
            let kept = row.record.iter().enumerate().filter(|(k, _)| Some(*k) != without);
            kept.flat_map(|(_, cell)| cell.iter().copied().chain([0x1f])).collect()
        };
        let place = self.repeats.len();
        let measured = cells(point.map(|c| c.index));
        let whole = point.and_then(|_| self.seen.get(&cells(None)).copied());
        let earlier = whole.or_else(|| self.seen.get(&measured).copied());
        if point.is_some() {
            self.seen.entry(cells(None)).or_insert(place);
        }
        self.seen.entry(measured).or_insert(place);
        let certain = whole.is_some() || (timed && earlier.is_some());
        self.repeats.push((earlier, certain));
        certain
    }

    /// Places of the rows that are copies: those beyond doubt, and blocks of rows that follow each other as an earlier block does.
    pub(crate) fn copies(&self) -> Vec<usize> {
        let mut copies = Vec::new();
        let mut start = 0;
        while start < self.repeats.len() {
            let Some(first) = self.repeats[start].0 else {
                start += 1;
                continue;
            };
            let follows = |k: usize| self.repeats.get(start + k).is_some_and(|r| r.0 == Some(first + k));
            let length = (1..).find(|k| !follows(*k)).unwrap_or(1);
            let block = length >= MIN_BLOCK;
            copies.extend((start..start + length).filter(|&k| block || self.repeats[k].1));
            start += length;
        }
        copies
    }

    /// Warnings of what was left out; an error where most rows of the table hold no reading.
    pub(crate) fn warnings(
        self,
        file: &str,
        copies: Vec<i64>,
        rows: usize,
    ) -> Result<Vec<SessionWarning>, InputError> {
        for (column, points) in &self.overflowed {
            if points.len() > rows {
                let found = format!("overflow values in {} of {} rows", points.len(), rows + points.len());
                return Err(InputError::new(file, "readings in most rows", found).field(*column));
            }
        }
        let overflowed = self.overflowed.into_iter().map(|(column, points)| {
            SessionWarning::new(file, WarningKind::OverflowAtPoints { column: column.to_owned(), points })
        });
        let copied =
            (!copies.is_empty()).then(|| SessionWarning::new(file, WarningKind::CopiedPoints(copies)));
        Ok(overflowed.chain(copied).collect())
    }
}
