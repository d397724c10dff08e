//! Foreign tables for import: CSV, semicolons, tabs or columns of text after some header lines.

use crate::columns::judge_cell;
use crate::error::{InputError, SessionError, listed, not_utf8, quote};
use crate::table::{check_columns, fields, split_line};
use crate::warning::{SessionWarning, WarningKind};
use std::path::Path;
use wcal_core::provenance::sha256_hex;
use wcal_core::text::decoded;

/// Lines that are looked at to tell another separator.
const LOOK: usize = 20;

/// What stands between fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Separator {
    /// A comma, with quotes as in RFC 4180.
    #[default]
    Comma,
    /// A semicolon.
    Semicolon,
    /// A tab.
    Tab,
    /// Any run of blanks, as in the NIST files.
    Whitespace,
}

impl Separator {
    /// Each with its character, its name in a sentence, and the option of `wcal import` that takes it.
    const ALL: [(Self, char, &'static str, &'static str); 3] = [
        (Self::Comma, ',', "commas", "--separator comma"),
        (Self::Semicolon, ';', "semicolons", "--separator semicolon"),
        (Self::Tab, '\t', "tabs", "--separator tab"),
    ];
}

/// How a foreign table is laid out.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TextTableLayout {
    /// Lines before the table.
    pub skip_lines: usize,
    /// Names of the columns where the table has no header line of its own.
    pub columns: Option<Vec<String>>,
    /// Separator.
    pub separator: Separator,
    /// Decimals are written with a comma.
    pub decimal_comma: bool,
}

/// A foreign table in memory; cells are text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextTable {
    /// File name for messages.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Column names.
    pub columns: Vec<String>,
    /// Line in the file and cells.
    pub rows: Vec<(usize, Vec<String>)>,
    /// Its encoding, where that is not UTF-8.
    pub encoding: Option<&'static str>,
    /// The file ends within its last row.
    open_end: bool,
    decimal_comma: bool,
    /// The separator that its lines have in place of the stated one.
    hint: Option<String>,
}

/// Reads a foreign table; its lines end in LF, CR LF or CR.
///
/// # Errors
/// A file that cannot be read, is no text, has no row, or has a row whose number of fields differs from the header's.
pub fn read_text_table(path: &Path, layout: &TextTableLayout) -> Result<TextTable, SessionError> {
    let file = path.display().to_string();
    let bytes = wcal_core::files::read(path).map_err(|e| SessionError::io("reading", path, e))?;
    let sha256 = sha256_hex(&bytes);
    let (mut text, encoding) = decoded(&bytes).map_err(|other| not_utf8(&file, other))?;
    if text.contains('\r') && !text.contains('\n') {
        text = text.replace('\r', "\n");
    }
    let start = text.split_inclusive('\n').take(layout.skip_lines).map(str::len).sum::<usize>();
    let text = &text[start..];
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let mut record = csv::ByteRecord::new();
    let mut next = || -> Result<Option<(usize, Vec<String>)>, InputError> {
        let Some((index, line)) = lines.next() else { return Ok(None) };
        let number = layout.skip_lines + index + 1;
        Ok(Some((number, split(&file, (number, line), layout.separator, &mut record)?)))
    };
    let columns = match &layout.columns {
        Some(names) => names.clone(),
        None => {
            let header = next()?.map(|(_, cells)| cells);
            header.ok_or_else(|| {
                InputError::new(&file, "a header line and rows", "nothing after the skipped lines")
            })?
        }
    };
    let hint = other_separator(text, layout.separator);
    let mut rows = Vec::new();
    while let Some((line, cells)) = next()? {
        if cells.len() != columns.len() {
            let expected = format!("{} fields ({})", columns.len(), listed(&columns));
            let error = InputError::new(&file, expected, format!("{} fields", cells.len())).at(line);
            let usual = "check the separator, the lines to skip and the column names";
            return Err(error.hint(hint.as_deref().unwrap_or(usual)).into());
        }
        rows.push((line, cells));
    }
    if rows.is_empty() {
        return Err(InputError::new(&file, "at least one row", "an empty table").into());
    }
    let (open_end, decimal_comma) = (!text.ends_with('\n'), layout.decimal_comma);
    Ok(TextTable { file, sha256, columns, rows, encoding, open_end, decimal_comma, hint })
}

