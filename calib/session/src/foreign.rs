//! Columns of a foreign table as they are asked for, and tables of the form that a session was
//! imported from.

use crate::cell::is_missing;
use crate::error::{InputError, SessionError, quote};
use crate::quantity::{Relation, bracketed, relation};
use crate::stamp::{self, is_stamp};
use crate::table::{TextTable, TextTableLayout, read_text_table};
use std::collections::BTreeMap;
use std::path::Path;

/// Columns that a table may lack which another table of its form has.
const OPTIONAL: [&str; 6] = [
    "t_s",
    "direction",
    "temperature_degc",
    "cycle",
    "replicate",
    "stimulus_sd",
];

/// Columns of a session that a table has not by itself: the number of the row, and that it is held
/// out.
const GIVEN: [&str; 2] = ["point", "role"];

/// A column as it is asked for: `COL`, `COL*FACTOR`, or time stamps as `COL since STAMP`.
#[derive(Debug, Clone, PartialEq)]
pub struct AskedColumn {
    /// Its place in the table.
    pub index: usize,
    /// What its cells are multiplied by, where that is stated.
    pub factor: Option<f64>,
    /// The time stamp that seconds are counted from, where it is stated.
    pub since: Option<String>,
}

/// The column in a text that asks for one, without its factor or its time stamp.
pub fn asked_name(text: &str) -> &str {
    split(text).0
}

