//! Spreadsheets (.xlsx, .ods): the sheet that holds the table, as the text of a table with commas.
//!
//! A row of the sheet is a line of the text, so that messages name the sheet's own rows. Formulas
//! stand with the value that the spreadsheet's program saved.

use crate::cell::name_of;
use crate::error::{InputError, listed, quote};
use crate::separated::MAX_COLUMNS;
use calamine::{Data, ExcelDateTime, Ods, OdsError, Reader, SheetVisible, Xlsx, XlsxError};
use std::io::{Cursor, Read};

/// Rows that the format has room for, and most cells that are read.
const MAX_ROWS: usize = 1 << 20;
const MAX_CELLS: usize = 20_000_000;
/// Most bytes of all parts of the file unpacked: a small archive can hold anything.
const MAX_UNPACKED: u64 = 1 << 30;
/// Rows among which names of columns are looked for.
const LOOK: usize = 200;
const DAY_S: f64 = 86_400.0;

/// Whether a file begins as a spreadsheet: a zip archive, or the container of one with a password.
pub(crate) fn is_spreadsheet(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(&[0xd0, 0xcf, 0x11, 0xe0])
}

/// Which sheet is wanted, and how its numbers are written.
pub(crate) struct SheetChoice<'a> {
    /// Its name.
    pub(crate) name: Option<&'a str>,
    /// Columns that it has to hold.
    pub(crate) asked: &'a [String],
    pub(crate) decimal_comma: bool,
}

/// A sheet as text, and its name.
pub(crate) struct SheetText {
    pub(crate) text: String,
    pub(crate) name: String,
    /// Sheets of the file.
    pub(crate) sheets: usize,
}

/// The sheet that is named, else the one that holds most of the columns that are asked for.
///
/// # Errors
/// A file that is damaged, has a password or is no spreadsheet, a sheet that is not there, or
/// several that hold the columns.
pub(crate) fn sheet_text(
    file: &str,
    bytes: &[u8],
    choice: &SheetChoice<'_>,
) -> Result<SheetText, InputError> {
    let sheets = Book { file, bytes }.sheets(choice)?;
    let names: Vec<String> = sheets.iter().map(|s| s.name.clone()).collect();
    let score = |sheet: &Sheet| {
        let named = |row: &Vec<String>| {
            let names: Vec<String> = row.iter().map(|cell| name_of(cell)).collect();
            let asked = choice.asked.iter();
            asked.filter(|name| names.contains(name)).count()
        };
        sheet.rows.iter().take(LOOK).map(named).max().unwrap_or(0)
    };
    let scores: Vec<usize> = sheets.iter().map(score).collect();
    let best = scores.iter().copied().max().unwrap_or(0);
    // Without any of the names the longest sheet: what it lacks is said of it.
    let held = |k: &usize| scores[*k] == best && !sheets[*k].rows.is_empty();
    let mut found: Vec<usize> = (0..sheets.len()).filter(held).collect();
    if best == 0 {
        found.sort_by_key(|k| std::cmp::Reverse(sheets[*k].rows.len()));
    }
    let Some(first) = found.first() else {
        let found = format!("the sheets {}, all empty", listed(&names));
        return Err(InputError::new(file, "a sheet with a table", found));
    };
    if best > 0 && found.len() > 1 {
        let holding: Vec<String> = found.iter().map(|k| names[*k].clone()).collect();
        let found = format!("the sheets {}", listed(&holding));
        let error = InputError::new(file, "one sheet with these columns", found);
        return Err(error.hint("--sheet NAME chooses one"));
    }
    Ok(SheetText {
        text: as_text(&sheets[*first].rows),
        name: names[*first].clone(),
        sheets: sheets.len(),
    })
}

/// A file as it lies in memory.
struct Book<'a> {
    file: &'a str,
    bytes: &'a [u8],
}

