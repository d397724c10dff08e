//! Tables of text: a session's own, with commas between fields and a dot before decimals, and those
//! of other programs after some header lines. Every cell is known by file, line and column.

use crate::cell::{Content, content, direction, grouped, is_missing, name_of, plain};
use crate::columns::column_range;
use crate::error::{InputError, SessionError, listed, not_utf8, quote};
use crate::form::{Form, LOOK, Place, Preamble};
use crate::separated::{MAX_COLUMNS, Separator, other_separator, records};
use crate::sheet::{SheetChoice, is_spreadsheet, sheet_text};
use crate::units::split_unit;
use crate::warning::{SessionWarning, WarningKind};
use csv::StringRecord;
use std::path::Path;
use wcal_core::provenance::sha256_hex;
use wcal_core::ranges::Range;
use wcal_core::text::{decoded, utf8};
use wcal_core::{InputFile, Purpose};

/// Longest line, bytes: a longer one was never written as a table.
const MAX_LINE: usize = 1 << 22;
/// Share of the letters that a name has in common with the one that was meant.
const ALIKE: f64 = 0.6;
/// Names of a scalar table's column that groups its readings, the first that there is: counters of
/// repetitions are no quantities that act, whichever of them groups.
const GROUPS: [&str; 5] = ["cycle", "replicate", "run", "pose", "day"];
/// Those that are counters wherever they stand.
const COUNTERS: usize = 2;

/// Marks the rows of simulated data; a mark is no covariate.
pub const SIMULATED_COLUMN: &str = "simulated";

/// How a foreign table is laid out.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TextTableLayout {
    /// Lines before the table.
    pub skip_lines: usize,
    /// Names of the columns where the table has no own header line.
    pub columns: Option<Vec<String>>,
    /// Separator; none leaves it to what the file says of itself, else a comma.
    pub separator: Option<Separator>,
    /// Decimals are written with a comma.
    pub decimal_comma: bool,
    /// Columns that are wanted: the table is looked for by them, and cells are read in the forms of
    /// other programs. Without it the table begins at the first line and holds nothing but plain
    /// numbers.
    pub asked: Option<Vec<String>>,
    /// Sheet of a spreadsheet; none leaves it to the columns that are asked for.
    pub sheet: Option<String>,
}

/// A table in memory; cells are text without blanks around it.
#[derive(Debug, Clone, PartialEq)]
pub struct TextTable {
    /// File name for messages.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Column names.
    pub columns: Vec<String>,
    /// Line in the file and cells.
    pub rows: Vec<(usize, StringRecord)>,
    /// Its encoding, where that is not UTF-8.
    pub encoding: Option<&'static str>,
    /// Unit of each column as the table states it in its own line; empty where it does not.
    pub units: Vec<String>,
    /// Lines that are no rows and were passed over.
    pub remarks: Vec<String>,
    /// Breaks of the record, and lines passed over that may have been rows.
    pub warnings: Vec<String>,
    /// Cells may have the forms of other programs.
    foreign: bool,
    /// Numbers that each column may have.
    ranges: Vec<Range>,
    /// The file ends within its last row.
    open_end: bool,
    decimal_comma: bool,
    /// The separator that its lines have in place of the stated one.
    hint: Option<String>,
}

/// A file's text, what encoding it has where that is not UTF-8, and the layout of the text: of a
/// spreadsheet the sheet that holds the table, with commas between its cells.
///
/// # Errors
/// A file that cannot be read, or is neither text nor a whole spreadsheet.
pub fn read_table_text(path: &Path, layout: &TextTableLayout) -> Result<TableText, SessionError> {
    let file = path.display().to_string();
    let bytes = wcal_core::files::read(path).map_err(SessionError::reading)?;
    let sha256 = sha256_hex(&bytes);
    if is_spreadsheet(&bytes) {
        let choice = SheetChoice {
            name: layout.sheet.as_deref(),
            asked: layout.asked.as_deref().unwrap_or_default(),
            decimal_comma: layout.decimal_comma,
        };
        let sheet = sheet_text(&file, &bytes, &choice)?;
        let remark = format!("sheet {} of {}", quote(&sheet.name), sheet.sheets);
        return Ok(TableText {
            text: sheet.text,
            separator: Some(Separator::Comma),
            encoding: None,
            remark: Some(remark),
            sha256,
        });
    }
    let (mut text, encoding) = decoded(&bytes).map_err(|other| not_utf8(&file, &bytes, other))?;
    // Some old programs end their lines in CR alone.
    if text.contains('\r') && !text.contains('\n') {
        text = text.replace('\r', "\n");
    }
    Ok(TableText {
        text,
        separator: layout.separator,
        encoding,
        remark: None,
        sha256,
    })
}