/// Another separator than the stated one, which stands equally often in every line while the stated one stands in none; in words.
fn other_separator(text: &str, stated: Separator) -> Option<String> {
    let lines = || text.lines().filter(|line| !line.trim().is_empty()).take(LOOK);
    let counts = |mark: char| lines().map(move |line| line.matches(mark).count());
    let own = Separator::ALL.iter().find(|s| s.0 == stated)?.1;
    let (_, mark, called, option) =
        *Separator::ALL.iter().filter(|s| s.0 != stated).find(|(_, mark, ..)| {
            let first = counts(*mark).next().unwrap_or(0);
            first > 0 && counts(*mark).all(|n| n == first)
        })?;
    // Decimal commas stand in the rows and not in the header.
    let decimals = lines().skip(1).any(|line| line.split(mark).any(is_decimal_comma));
    if counts(own).next() != Some(0) || (counts(own).any(|n| n > 0) && !decimals) {
        return None;
    }
    let decimals = if decimals && own == ',' { " --decimal-comma" } else { "" };
    Some(format!("fields are separated by {called}; wcal import reads them with {option}{decimals}"))
}

/// `1,5` and `-0,25`.
fn is_decimal_comma(cell: &str) -> bool {
    let cell = cell.trim();
    cell.matches(',').count() == 1 && cell.replace(',', ".").parse::<f64>().is_ok()
}

/// Cells of a line, which are counted first.
fn split(
    file: &str,
    (number, line): (usize, &str),
    separator: Separator,
    record: &mut csv::ByteRecord,
) -> Result<Vec<String>, InputError> {
    let delimiter = match separator {
        Separator::Whitespace => {
            let cells = line.split_whitespace();
            check_columns(file, number, cells.clone().count())?;
            return Ok(cells.map(str::to_owned).collect());
        }
        Separator::Comma => b',',
        Separator::Semicolon => b';',
        Separator::Tab => b'\t',
    };
    check_columns(file, number, fields(line.as_bytes(), delimiter))?;
    split_line(line.as_bytes(), delimiter, record);
    Ok(record.iter().map(|cell| String::from_utf8_lossy(cell).trim().to_owned()).collect())
}

/// Digits in groups of three with dots between them, as 1.000 or 12.500.000.
fn grouped(text: &str) -> bool {
    let mut groups = text.split('.');
    let digits = |g: &str| g.chars().all(|c| c.is_ascii_digit());
    let first = groups.next().is_some_and(|g| (1..=3).contains(&g.len()) && digits(g) && !g.starts_with('0'));
    first && text.contains('.') && groups.all(|g| g.len() == 3 && digits(g))
}

impl TextTable {
    /// What deserves attention: the file may have been cut off.
    pub fn warning(&self) -> Option<SessionWarning> {
        let (line, _) = self.rows.last()?;
        self.open_end.then(|| SessionWarning::new(&self.file, WarningKind::OpenEnd { line: *line }))
    }

    /// Index of a column; of several with one name and the same cells the first.
    ///
    /// # Errors
    /// Where there is no such column (the message lists those that there are), or several that differ.
    pub fn column(&self, name: &str) -> Result<usize, InputError> {
        let own = self.columns_named(name);
        let first = *own.first().ok_or_else(|| {
            let found = format!("the columns {}", listed(&self.columns));
            let error = InputError::new(&self.file, format!("a column {name}"), found).field(name);
            match &self.hint {
                Some(hint) => error.hint(hint),
                None => error,
            }
        })?;
        let cell = |cells: &[String], k: usize| cells.get(k).map(|c| c.trim().to_owned());
        let other = |k: usize| self.rows.iter().find(|(_, cells)| cell(cells, k) != cell(cells, first));
        if let Some((k, (line, _))) = own.iter().skip(1).find_map(|&k| Some((k, other(k)?))) {
            let found = format!("columns {} and {} of that name, which differ", first + 1, k + 1);
            let error =
                InputError::new(&self.file, format!("one column {name}"), found).at(*line).field(name);
            return Err(error.hint("name every column by --columns, and skip the header by --skip-lines"));
        }
        Ok(first)
    }