impl Book<'_> {
    fn damaged(&self, why: impl ToString) -> InputError {
        let why = match self.bytes.starts_with(b"PK") {
            true => why.to_string(),
            false => "an Excel workbook of another form (.xls)".to_owned(),
        };
        InputError::new(self.file, "a whole spreadsheet (.xlsx, .ods)", why)
            .hint("open it and save it anew, or save the sheet as CSV UTF-8")
    }

    fn locked(&self) -> InputError {
        let found = "one with a password";
        InputError::new(self.file, "a spreadsheet that can be read", found)
            .hint("save a copy without a password")
    }

    /// Every visible sheet that holds cells, or the one that is named.
    fn sheets(&self, choice: &SheetChoice<'_>) -> Result<Vec<Sheet>, InputError> {
        self.check_unpacked(MAX_UNPACKED)?;
        let stated = choice.name;
        let chosen = |all: &[calamine::Sheet]| {
            // What its owner has hidden is not meant, unless by its name.
            let is_meant = |sheet: &&calamine::Sheet| match stated {
                Some(name) => sheet.name == name,
                None => sheet.visible == SheetVisible::Visible,
            };
            let meant = all.iter().filter(is_meant).map(|s| s.name.clone());
            let meant: Vec<String> = meant.collect();
            if meant.is_empty() {
                let names: Vec<String> = all.iter().map(|s| s.name.clone()).collect();
                let expected = match stated {
                    Some(name) => format!("a sheet {}", quote(name)),
                    None => "a sheet that is not hidden".to_owned(),
                };
                let found = format!("the sheets {}", listed(&names));
                return Err(InputError::new(self.file, expected, found));
            }
            Ok(meant)
        };
        let mut cells = Cells {
            file: self.file,
            left: MAX_CELLS,
            decimal_comma: choice.decimal_comma,
        };
        let mut sheets = Vec::new();
        if self.is_ods() {
            let mut book = Ods::new(Cursor::new(self.bytes)).map_err(|e| match e {
                OdsError::Password => self.locked(),
                e => self.damaged(e),
            })?;
            for name in chosen(book.sheets_metadata())? {
                let range = book.worksheet_range(&name).map_err(|e| self.damaged(e))?;
                let (top, left) = range.start().unwrap_or_default();
                let mut sheet = Sheet::new(name);
                for (row, column, value) in range.used_cells() {
                    let place = (top as usize + row, left as usize + column);
                    cells.put(&mut sheet, place, value)?;
                }
                sheets.push(sheet);
            }
            return Ok(sheets);
        }
        let mut book = Xlsx::new(Cursor::new(self.bytes)).map_err(|e| match e {
            XlsxError::Password => self.locked(),
            e => self.damaged(e),
        })?;
        for name in chosen(book.sheets_metadata())? {
            // Charts are sheets, too, and hold no cells.
            let mut reader = match book.worksheet_cells_reader(&name) {
                Err(XlsxError::NotAWorksheet(_)) => continue,
                reader => reader.map_err(|e| self.damaged(e))?,
            };
            let mut sheet = Sheet::new(name);
            while let Some(cell) = reader
                .next_cell_with_formula()
                .map_err(|e| self.damaged(e))?
            {
                let (value, (row, column)) = (Data::from(cell.value), cell.pos);
                // Programs that only write files leave formulas without their values.
                if cell.formula.is_some() && value == Data::Empty {
                    let found = format!("a formula without one in sheet {}", quote(&sheet.name));
                    let error = InputError::new(self.file, "a value beside a formula", found);
                    let hint = "open and save it in a spreadsheet program";
                    return Err(error.at(row as usize + 1).hint(hint));
                }
                cells.put(&mut sheet, (row as usize, column as usize), &value)?;
            }
            sheets.push(sheet);
        }
        Ok(sheets)
    }

    /// The archive's first part names its kind (OpenDocument 1.2, part 3, section 3.3).
    fn is_ods(&self) -> bool {
        let mark = b"opendocument.spreadsheet";
        let start = &self.bytes[..self.bytes.len().min(LOOK)];
        start.windows(mark.len()).any(|w| w == mark)
    }

    /// Unpacks every part once without keeping it: a small archive can hold anything, and what it
    /// states of its sizes need not be true.
    fn check_unpacked(&self, most: u64) -> Result<(), InputError> {
        if !self.bytes.starts_with(b"PK") {
            return Ok(());
        }
        let archive = zip::ZipArchive::new(Cursor::new(self.bytes));
        let mut archive = archive.map_err(|e| self.damaged(e))?;
        let mut left = most;
        for k in 0..archive.len() {
            // A part with a password is met by the reader, which says so.
            let Ok(part) = archive.by_index(k) else {
                continue;
            };
            let size = std::io::copy(&mut part.take(left + 1), &mut std::io::sink());
            let size = size.map_err(|e| self.damaged(e))?;
            left = left.checked_sub(size).ok_or_else(|| {
                let expected = format!("a spreadsheet of at most {most} bytes unpacked");
                InputError::new(self.file, expected, "more")
            })?;
        }
        Ok(())
    }
}

/// A sheet's cells as text, by row and column.
struct Sheet {
    name: String,
    rows: Vec<Vec<String>>,
}

impl Sheet {
    fn new(name: String) -> Self {
        Self {
            name,
            rows: Vec::new(),
        }
    }
}

/// How many cells may still be read, and how numbers are written.
struct Cells<'a> {
    file: &'a str,
    left: usize,
    decimal_comma: bool,
}