/// The text of a file that holds a table.
#[derive(Debug, Clone)]
pub struct TableText {
    /// Its lines.
    pub text: String,
    /// What stands between its fields, where that is known.
    pub(crate) separator: Option<Separator>,
    /// Its encoding, where that is not UTF-8.
    pub(crate) encoding: Option<&'static str>,
    /// Sheet that it is of.
    pub(crate) remark: Option<String>,
    /// SHA-256 of the file.
    pub(crate) sha256: String,
}

/// Reads a foreign table; its lines end in LF, CR LF or CR. A spreadsheet's sheet is one.
///
/// # Errors
/// A file that cannot be read, is no text, has no row, or has a row whose number of fields differs
/// from the header's.
pub fn read_text_table(path: &Path, layout: &TextTableLayout) -> Result<TextTable, SessionError> {
    let file = path.display().to_string();
    let read = read_table_text(path, layout)?;
    let layout = TextTableLayout {
        separator: read.separator,
        ..layout.clone()
    };
    let mut table = parse(&file, &read.text, &layout)?;
    table.remarks.splice(0..0, read.remark);
    Ok(TextTable {
        sha256: read.sha256,
        encoding: read.encoding,
        ..table
    })
}

/// Reads a table of a session, which messages call `name`.
///
/// # Errors
/// As [`read_text_table`], and where it is in another form than a session's tables have, or names a
/// column twice.
pub(crate) fn read_own(path: &Path, name: &str) -> Result<TextTable, SessionError> {
    let bytes = wcal_core::files::read(path).map_err(|e| match e.source.kind() {
        std::io::ErrorKind::NotFound => {
            InputError::new(name, "a file in the session's folder", "no such file").into()
        }
        _ => SessionError::reading(e),
    })?;
    let way_out = |error: InputError| error.hint("wcal import reads it as it is");
    let text = utf8(&bytes).map_err(|other| {
        let error = not_utf8(name, &bytes, other);
        if other.is_text { way_out(error) } else { error }
    })?;
    if text.contains('\r') && !text.contains('\n') {
        return Err(way_out(InputError::new(
            name,
            "lines that end in LF or CR LF",
            "CR alone",
        ))
        .into());
    }
    let table = parse(name, text, &TextTableLayout::default())?;
    // Of two columns of one name the first would be read, whichever was meant.
    let twice = |k: &usize| table.columns[..*k].contains(&table.columns[*k]);
    if let Some(column) = (0..table.columns.len())
        .find(twice)
        .map(|k| &table.columns[k])
    {
        let error = InputError::new(
            name,
            "every column named once",
            format!("{} twice", quote(column)),
        );
        return Err(error.at(1).field(column).into());
    }
    Ok(TextTable {
        sha256: sha256_hex(&bytes),
        ..table
    })
}

fn too_wide(file: &str, columns: usize) -> InputError {
    InputError::new(
        file,
        format!("at most {MAX_COLUMNS} columns"),
        columns.to_string(),
    )
}

/// As [`read_own`], of a session's readings: where their numbers follow their times, in that order,
/// whatever order the lines have.
///
/// # Errors
/// As [`read_own`].
pub(crate) fn read_readings(path: &Path, name: &str) -> Result<TextTable, SessionError> {
    let table = read_own(path, name)?;
    let (Some(point), Some(t_s)) = (table.place("point"), table.place("t_s")) else {
        return Ok(table);
    };
    let mut rows = table.rows.clone();
    rows.sort_by_cached_key(|(_, cells)| cells[point].parse::<i64>().ok());
    let time = |row: &(usize, StringRecord)| row.1[t_s].parse::<f64>().ok();
    let in_time = rows.iter().all(|r| time(r).is_some()) && rows.is_sorted_by_key(time);
    Ok(if in_time {
        TextTable { rows, ..table }
    } else {
        table
    })
}