fn split(text: &str) -> (&str, Option<f64>, Option<&str>) {
    let factor =
        |(name, factor): (&'_ str, &str)| Some((name.len(), factor.trim().parse::<f64>().ok()?));
    if let Some((end, factor)) = text.rsplit_once('*').and_then(factor) {
        return (text[..end].trim(), Some(factor), None);
    }
    match text
        .rsplit_once(" since ")
        .filter(|(_, stamp)| is_stamp(stamp.trim()))
    {
        Some((name, stamp)) => (name.trim(), None, Some(stamp.trim())),
        None => (text, None, None),
    }
}

/// Times of a column of time stamps.
#[derive(Debug, Clone, PartialEq)]
pub struct Stamps {
    /// Seconds after `first`, by row.
    pub times: Vec<Option<f64>>,
    /// The column that the date, or the clock, was read from.
    pub other: Option<usize>,
    /// They have a date.
    pub dated: bool,
    /// The stamp that seconds are counted from.
    pub first: String,
}

impl TextTable {
    /// Times of a column of time stamps, empty cells left out; none where it holds numbers. Where
    /// the date stands in one column and the clock in another, both are read.
    ///
    /// # Errors
    /// Where a cell is no time stamp beside others that are, or day and month could be exchanged.
    pub fn stamps(&self, asked: &AskedColumn) -> Result<Option<Stamps>, InputError> {
        let column = asked.index;
        let held: Vec<usize> = (0..self.rows.len())
            .filter(|&row| !self.lacks(row, column))
            .collect();
        let cell = |row: usize, column: usize| &self.rows[row].1[column];
        let beside = if self.is_foreign() {
            self.other_part(column, &held)
        } else {
            None
        };
        // Two numbers with a colon are what the name says of them.
        let stated = bracketed(&self.columns[column]).map(str::to_lowercase);
        let [minutes, hours] = ["mm:ss", "hh:mm"].map(|form| stated.as_deref() == Some(form));
        let alone = |&row: &usize| match cell(row, column) {
            text if text.matches(':').count() != 1 => text.to_owned(),
            text if minutes => format!("0:{text}"),
            text if hours => format!("{text}:00"),
            text => text.to_owned(),
        };
        if !self.is_foreign() || beside.is_none() && !held.iter().any(|row| is_stamp(&alone(row))) {
            return Ok(None);
        }
        let text = |row: &usize| match beside {
            Some((date, clock)) => format!("{} {}", cell(*row, date), cell(*row, clock)),
            None => alone(row),
        };
        let cells: Vec<String> = held.iter().map(text).collect();
        let dated = cells.first().filter(|first| !stamp::is_clock(first));
        // The stamp that seconds count from is read with the others: all have one form.
        let since = asked.since.as_ref().filter(|_| dated.is_some());
        let all: Vec<&str> = since
            .into_iter()
            .chain(&cells)
            .map(String::as_str)
            .collect();
        let before = all.len() - cells.len();
        let seconds = stamp::seconds(&all).map_err(|(k, expected)| {
            let row = held[k.saturating_sub(before)];
            InputError::new(&self.file, expected, quote(all[k]))
                .at(self.rows[row].0)
                .field(&self.columns[column])
        })?;
        let mut times = vec![None; self.rows.len()];
        held.iter()
            .zip(&seconds[before..])
            .for_each(|(row, time)| times[*row] = Some(*time));
        let other = beside.map(|(date, clock)| if date == column { clock } else { date });
        let first = since
            .cloned()
            .or_else(|| cells.first().cloned())
            .unwrap_or_default();
        Ok(Some(Stamps {
            times,
            other,
            dated: dated.is_some(),
            first,
        }))
    }

    /// Whether a cell holds nothing, or a word for a missing value.
    fn lacks(&self, row: usize, column: usize) -> bool {
        let cell = &self.rows[row].1[column];
        cell.is_empty() || is_missing(cell)
    }

    /// Columns of the date and of the clock, one of them `column`, the other the nearest that holds
    /// nothing else.
    fn other_part(&self, column: usize, held: &[usize]) -> Option<(usize, usize)> {
        let all = |column: usize, is: fn(&str) -> bool| {
            !held.is_empty() && held.iter().all(|&row| is(&self.rows[row].1[column]))
        };
        let nearest = |is: fn(&str) -> bool| {
            let others = (0..self.columns.len()).filter(|&k| k != column && all(k, is));
            others.min_by_key(|k| k.abs_diff(column))
        };
        if all(column, stamp::is_time_of_day) {
            return nearest(stamp::is_date).map(|date| (date, column));
        }
        all(column, stamp::is_date)
            .then(|| nearest(stamp::is_time_of_day).map(|clock| (column, clock)))?
    }

    /// The column that a text asks for.
    ///
    /// # Errors
    /// Where there is no such column, or the factor is none.
    pub fn asked(&self, text: &str) -> Result<AskedColumn, InputError> {
        // A column may be called `F*2` itself: nothing is split off then.
        let whole = !self.columns_named(text).is_empty();
        let (name, factor, since) = if whole {
            (text, None, None)
        } else {
            split(text)
        };
        let malformed = factor.is_none() && !whole && text.contains('*');
        if malformed || factor.is_some_and(|f| !f.is_finite() || f == 0.0) {
            let found = text.rsplit_once('*').map_or(text, |(_, factor)| factor);
            let expected = "COLUMN*FACTOR with a finite factor other than 0";
            return Err(InputError::new(&self.file, expected, format!("{found:?}")).field(text));
        }
        Ok(AskedColumn {
            index: self.column(name)?,
            factor,
            since: since.map(str::to_owned),
        })
    }

    /// The column of a session's name, or that which it was `imported` from.
    pub fn imported(&self, name: &str, imported: &BTreeMap<String, String>) -> Option<AskedColumn> {
        let own = || self.asked(imported.get(name)?).ok();
        let index = self.columns.iter().position(|column| column == name);
        index
            .map(|index| AskedColumn {
                index,
                factor: None,
                since: None,
            })
            .or_else(own)
    }

    /// Compares the unit that the table states of a column below its header with the session's.
    ///
    /// # Errors
    /// Where it is another one, and no factor is stated.
    pub fn check_unit(&self, column: &AskedColumn, unit: &str) -> Result<(), InputError> {
        let stated = self.units.get(column.index).map_or("", String::as_str);
        let differs = match relation(stated, unit) {
            Relation::Times(factor) => (factor - 1.0).abs() > 1e-9,
            Relation::Other => true,
            Relation::Unknown => false,
        };
        // A stated factor converts the unit that stands below the header.
        if column.factor.is_some() || !differs {
            return Ok(());
        }
        let expected = format!("{unit}, as in the session");
        let error = InputError::new(&self.file, expected, stated);
        Err(error.field(&self.columns[column.index]))
    }

    /// Numbers of a column by row, empty cells left out: words of a direction as signs, time stamps
    /// as seconds.
    ///
    /// # Errors
    /// Where a cell holds anything else.
    pub fn values(&self, name: &str, column: &AskedColumn) -> Result<Vec<Option<f64>>, InputError> {
        if name == "t_s"
            && let Some(stamps) = self.stamps(column)?
        {
            return Ok(stamps.times);
        }
        let factor = column.factor.unwrap_or(1.0);
        let cell = |row: usize| match name {
            "direction" => self.direction(row, column.index),
            _ => self.number(row, column.index),
        };
        (0..self.rows.len())
            .map(|row| Ok(cell(row)?.map(|value| value * factor)))
            .collect()
    }
}

/// A table of the form that a session was imported from, as a table of that session which messages
/// call `name`, with the session's `units` of columns; none where it has the session's columns
/// itself, or neither these nor those of the import.
///
/// # Errors
/// Where a column or a cell cannot be used.
pub(crate) fn as_imported(
    path: &Path,
    name: &str,
    imported: &BTreeMap<String, String>,
    kept: &[String],
    units: &[(&str, &str)],
) -> Result<Option<TextTable>, SessionError> {
    let columns = imported.values().map(|text| asked_name(text).to_owned());
    let own = imported.keys().chain(kept).cloned();
    let layout = TextTableLayout {
        asked: Some(columns.chain(own).collect()),
        ..TextTableLayout::default()
    };
    let table = match read_text_table(path, &layout) {
        // What is wrong with a table of the session's own form is said by its reader.
        Err(_) if imported.is_empty() => return Ok(None),
        table => table?,
    };
    let has = |name: &String| table.columns.contains(name);
    let own = imported.keys().all(has) && GIVEN.iter().all(|name| has(&(*name).to_owned()));
    let any = imported.values().any(|text| table.asked(text).is_ok()) || kept.iter().any(has);
    if own || !any {
        return Ok(None);
    }
    for (name, unit) in units {
        if let Some(column) = table.imported(name, imported) {
            table.check_unit(&column, unit)?;
        }
    }
    let mut columns: Vec<(&str, Vec<String>)> = Vec::new();
    let others = kept
        .iter()
        .filter(|name| has(name) && !imported.contains_key(*name));
    for name in imported.keys().chain(others) {
        let column = match table.imported(name, imported) {
            Some(column) => column,
            None if OPTIONAL.contains(&name.as_str()) => continue,
            None => table.asked(imported.get(name).unwrap_or(name))?,
        };
        let cells = if matches!(name.as_str(), "role" | "stream") {
            let rows = table.rows.iter();
            rows.map(|(_, cells)| cells[column.index].to_owned())
                .collect()
        } else {
            let values = table.values(name, &column)?.into_iter();
            values
                .map(|v| v.map_or_else(String::new, |v| v.to_string()))
                .collect()
        };
        columns.push((name, cells));
    }
    for name in GIVEN {
        let cell = |row: usize| match name {
            "point" => (row + 1).to_string(),
            _ => "holdout".to_owned(),
        };
        if !columns.iter().any(|(own, _)| *own == name) {
            columns.push((name, (0..table.rows.len()).map(cell).collect()));
        }
    }
    let lines = table.rows.iter().map(|(line, _)| *line);
    let cells = |k: usize| columns.iter().map(|(_, cells)| cells[k].as_str()).collect();
    let rows = lines
        .enumerate()
        .map(|(k, line)| (line, cells(k)))
        .collect();
    let names = columns.iter().map(|(name, _)| (*name).to_owned()).collect();
    Ok(Some(table.of_session(name, names, rows)))
}