impl Cells<'_> {
    /// Puts a cell at its place. Empty ones take none, so that a sheet that is formatted down to its
    /// end is no longer than its values.
    fn put(
        &mut self,
        sheet: &mut Sheet,
        (row, column): (usize, usize),
        value: &Data,
    ) -> Result<(), InputError> {
        let text = self.text(value);
        if text.is_empty() {
            return Ok(());
        }
        let line = sheet.rows.get(row).map_or(0, Vec::len);
        // What a far cell adds: the empty cells before it, and the empty rows.
        let added = (column + 1).saturating_sub(line) + (row + 1).saturating_sub(sheet.rows.len());
        let left = self.left.checked_sub(added);
        if row >= MAX_ROWS || column >= MAX_COLUMNS || left.is_none() {
            let expected = format!(
                "a sheet of at most {MAX_ROWS} rows, {MAX_COLUMNS} columns and {MAX_CELLS} cells"
            );
            let found = format!("row {}, column {}", row + 1, column + 1);
            return Err(InputError::new(self.file, expected, found));
        }
        self.left = left.unwrap_or(0);
        if sheet.rows.len() <= row {
            sheet.rows.resize(row + 1, Vec::new());
        }
        let cells = &mut sheet.rows[row];
        if cells.len() <= column {
            cells.resize(column + 1, String::new());
        }
        cells[column] = text;
        Ok(())
    }

    /// A cell as a table of text has it: times as ISO 8601 or as hours, minutes and seconds.
    fn text(&self, value: &Data) -> String {
        let number = |text: String| match self.decimal_comma {
            true => text.replace('.', ","),
            false => text,
        };
        match value {
            Data::Int(value) => value.to_string(),
            Data::Float(value) => number(value.to_string()),
            // A line of the text is a row of the sheet.
            Data::String(text) | Data::DateTimeIso(text) => {
                text.split_whitespace().collect::<Vec<_>>().join(" ")
            }
            Data::DurationIso(text) => seconds_of(text).map_or(text.clone(), clock),
            Data::Bool(value) => u8::from(*value).to_string(),
            Data::DateTime(time) => stamp(time),
            Data::Error(_) => "error".to_owned(),
            Data::Empty => String::new(),
        }
    }
}

/// A date with its time of the day; a time alone, or one that went by, where there is no date.
fn stamp(time: &ExcelDateTime) -> String {
    if time.is_duration() || time.as_f64() < 1.0 {
        return clock(time.as_f64() * DAY_S);
    }
    let (year, month, day, hour, minute, second, ms) = time.to_ymd_hms_milli();
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}")
}

/// Hours, minutes and seconds to the microsecond.
fn clock(seconds: f64) -> String {
    let us = (seconds.abs() * 1e6).round() as u64;
    let (hours, minutes) = (us / 3_600_000_000, us / 60_000_000 % 60);
    let sign = if seconds < 0.0 { "-" } else { "" };
    let rest = us % 60_000_000;
    format!(
        "{sign}{hours:02}:{minutes:02}:{:02}.{:06}",
        rest / 1_000_000,
        rest % 1_000_000
    )
}

/// Seconds of a time that went by as ISO 8601 writes it, `PT01H02M03.5S`.
fn seconds_of(text: &str) -> Option<f64> {
    text.parse::<jiff::Span>()
        .ok()?
        .total(jiff::Unit::Second)
        .ok()
}

/// Rows as lines with commas; cells with one stand in quotes (RFC 4180).
fn as_text(rows: &[Vec<String>]) -> String {
    let width = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |cell: &str| match cell.contains([',', '"']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.to_owned(),
    };
    let line = |row: &Vec<String>| {
        let empty = std::iter::repeat_n(String::new(), width - row.len());
        let cells: Vec<String> = row.iter().map(|c| cell(c)).chain(empty).collect();
        cells.join(",") + "\n"
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::*;

    #[test]
    fn what_unpacks_to_too_much_is_refused() {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../fixtures/sheets/cell.xlsx"
        );
        let bytes = std::fs::read(file).unwrap();
        let book = Book {
            file,
            bytes: &bytes,
        };
        assert!(book.check_unpacked(10_000).is_err());
        assert!(
            book.check_unpacked(MAX_UNPACKED).is_ok(),
            "negative control"
        );
    }

    #[test]
    fn times_are_written_as_text_has_them() {
        use calamine::ExcelDateTimeType::{DateTime, TimeDelta};
        let of = |value, kind| stamp(&ExcelDateTime::new(value, kind, false));
        assert_eq!(of(45943.541, DateTime), "2025-10-13T12:59:02.400");
        assert_eq!(of(0.5, DateTime), "12:00:00.000000");
        assert_eq!(of(1.25, TimeDelta), "30:00:00.000000");
        assert_eq!(
            seconds_of("PT01H02M03.5S").map(clock).unwrap(),
            "01:02:03.500000"
        );
    }
}