fn parse(file: &str, text: &str, layout: &TextTableLayout) -> Result<TextTable, InputError> {
    let skipped = layout.skip_lines;
    let foreign = layout.asked.is_some();
    let mut preamble = if foreign {
        Preamble::read(text)
    } else {
        Preamble::default()
    };
    let start = text
        .split_inclusive('\n')
        .take(skipped)
        .map(str::len)
        .sum::<usize>();
    let text = &text[start..];
    let error = |expected: String, found: String| InputError::new(file, expected, found);
    // Before it is split: a line of a file that is no table may be all of it.
    if let Some((k, line)) = text
        .lines()
        .enumerate()
        .find(|(_, line)| line.len() > MAX_LINE)
    {
        let expected = format!("at most {MAX_LINE} bytes in a line");
        return Err(error(expected, line.len().to_string()).at(skipped + k + 1));
    }
    // Before any line is split, which takes many times its bytes.
    let marks = |line: &str| {
        [',', ';', '\t']
            .map(|mark| line.matches(mark).count())
            .into_iter()
            .max()
            .unwrap_or(0)
    };
    let mut widths = text.lines().take(LOOK).map(marks).enumerate();
    if let Some((k, count)) = widths.find(|(_, count)| *count >= MAX_COLUMNS) {
        return Err(too_wide(file, count + 1).at(skipped + k + 1));
    }
    if let (None, None, Some(asked)) = (layout.separator, &layout.columns, layout.asked.as_deref())
    {
        preamble.find_separator(text, asked, layout.decimal_comma);
    }
    let separator = layout.separator.or(preamble.separator).unwrap_or_default();
    let (stated, asked) = (layout.columns.as_deref(), layout.asked.as_deref());
    let form = match asked {
        Some(asked) => Form::find(
            &Place {
                file,
                text,
                skipped,
                separator,
                stated,
                asked,
            },
            &preamble,
        )?,
        None => plain_form(file, records(text, skipped + 1, separator), stated)?,
    };
    let Form {
        columns,
        units,
        mut rows,
        remarks,
        warnings,
    } = form;
    if columns.len() > MAX_COLUMNS {
        return Err(too_wide(file, columns.len()));
    }
    let hint = other_separator(text, separator);
    for (line, cells) in &mut rows {
        // Some programs end each row with a separator.
        if foreign && cells.iter().skip(columns.len()).all(str::is_empty) {
            cells.truncate(columns.len());
        }
        if cells.len() != columns.len() {
            let expected = format!("{} fields ({})", columns.len(), listed(&columns));
            let usual = "is the file truncated? decimals are written with a dot; for another table see --separator, --skip-lines and --columns of wcal import";
            let error = error(expected, format!("{} fields", cells.len())).at(*line);
            return Err(error.hint(hint.as_deref().unwrap_or(usual)));
        }
    }
    if rows.is_empty() {
        return Err(error(
            "at least one row below the header".into(),
            "an empty table".into(),
        ));
    }
    Ok(TextTable {
        file: file.to_owned(),
        sha256: String::new(),
        ranges: columns.iter().map(|column| column_range(column)).collect(),
        columns,
        rows,
        encoding: None,
        units,
        remarks,
        warnings,
        foreign,
        open_end: !text.ends_with('\n'),
        decimal_comma: layout.decimal_comma || preamble.decimal_comma,
        hint,
    })
}

/// A table that begins with its header, and nothing else.
fn plain_form(
    file: &str,
    mut rows: Vec<(usize, StringRecord)>,
    stated: Option<&[String]>,
) -> Result<Form, InputError> {
    let columns = match stated {
        Some(names) => names.to_vec(),
        None if rows.is_empty() => {
            return Err(InputError::new(
                file,
                "a header line and rows",
                "an empty file",
            ));
        }
        None => rows.remove(0).1.iter().map(str::to_owned).collect(),
    };
    Ok(Form {
        columns,
        rows,
        ..Form::default()
    })
}

impl TextTable {
    /// What deserves attention: the file may have been cut off.
    pub fn warning(&self) -> Option<SessionWarning> {
        let (line, _) = self.rows.last()?;
        let text = format!(
            "the file ends within line {line}, without a line end: if it was cut off there, its last number may lack digits"
        );
        self.open_end
            .then(|| SessionWarning::new(&self.file, WarningKind::OpenEnd, text))
    }

    /// The file and its hash.
    pub(crate) fn input(&self, purpose: Purpose) -> InputFile {
        InputFile {
            path: self.file.clone(),
            sha256: self.sha256.clone(),
            purpose,
        }
    }

