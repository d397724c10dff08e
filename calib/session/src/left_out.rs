//! Rows of a whisker's table that are no readings: an instrument's overflow value, or a copy of an earlier row.

use crate::copies::repeated;
use crate::error::{InputError, SessionError};
use crate::overflow::{codes, refuse_most};
use crate::row::Column;
use crate::row::Row;
use crate::table::Table;
use crate::warning::{SessionWarning, WarningKind};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Rows that hold one code in one column.
#[derive(Default)]
struct Coded {
    lines: Vec<usize>,
    points: Vec<i64>,
}

/// Rows left out of a table, with the reason.
pub(crate) struct LeftOut {
    /// Overflow codes of each column that an instrument wrote.
    codes: Vec<(Column, Vec<f64>)>,
    /// Rows that hold one, by column and the code's bits.
    overflowed: BTreeMap<(&'static str, u64), Coded>,
    /// Cells of each row, with and without its point number, and the row's place.
    seen: HashMap<Vec<u8>, usize>,
    /// For each row of the table the place of the row that it repeats, and whether the copy is beyond doubt.
    repeats: Vec<(Option<usize>, bool)>,
}

impl LeftOut {
    /// Looks through the table at `path` once for the codes of its `columns`: which numbers are codes shows in the whole column.
    pub(crate) fn of(path: &Path, name: &str, columns: Vec<Column>) -> Result<Self, SessionError> {
        let mut table = Table::open(path, name)?;
        let mut values: Vec<Vec<f64>> = vec![Vec::new(); columns.len()];
        while let Some(row) = table.next_row()? {
            for (values, column) in values.iter_mut().zip(&columns) {
                values.extend(row.number(Some(*column))?);
            }
        }
        let of = |(column, values): (Column, Vec<f64>)| (column, codes(&values, false));
        let codes = columns.into_iter().zip(values).map(of).collect();
        Ok(Self { codes, overflowed: BTreeMap::new(), seen: HashMap::new(), repeats: Vec::new() })
    }

    /// The first column that holds an overflow code in this row, and the code.
    pub(crate) fn overflowed(&self, row: &Row<'_>) -> Result<Option<(Column, f64)>, InputError> {
        for (column, codes) in &self.codes {
            if let Some(code) = row.number(Some(*column))?.filter(|v| codes.contains(v)) {
                return Ok(Some((*column, code)));
            }
        }
        Ok(None)
    }

    /// Notes a row that is left out for its code in `column`.
    pub(crate) fn note_overflow(&mut self, (column, code): (Column, f64), line: usize, point: i64) {
        let coded = self.overflowed.entry((column.name, code.to_bits())).or_default();
        coded.lines.push(line);
        coded.points.push(point);
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
        repeated(&self.repeats)
    }

    /// Warnings of what was left out: `copies` are lines and points of the copied rows, `rows` stay. An error where most rows of the table hold
    /// no reading.
    pub(crate) fn warnings(
        self,
        file: &str,
        copies: Vec<(usize, i64)>,
        rows: usize,
    ) -> Result<Vec<SessionWarning>, InputError> {
        let mut out = Vec::new();
        let mut of_column: BTreeMap<&str, usize> = BTreeMap::new();
        for ((column, bits), coded) in self.overflowed {
            let count = of_column.entry(column).or_default();
            *count += coded.lines.len();
            refuse_most(file, column, *count, rows + *count)?;
            let (column, value) = (column.to_owned(), f64::from_bits(bits));
            let kind = WarningKind::Overflow { column, value, lines: coded.lines, points: coded.points };
            out.push(SessionWarning::new(file, kind));
        }
        if !copies.is_empty() {
            let of = rows + copies.len();
            let (lines, points) = copies.into_iter().unzip();
            out.push(SessionWarning::new(file, WarningKind::Copied { lines, points, of }));
        }
        Ok(out)
    }
}
