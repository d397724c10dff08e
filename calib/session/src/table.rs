//! CSV tables: streamed, hashed while read, every cell known by file, line and column.

use crate::columns::{MAX_COLUMNS, column_range};
use crate::error::{InputError, SessionError, listed, not_utf8_table, quote};
use crate::row::{Column, Row};
use crate::units::split_unit;
use crate::warning::{SessionWarning, WarningKind};
use csv::ByteRecord;
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use wcal_core::ranges::Range;
use wcal_core::text::{LATIN_1, other_than_text};
use wcal_core::{InputFile, Purpose};

/// Longest line that is read, bytes: what is longer was never written as a table.
const MAX_LINE: u64 = 1 << 22;
/// Names of a scalar table's column that groups its readings where it counts no repetitions.
const GROUPS: [&str; 3] = ["run", "pose", "day"];

/// Marks the rows of simulated data; a mark is no covariate.
pub const SIMULATED_COLUMN: &str = "simulated";

/// An open table positioned after its header.
pub(crate) struct Table {
    file: String,
    columns: Vec<String>,
    ranges: Vec<&'static Range>,
    used: Vec<bool>,
    lines: Lines,
    record: ByteRecord,
    rows: usize,
}

impl Table {
    /// Opens `path` and reads the header; messages and rows call the file `name`.
    pub(crate) fn open(path: &Path, name: &str) -> Result<Self, SessionError> {
        let opened = wcal_core::files::open(path).and_then(|file| {
            let mut file = BufReader::with_capacity(1 << 16, file);
            let other = other_than_text(file.fill_buf()?);
            Ok((file, other))
        });
        let (file, other) = opened.map_err(|e| missing_is_a_defect(path, name, e))?;
        if let Some(other) = other {
            return Err(not_utf8_table(name, other).into());
        }
        let mut lines = Lines { file, digest: Sha256::new(), text: Vec::new(), line: 0, open_end: false };
        let io = |e| SessionError::io("reading", path, e);
        if !lines.next_line().map_err(io)? {
            return Err(InputError::new(name, "a header line and rows", "an empty file").into());
        }
        let mut record = ByteRecord::new();
        check_columns(name, 1, fields(&lines.text, b','))?;
        split_line(lines.text.trim_ascii_end(), b',', &mut record);
        let columns = header(name, &record)?;
        let used = columns.iter().map(|c| c == SIMULATED_COLUMN).collect();
        let ranges = columns.iter().map(|c| column_range(c)).collect();
        Ok(Self { file: name.to_owned(), columns, ranges, used, lines, record, rows: 0 })
    }

    /// File name as used in messages.
    pub(crate) fn file(&self) -> &str {
        &self.file
    }

    /// The column, if the table has it. A column of the same quantity in another unit is an error.
    pub(crate) fn optional(&mut self, name: &'static str) -> Result<Option<Column>, InputError> {
        if let Some(index) = self.columns.iter().position(|c| c == name) {
            self.used[index] = true;
            return Ok(Some(Column { index, name }));
        }
        let (base, unit) = split_unit(name);
        if unit.is_empty() {
            return Ok(None);
        }
        for column in &self.columns {
            let (other_base, other_unit) = split_unit(column);
            if other_base == base && !other_unit.is_empty() {
                return Err(self.wrong_unit(name, unit, column, other_unit));
            }
        }
        Ok(None)
    }

    /// The column whose readings are left out together: cycle or replicate, else the first of [`GROUPS`] that the table has.
    pub(crate) fn group(&mut self) -> Result<Option<Column>, InputError> {
        // Counters of repetitions are no quantities that act, whichever of them groups.
        let counters = [self.optional("cycle")?, self.optional("replicate")?];
        if let Some(counter) = counters.into_iter().flatten().next() {
            return Ok(Some(counter));
        }
        for name in GROUPS {
            if let Some(column) = self.optional(name)? {
                return Ok(Some(column));
            }
        }
        Ok(None)
    }