    /// Indices of the columns of one name.
    pub fn columns_named(&self, name: &str) -> Vec<usize> {
        (0..self.columns.len()).filter(|&k| self.columns[k] == name).collect()
    }

    /// A column in which a dot stands between thousands beside plain numbers: nobody writes 1.500 beside 500 for one and a half.
    ///
    /// # Errors
    /// Where the column looks so and decimals are not declared to have a comma.
    pub fn check_thousands(&self, column: usize) -> Result<(), InputError> {
        let cell = |cells: &[String]| {
            cells.get(column).map_or("", |c| c.trim()).trim_start_matches(['-', '+']).to_owned()
        };
        let cells: Vec<(usize, String)> =
            self.rows.iter().map(|(line, cells)| (*line, cell(cells))).collect();
        let plain = |c: &str| c.len() >= 3 && c.chars().all(|d| d.is_ascii_digit());
        let dotted = || cells.iter().filter(|(_, c)| c.contains('.'));
        let suspect = dotted().find(|(_, c)| grouped(c) && c.ends_with('0'));
        let Some((line, cell)) = suspect.filter(|_| !self.decimal_comma) else { return Ok(()) };
        if !dotted().all(|(_, c)| grouped(c)) || !cells.iter().any(|(_, c)| plain(c)) {
            return Ok(());
        }
        let name = self.columns.get(column).map_or("", String::as_str);
        let error = InputError::new(
            &self.file,
            "decimals written alike in a column",
            format!("{cell} beside whole numbers"),
        );
        let hint = "a thousands separator? --decimal-comma reads the dot as one";
        Err(error.at(*line).field(name).hint(hint))
    }

    /// Finite number in a cell that its column may have; none when empty.
    ///
    /// # Errors
    /// Where the cell holds anything else.
    pub fn number(&self, row: usize, column: usize) -> Result<Option<f64>, InputError> {
        let Some((line, cells)) = self.rows.get(row) else { return Ok(None) };
        let Some(cell) = cells.get(column).map(|c| c.trim()).filter(|c| !c.is_empty()) else {
            return Ok(None);
        };
        let name = self.columns.get(column).map_or("", String::as_str);
        let number = if self.decimal_comma && cell.contains('.') {
            // Where a comma stands before decimals a dot stands between thousands, or the table is of another kind.
            let unsigned = cell.trim_start_matches(['-', '+']);
            let whole = unsigned.split_once(',').map_or(unsigned, |(whole, _)| whole);
            let commas = || self.rows.iter().any(|(_, cells)| cells.iter().any(|c| c.contains(',')));
            if !grouped(whole) || !commas() {
                let error = InputError::new(&self.file, "decimals with a comma", quote(cell)).at(*line);
                let hint = "leave --decimal-comma out where decimals have a dot; with it a dot stands between thousands";
                return Err(error.field(name).hint(hint));
            }
            cell.replace('.', "").replace(',', ".")
        } else if self.decimal_comma {
            cell.replace(',', ".")
        } else {
            cell.to_owned()
        };
        let parsed = number.parse::<f64>();
        match parsed {
            Ok(value) if value.is_finite() => match judge_cell(name, value) {
                Ok(()) => Ok(Some(value)),
                Err(e) => Err(InputError::range(&self.file, e).at(*line)),
            },
            Ok(_) => Err(InputError::new(&self.file, "a finite number", quote(cell)).at(*line).field(name)),
            Err(_) => Err(InputError::new(&self.file, "a number", quote(cell)).at(*line).field(name)),
        }
    }
}