    /// Index of a column of a session's table, which names each once.
    pub(crate) fn place(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|c| c == name)
    }

    /// Takes what a reader knows of a session's table; the others, by name. `required` must be
    /// there, and none may be there in another unit.
    pub(crate) fn others(
        &self,
        required: &[&str],
        known: &[&str],
    ) -> Result<Vec<String>, InputError> {
        // A column in another unit would pass for an unknown one, and its numbers be missed.
        for name in required
            .iter()
            .chain(known)
            .filter(|name| self.place(name).is_none())
        {
            let (base, unit) = split_unit(name);
            let other = |c: &&String| {
                let (other, of) = split_unit(c);
                !unit.is_empty() && !of.is_empty() && other == base
            };
            if let Some(column) = self.columns.iter().find(other) {
                let of = split_unit(column).1;
                let error = InputError::new(
                    &self.file,
                    format!("a column {name} in {unit}"),
                    format!("a column {column} in {of}"),
                );
                let hint = format!("convert the values to {unit} and rename the column");
                return Err(error.at(1).field(*name).hint(hint));
            }
        }
        let missing: Vec<&str> = required
            .iter()
            .copied()
            .filter(|name| self.place(name).is_none())
            .collect();
        if !missing.is_empty() {
            return Err(self.without(&missing).at(1));
        }
        let is_known = |c: &&String| {
            !required
                .iter()
                .chain(known)
                .chain([&SIMULATED_COLUMN])
                .any(|n| n == c)
        };
        Ok(self.columns.iter().filter(is_known).cloned().collect())
    }

    /// The column whose readings are left out together: a counter of repetitions, or another group.
    pub(crate) fn group(&self) -> Vec<&'static str> {
        let first = GROUPS
            .iter()
            .position(|name| self.place(name).is_some())
            .unwrap_or(0);
        // The column that groups stands first; a second counter is known as one.
        let counters = GROUPS[..COUNTERS]
            .iter()
            .filter(|name| **name != GROUPS[first]);
        [GROUPS[first]]
            .into_iter()
            .chain(counters.copied())
            .collect()
    }

    /// Index of a column; of several with one name and the same cells the first.
    ///
    /// # Errors
    /// Where there is no such column (the message lists those that there are), or several that
    /// differ.
    pub fn column(&self, name: &str) -> Result<usize, InputError> {
        let own = self.columns_named(name);
        let first = *own.first().ok_or_else(|| self.without(&[name]))?;
        let other = |k: usize| self.rows.iter().find(|(_, cells)| cells[k] != cells[first]);
        if let Some((k, (line, _))) = own.iter().skip(1).find_map(|&k| Some((k, other(k)?))) {
            let found = format!(
                "columns {} and {} of that name, which differ",
                first + 1,
                k + 1
            );
            let error = InputError::new(&self.file, format!("one column {name}"), found)
                .at(*line)
                .field(name);
            return Err(
                error.hint("name every column by --columns, and skip the header by --skip-lines")
            );
        }
        Ok(first)
    }

    /// The error of columns that are wanted and not there, all at once.
    pub fn without(&self, names: &[&str]) -> InputError {
        let found = format!("the columns {}", listed(&self.columns));
        let expected = if let [name] = names {
            format!("a column {name}")
        } else {
            format!("columns {}", names.join(", "))
        };
        let error = InputError::new(&self.file, expected, found).field(names.join(", "));
        let name = names.first().copied().unwrap_or_default();
        match (&self.hint, self.alike(name, ALIKE, |_| true)) {
            (Some(hint), _) => error.hint(hint),
            (None, Some(column)) => error.hint(format!("did you mean {column}?")),
            (None, None) if self.columns.iter().all(|c| content(c) == Content::Value) => {
                error.hint("no header? --columns names the columns")
            }
            (None, None) => error,
        }
    }

    /// The column that is `free` whose name is most like another one, at `least` by so much of it.
    pub fn alike(&self, name: &str, least: f64, free: impl Fn(&str) -> bool) -> Option<&String> {
        let alike =
            |c: &&String| strsim::normalized_levenshtein(&c.to_lowercase(), &name.to_lowercase());
        let nearest = self
            .columns
            .iter()
            .filter(|column| free(column))
            .max_by(|a, b| alike(a).total_cmp(&alike(b)));
        nearest.filter(|c| alike(c) >= least)
    }

    /// Indices of the columns of one name.
    pub fn columns_named(&self, name: &str) -> Vec<usize> {
        let name = if self.foreign {
            name_of(name)
        } else {
            name.to_owned()
        };
        (0..self.columns.len())
            .filter(|&k| self.columns[k] == name)
            .collect()
    }

    /// Whether cells may have the forms of other programs.
    pub(crate) fn is_foreign(&self) -> bool {
        self.foreign
    }

    /// The same file as a table of a session.
    pub(crate) fn of_session(
        self,
        name: &str,
        columns: Vec<String>,
        rows: Vec<(usize, StringRecord)>,
    ) -> Self {
        let file = name.to_owned();
        let ranges = columns.iter().map(|column| column_range(column)).collect();
        Self {
            file,
            columns,
            rows,
            ranges,
            foreign: false,
            decimal_comma: false,
            ..self
        }
    }

    /// +1 or -1 of a cell of a direction, by its sign, number or word.
    ///
    /// # Errors
    /// Where it holds anything else.
    pub fn direction(&self, row: usize, column: usize) -> Result<Option<f64>, InputError> {
        match direction(&self.rows[row].1[column]).filter(|_| self.foreign) {
            Some(sign) => Ok(Some(sign)),
            None => self.number(row, column),
        }
    }

    /// A column in which a dot stands between thousands beside plain numbers: nobody writes 1.500
    /// beside 500 for one and a half.
    ///
    /// # Errors
    /// Where the column looks so and decimals are not declared to have a comma.
    pub fn check_thousands(&self, column: usize) -> Result<(), InputError> {
        let cells = || {
            self.rows
                .iter()
                .map(|(line, c)| (*line, c[column].trim_start_matches(['-', '+'])))
        };
        let plain = |c: &str| c.len() >= 3 && c.chars().all(|d| d.is_ascii_digit());
        let dotted = || cells().filter(|(_, c)| c.contains('.'));
        let suspect = dotted().find(|(_, c)| grouped(c, &['.']) && c.ends_with('0'));
        let Some((line, cell)) = suspect.filter(|_| !self.decimal_comma) else {
            return Ok(());
        };
        if !dotted().all(|(_, c)| grouped(c, &['.'])) || !cells().any(|(_, c)| plain(c)) {
            return Ok(());
        }
        let found = format!("{cell} beside whole numbers");
        let error = InputError::new(&self.file, "decimals written alike in a column", found);
        let hint = "a thousands separator? --decimal-comma reads the dot as one";
        Err(error.at(line).field(&self.columns[column]).hint(hint))
    }

    /// Finite number in a cell that its column may have; none when empty.
    ///
    /// # Errors
    /// Where the cell holds anything else.
    pub fn number(&self, row: usize, column: usize) -> Result<Option<f64>, InputError> {
        let (line, cells) = &self.rows[row];
        let (cell, name) = (&cells[column], &self.columns[column]);
        if cell.is_empty() || self.foreign && is_missing(cell) {
            return Ok(None);
        }
        let error = |expected: &str| {
            InputError::new(&self.file, expected, quote(cell))
                .at(*line)
                .field(name)
        };
        let mut cell = if self.foreign {
            plain(cell)
        } else {
            cell.into()
        };
        // Where decimals have a dot elsewhere, a comma before three digits stands between
        // thousands.
        if self.foreign && !self.decimal_comma && cell.contains(',') {
            let whole = cell
                .trim_start_matches(['-', '+'])
                .split('.')
                .next()
                .unwrap_or_default();
            let dot = |c: &str| c.contains('.') && c.parse::<f64>().is_ok();
            if grouped(whole, &[',']) && self.rows.iter().any(|(_, cells)| cells.iter().any(dot)) {
                cell = cell.replace(',', "").into();
            }
        }
        let parsed = if self.decimal_comma {
            // Where a comma stands before decimals a dot stands between thousands, or the table is
            // of another kind.
            let unsigned = cell.trim_start_matches(['-', '+']);
            let whole = unsigned
                .split_once(',')
                .map_or(unsigned, |(whole, _)| whole);
            let commas = || {
                self.rows
                    .iter()
                    .any(|(_, cells)| cells.iter().any(|c| c.contains(',')))
            };
            if cell.contains('.') && (!grouped(whole, &['.']) || !commas()) {
                let hint = "leave --decimal-comma out where decimals have a dot; with it a dot stands between thousands";
                return Err(error("decimals with a comma").hint(hint));
            }
            cell.replace('.', "").replace(',', ".").parse::<f64>()
        } else {
            cell.parse::<f64>()
        };
        match parsed {
            Ok(value) if value.is_finite() => match self.ranges[column].judge(name, value, true) {
                Ok(()) => Ok(Some(value)),
                Err(e) => Err(InputError::range(&self.file, e).at(*line)),
            },
            Ok(_) => Err(error("a finite number")),
            Err(_) if cell.replace(',', "").parse::<f64>().is_ok() => Err(error("a number")
                .hint("decimals with a comma (--decimal-comma), or a thousands separator?")),
            Err(_) if cell.contains(':') => Err(error("a number")
                .hint("a time of the day? write hh:mm:ss, or name the column t [mm:ss]")),
            Err(_) => Err(error("a number")),
        }
    }
}