    /// The column, which must be there.
    pub(crate) fn required(&mut self, name: &'static str) -> Result<Column, InputError> {
        if let Some(column) = self.optional(name)? {
            return Ok(column);
        }
        let (base, unit) = split_unit(name);
        let near = self.columns.iter().find(|c| c.as_str() == base || c.eq_ignore_ascii_case(name));
        if let Some(near) = near.filter(|_| !unit.is_empty() || base == name) {
            let hint = format!("rename {near:?} if its values fit the name {name:?}");
            return Err(self.no_column(name, &format!("a column {near:?}")).hint(hint));
        }
        Err(self.no_column(name, &format!("the columns {}", listed(&self.columns))))
    }

    fn no_column(&self, name: &str, found: &str) -> InputError {
        InputError::new(&self.file, format!("a column {name}"), found).at(1).field(name)
    }

    fn wrong_unit(&self, name: &str, unit: &str, column: &str, other: &str) -> InputError {
        InputError::new(
            &self.file,
            format!("a column {name} in {unit}"),
            format!("a column {column} in {other}"),
        )
        .at(1)
        .field(name)
        .hint(format!("convert the values to {unit} and rename the column"))
    }

    /// Columns that nobody asked for, with their index.
    pub(crate) fn unused(&self) -> Vec<(usize, String)> {
        let unused = self.columns.iter().enumerate().filter(|(i, _)| !self.used[*i]);
        unused.map(|(i, c)| (i, c.clone())).collect()
    }

    /// Columns that somebody asked for.
    pub(crate) fn present(&self) -> Vec<String> {
        self.columns.iter().zip(&self.used).filter(|(_, used)| **used).map(|(c, _)| c.clone()).collect()
    }

    /// The next row, or none at the end.
    pub(crate) fn next_row(&mut self) -> Result<Option<Row<'_>>, SessionError> {
        let more = self.lines.next_line();
        if !more.map_err(|e| SessionError::io("reading", Path::new(&self.file), e))? {
            return Ok(None);
        }
        split_line(self.lines.text.trim_ascii_end(), b',', &mut self.record);
        let line = self.lines.line;
        if self.record.len() != self.columns.len() {
            return Err(self.wrong_width(line).into());
        }
        self.rows += 1;
        let (file, columns, ranges) = (self.file.as_str(), &self.columns, &self.ranges);
        Ok(Some(Row { file, line, columns, ranges, record: &self.record }))
    }

    /// Of a table that was read to its end: whether its last row is without the end of its line.
    pub(crate) fn open_end(&self) -> Option<SessionWarning> {
        let kind = WarningKind::OpenEnd { line: self.lines.line };
        self.lines.open_end.then(|| SessionWarning::new(&self.file, kind))
    }

    fn wrong_width(&self, line: usize) -> InputError {
        let (fields, wanted) = (self.record.len(), self.columns.len());
        let last = self.columns.get(fields).cloned();
        let found = format!("{fields} fields");
        let error = InputError::new(&self.file, format!("{wanted} fields as in the header"), found).at(line);
        match last {
            Some(first_missing) => error.field(first_missing).hint("is the file truncated?"),
            None => error.hint("decimals are written with a dot; an unquoted comma separates fields"),
        }
    }

    /// The file's hash, once every row has been read; an error where there was none.
    pub(crate) fn finish(self) -> Result<InputFile, InputError> {
        if self.rows == 0 {
            return Err(InputError::new(&self.file, "at least one row below the header", "an empty table"));
        }
        let digest = self.lines.digest.finalize();
        let sha256 = digest.iter().map(|b| format!("{b:02x}")).collect();
        Ok(InputFile { path: self.file, sha256, purpose: Purpose::Description })
    }
}

/// Fields of a line, before anything is made of them; quoted separators count, too.
pub(crate) fn fields(text: &[u8], separator: u8) -> usize {
    1 + text.iter().filter(|byte| **byte == separator).count()
}

/// Refuses a line of more columns than a table has.
pub(crate) fn check_columns(name: &str, line: usize, columns: usize) -> Result<(), InputError> {
    if columns <= MAX_COLUMNS {
        return Ok(());
    }
    Err(InputError::new(name, format!("at most {MAX_COLUMNS} columns"), columns.to_string()).at(line))
}

fn header(name: &str, record: &ByteRecord) -> Result<Vec<String>, InputError> {
    let mut columns: Vec<String> = Vec::with_capacity(record.len());
    for field in record {
        let text = std::str::from_utf8(field).map_err(|_| not_utf8_table(name, LATIN_1).at(1))?;
        columns.push(text.trim_start_matches('\u{feff}').trim().to_owned());
    }
    if columns.len() == 1 {
        for (separator, called) in [(';', "semicolons"), ('\t', "tabs")] {
            if columns[0].contains(separator) {
                return Err(InputError::new(
                    name,
                    "fields separated by commas",
                    format!("fields separated by {called}"),
                )
                .at(1)
                .hint("wcal import makes a session's table of any other; or save it with commas between fields and a dot for decimals"));
            }
        }
    }
    let mut first: HashMap<&str, usize> = HashMap::new();
    for (index, column) in columns.iter().enumerate() {
        if let Some(before) = first.insert(column, index) {
            let found =
                format!("column {} and column {} both named {}", before + 1, index + 1, quote(column));
            return Err(InputError::new(name, "every column named once", found).at(1).field(column.clone()));
        }
    }
    Ok(columns)
}

fn missing_is_a_defect(path: &Path, name: &str, error: std::io::Error) -> SessionError {
    if error.kind() == std::io::ErrorKind::NotFound {
        return InputError::new(name, "a file in the session's folder", "no such file")
            .hint(path.display().to_string())
            .into();
    }
    SessionError::io("reading", path, error)
}

/// Records of a file, one a line: hashed as read, blank lines skipped, line numbers exact for any line ending.
struct Lines {
    file: BufReader<File>,
    digest: Sha256,
    /// The latest line that is not blank.
    text: Vec<u8>,
    /// Its number, from 1.
    line: usize,
    /// The file ends within it.
    open_end: bool,
}

impl Lines {
    /// The next line that is not blank; false at the end of the file.
    fn next_line(&mut self) -> std::io::Result<bool> {
        loop {
            self.text.clear();
            let read = (&mut self.file).take(MAX_LINE + 1).read_until(b'\n', &mut self.text)?;
            if read == 0 {
                return Ok(false);
            }
            if read as u64 > MAX_LINE {
                let line = self.line + 1;
                let found = format!("line {line}: expected at most {MAX_LINE} bytes, found more");
                return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, found));
            }
            self.digest.update(&self.text);
            self.line += 1;
            let text = self.text.trim_ascii_end();
            if text.contains(&b'\r') {
                let line = self.line;
                let found = format!(
                    "line {line}: expected lines that end in LF or CR LF, found CR alone (wcal import reads them)"
                );
                return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, found));
            }
            if !text.is_empty() {
                self.open_end = self.text.last() != Some(&b'\n');
                return Ok(true);
            }
        }
    }
}

/// Splits one line into fields; quotes as in RFC 4180, within the line.
pub(crate) fn split_line(text: &[u8], separator: u8, record: &mut ByteRecord) {
    record.clear();
    if !text.contains(&b'"') {
        text.split(|byte| *byte == separator).for_each(|field| record.push_field(field));
        return;
    }
    let mut reader = csv::ReaderBuilder::new().has_headers(false).delimiter(separator).from_reader(text);
    // Reading from memory cannot fail; an open quote ends with the line and shows as a wrong number of fields.
    if !matches!(reader.read_byte_record(record), Ok(true)) {
        record.clear();
    }
}
