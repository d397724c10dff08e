//! The form of a table of another program: where its header and its rows are, and which lines are
//! neither.

use crate::cell::{Content, content, grouped, is_accounted, is_among, name_of};
use crate::error::{InputError, listed, quote};
use crate::quantity::{is_unit, written};
use crate::separated::{Separator, records};
use crate::warning::named;
use csv::StringRecord;

/// Lines of text, of units and the like, that may stand between a header and its rows.
const BELOW: usize = 8;
/// Lines among which the header is looked for.
pub(crate) const LOOK: usize = 2000;
/// How the columns are called under which an oscilloscope writes, once below the header, the first
/// time and the step of its samples.
const START: &str = "start|x0|xzero|xorigin|t0";
const STEP: &str = "increment|xincrement|delta|interval|dx|dt";
/// First line of a LabVIEW measurement file (.lvm), and the line that ends each of its headers.
const LVM: [&str; 2] = ["LabVIEW Measurement", "***End_of_Header***"];

type Record = (usize, StringRecord);

/// What a file says of its form before its table.
#[derive(Debug, Clone, Default)]
pub(crate) struct Preamble {
    pub(crate) separator: Option<Separator>,
    pub(crate) decimal_comma: bool,
    /// Units by column, and the first time and the step where the rows have none (.lvm).
    units: Vec<String>,
    times: Option<[f64; 2]>,
    remark: Option<String>,
}

/// Where a table is looked for.
pub(crate) struct Place<'a> {
    pub(crate) file: &'a str,
    /// The text after `skipped` lines.
    pub(crate) text: &'a str,
    pub(crate) skipped: usize,
    pub(crate) separator: Separator,
    /// Names of the columns, where it has no header.
    pub(crate) stated: Option<&'a [String]>,
    /// Columns that are wanted of it.
    pub(crate) asked: &'a [String],
}

impl Preamble {
    /// Reads `sep=;` (Excel) and the headers of a LabVIEW measurement file.
    pub(crate) fn read(text: &str) -> Self {
        let first = text.lines().next().unwrap_or_default().trim();
        if let Some(mark) = first
            .strip_prefix("sep=")
            .and_then(|rest| rest.chars().next())
        {
            let remark = Some(format!("fields are separated by {mark:?}, as line 1 says"));
            return Self {
                separator: Separator::of(mark),
                remark,
                ..Self::default()
            };
        }
        let Some(mark) = first
            .strip_prefix(LVM[0])
            .map(|rest| rest.chars().next().unwrap_or('\t'))
        else {
            return Self::default();
        };
        let header = || {
            text.lines()
                .take(LOOK)
                .take_while(|line| !line.starts_with("X_Value"))
        };
        let values = |key: &str| -> Vec<String> {
            let line = header()
                .filter(|line| line.split(mark).next() == Some(key))
                .last();
            line.into_iter()
                .flat_map(|l| l.split(mark).skip(1))
                .map(|v| v.trim().to_owned())
                .collect()
        };
        let number = |key: &str| {
            values(key)
                .first()
                .and_then(|v| v.replace(',', ".").parse::<f64>().ok())
        };
        let mut units = values("Y_Unit_Label");
        // The first column is time, which the list of units does not hold.
        units.insert(0, "s".to_owned());
        Self {
            separator: Separator::of(mark),
            decimal_comma: values("Decimal_Separator")
                .first()
                .is_some_and(|v| v == ","),
            units,
            times: number("X0")
                .zip(number("Delta_X"))
                .map(|(start, step)| [start, step]),
            remark: Some("a LabVIEW measurement file".to_owned()),
        }
    }

    /// Where the file says nothing of its separator and no line with commas has any of the names
    /// that are `asked` for, it is the one by which a line has most of them. Cells with a comma are
    /// decimals then, where one cannot be anything else and none has a dot.
    pub(crate) fn find_separator(&mut self, text: &str, asked: &[String], decimal_comma: bool) {
        if self.separator.is_some() {
            return;
        }
        let lines: Vec<&str> = text
            .lines()
            .filter(|line| !line.trim().is_empty())
            .take(LOOK)
            .collect();
        // A line of names, not a remark that has one of them: the next one has as many fields.
        let found = |separator: Separator| {
            let cells = |line: &str| {
                records(line, 1, separator)
                    .into_iter()
                    .next()
                    .map(|(_, cells)| cells)
            };
            let named = |pair: &[&str]| {
                let head = cells(pair[0])
                    .filter(|head| names(head).iter().any(|name| asked.contains(name)));
                let head = head
                    .filter(|head| cells(pair[1]).is_some_and(|below| below.len() == head.len()));
                head.map_or(0, |head| {
                    let names = names(&head);
                    asked.iter().filter(|name| names.contains(name)).count()
                })
            };
            lines.windows(2).map(named).max().unwrap_or(0)
        };
        if found(Separator::Comma) > 0 {
            return;
        }
        let others =
            [Separator::Semicolon, Separator::Tab, Separator::Whitespace].map(|s| (found(s), s));
        // Of equals the first.
        let Some((count, separator)) = others.into_iter().rev().max_by_key(|(count, _)| *count)
        else {
            return;
        };
        if count == 0 {
            return;
        }
        self.separator = Some(separator);
        let (called, option) = separator.called();
        let mut read = format!("read with fields separated by {called} (--separator {option})");
        let rows = records(text, 1, separator);
        let values = || {
            rows.iter()
                .flat_map(|(_, cells)| cells)
                .filter(|cell| content(cell) == Content::Value)
        };
        let commas = || values().filter(|cell| cell.contains(','));
        // `1,500` may be fifteen hundred: another number of digits behind it makes a comma a
        // decimal one.
        let sure = |cell: &str| {
            let whole = cell
                .trim_start_matches(['-', '+', '('])
                .split('.')
                .next()
                .unwrap_or_default();
            !grouped(whole, &[','])
        };
        let dots = values().any(|cell| cell.contains('.') && cell.parse::<f64>().is_ok());
        if !decimal_comma && commas().any(sure) && !dots {
            self.decimal_comma = true;
            read += " and a comma before decimals (--decimal-comma)";
        }
        self.remark = Some(read);
    }
}

/// A table without the lines around it.
#[derive(Debug, Default)]
pub(crate) struct Form {
    pub(crate) columns: Vec<String>,
    /// Units by column, as the table states them below its header; empty where it does not.
    pub(crate) units: Vec<String>,
    pub(crate) rows: Vec<Record>,
    /// What was passed over and is no row.
    pub(crate) remarks: Vec<String>,
    /// Breaks of the record, and lines that may have been rows.
    pub(crate) warnings: Vec<String>,
}

/// Names in a line, the mark of a comment before them left out; a column without one is called by
/// its place, and empty cells at the end name nothing.
fn names(cells: &StringRecord) -> Vec<String> {
    let mut names: Vec<String> = cells.iter().map(name_of).collect();
    // A column may be called # itself.
    let bare = names
        .first()
        .and_then(|first| first.strip_prefix(['#', '%']))
        .map(name_of);
    if let Some(bare) = bare.filter(|bare| !bare.is_empty()) {
        names[0] = bare;
    }
    while names.len() > 1 && names.last().is_some_and(String::is_empty) {
        names.pop();
    }
    for (k, name) in names
        .iter_mut()
        .enumerate()
        .filter(|(_, name)| name.is_empty())
    {
        *name = by_place(k);
    }
    names
}

/// What a column without a name is called.
pub(crate) fn by_place(index: usize) -> String {
    format!("column {}", index + 1)
}

impl Form {
    /// Finds the table in a text: the line with the most of the columns that are `asked` for is its
    /// header; of several, the first with as many fields as most lines have. Without any of them it
    /// is the first such line.
    pub(crate) fn find(place: &Place<'_>, preamble: &Preamble) -> Result<Self, InputError> {
        let mut all = records(place.text, place.skipped + 1, place.separator);
        let mut form = Self {
            remarks: preamble.remark.clone().into_iter().collect(),
            ..Self::default()
        };
        let mut unnamed: Vec<String> = Vec::new();
        if let Some(columns) = place.stated {
            form.columns = columns.to_vec();
        } else {
            let header = header_place(&all, place.asked);
            let rest = all.split_off((header + 1).min(all.len()));
            let Some((line, cells)) = all.pop() else {
                return Err(InputError::new(
                    place.file,
                    "a header line and rows",
                    "an empty file",
                ));
            };
            form.columns = names(&cells);
            let empty = cells.len() - form.columns.len().min(cells.len());
            unnamed = (0..empty)
                .map(|k| by_place(form.columns.len() + k))
                .collect();
            if !all.is_empty() {
                form.remarks.push(format!(
                    "the header is in line {line}; passed over before it: {} line(s)",
                    all.len()
                ));
            }
            all = rest;
        }
        let (comments, mut all): (Vec<Record>, Vec<Record>) =
            all.into_iter().partition(|(_, cells)| is_comment(cells));
        if !comments.is_empty() {
            form.remarks
                .push(format!("comments in line(s) {}", lines(&comments)));
        }
        form.units.clone_from(&preamble.units);
        let sampled = form.sampling(&mut all);
        form.take(place, all)?;
        // A column at the end that has cells and no name.
        let width = form.columns.len();
        let holds = |k: &usize| {
            form.rows
                .iter()
                .any(|(_, cells)| cells.get(width + k).is_some_and(|c| !c.is_empty()))
        };
        let count = (0..unnamed.len())
            .rev()
            .find(holds)
            .map_or(0, |last| last + 1);
        form.columns.extend(unnamed.into_iter().take(count));
        form.accounting();
        form.units.resize(form.columns.len(), String::new());
        form.complete(sampled.or(preamble.times), sampled.is_some());
        Ok(form)
    }

    /// First time and step of samples that the first column counts: they stand in the line below
    /// the header alone, and are taken out of it.
    fn sampling(&mut self, all: &mut [Record]) -> Option<[f64; 2]> {
        let ((_, head), rows) = all.split_first_mut().filter(|(_, rows)| !rows.is_empty())?;
        if head
            .get(0)
            .is_none_or(|first| content(first) != Content::Text)
        {
            return None;
        }
        let stated = |names: &str| {
            let called = |name: &String| {
                let word: String = name
                    .to_lowercase()
                    .chars()
                    .filter(|c| c.is_alphanumeric())
                    .collect();
                is_among(names, &word)
            };
            let column = self.columns.iter().position(called)?;
            let alone = rows
                .iter()
                .all(|(_, cells)| cells.get(column).is_none_or(str::is_empty));
            Some((
                column,
                head.get(column)?.parse::<f64>().ok().filter(|_| alone)?,
            ))
        };
        let (start, step) = (stated(START)?, stated(STEP)?);
        let [of_start, of_step] = [start.0, step.0].map(|k| &self.columns[k]);
        self.remarks.push(format!(
            "{} counts samples: times in s by {of_start} and {of_step}",
            self.columns[0]
        ));
        let words = head.iter().enumerate().map(|(k, cell)| match k {
            0 => "s",
            _ if k == start.0 || k == step.0 => "",
            _ => cell,
        });
        *head = words.collect();
        Some([start.1, step.1])
    }

    /// Takes the rows: of each part between two headers what remains without the lines of text
    /// below its header and at its end.
    fn take(&mut self, place: &Place<'_>, all: Vec<Record>) -> Result<(), InputError> {
        let stated = place.stated.is_some() && place.skipped == 0;
        let numeric = numeric_columns(&all, self.columns.len());
        let (mut again, mut between, mut foot) = (Vec::new(), Vec::new(), Vec::new());
        let mut parts: Vec<Vec<Record>> = vec![Vec::new()];
        let (mut others, mut elsewhere): (Vec<Vec<Record>>, bool) = (Vec::new(), false);
        let heads: Vec<bool> = (0..all.len())
            .map(|k| self.heads_another(&all[k..]))
            .collect();
        let mut end = None;
        for ((line, cells), heads) in all.into_iter().zip(heads) {
            let after_gap = end.replace(line).is_some_and(|end| line > end + 1);
            let text = is_text(&cells);
            if text && self.is_header(&cells) {
                elsewhere = false;
                again.push((line, cells));
                parts.push(Vec::new());
                continue;
            }
            if text {
                self.refuse_other_order(place, (line, &cells))?;
            }
            let below = || {
                parts
                    .last()
                    .is_some_and(|part| part.iter().any(|(_, cells)| !is_text(cells)))
            };
            if heads && below() {
                // Without a line between them it may be a remark, and what follows may belong to
                // the table.
                if !after_gap && cells.len() == self.columns.len() {
                    let found = format!("names in place of numbers, {}", quote(&joined(&cells)));
                    let error = InputError::new(place.file, "rows of one table", found).at(line);
                    return Err(
                        error.hint("another table? split the file; a remark? begin it with #")
                    );
                }
                others.push(Vec::new());
                elsewhere = true;
            }
            let tables = if elsewhere { &mut others } else { &mut parts };
            if let Some(rows) = tables.last_mut() {
                rows.push((line, cells));
            }
        }
        for other in &others {
            if let Some(((line, cells), rows)) = other.split_first() {
                self.warnings.push(format!(
                    "another table begins in line {line} ({}): its {} line(s) are not read",
                    quote(&joined(cells)),
                    rows.len()
                ));
            }
        }
        for (k, mut part) in parts.into_iter().enumerate() {
            // Directly below a header a line without any number is no reading: units, or how the
            // values were made.
            let first = part
                .iter()
                .position(|(_, cells)| !is_text(cells))
                .unwrap_or(0);
            let below: Vec<Record> = part.drain(..first).collect();
            // Units are in the line that has most of those that are known.
            let known = |(_, cells): &&Record| cells.iter().filter(|cell| is_unit(cell)).count();
            if let Some((_, cells)) = below.iter().rev().max_by_key(known) {
                self.remarks.push(format!(
                    "no readings below the header: line(s) {}",
                    lines(&below)
                ));
                // Where the columns are stated the first line may be the header that they replace.
                if k == 0 && !stated && !numbers_columns(cells) {
                    self.units = cells.iter().map(written).collect();
                }
            }
            let last = part
                .iter()
                .rposition(|(_, cells)| !misfits(cells, &numeric));
            // Where no line fits, the error of the first of them says more.
            foot.extend(part.split_off(last.map_or(part.len(), |last| last + 1)));
            let (text, rows): (Vec<Record>, Vec<Record>) =
                part.into_iter().partition(|(_, cells)| {
                    last.is_some() && is_text(cells) && misfits(cells, &numeric)
                });
            between.extend(text);
            self.rows.extend(rows);
        }
        for (what, records) in [
            (
                "the header stands again (the record was interrupted there)",
                again,
            ),
            ("text between the rows", between),
            ("no readings below the rows", foot),
        ] {
            if !records.is_empty() {
                let says = format!(
                    "{what}: passed over line(s) {}{}",
                    lines(&records),
                    quoted(&records)
                );
                self.warnings.push(says);
            }
        }
        Ok(())
    }

    fn is_header(&self, cells: &StringRecord) -> bool {
        names(cells) == self.columns
    }

    /// Whether a line below the rows names the columns of another table: it has a name in each
    /// field, and as many fields as the numbers below it.
    fn heads_another(&self, from: &[Record]) -> bool {
        let Some(((_, head), below)) = from.split_first() else {
            return false;
        };
        let names = head
            .iter()
            .filter(|cell| content(cell) == Content::Text)
            .count();
        let mut below = below.iter().take(BELOW);
        names > 1
            && names == head.len()
            && below
                .find(|(_, cells)| self.is_header(cells) || !is_text(cells))
                .is_some_and(|(_, row)| row.len() == names && !self.is_header(row))
    }

    /// Says numbers in parentheses, which bookkeepers write for negative ones.
    fn accounting(&mut self) {
        let mut cells = self
            .rows
            .iter()
            .flat_map(|(_, cells)| cells)
            .filter(|cell| is_accounted(cell));
        if let Some(first) = cells.next() {
            let count = 1 + cells.count();
            self.remarks.push(format!(
                "{first} and the like are negative numbers ({count} cells)"
            ));
        }
    }

    /// A line that names all the columns in another order is the header of another table.
    fn refuse_other_order(
        &self,
        place: &Place<'_>,
        (line, cells): (usize, &StringRecord),
    ) -> Result<(), InputError> {
        let found = names(cells);
        if place.asked.is_empty() || !place.asked.iter().all(|name| found.contains(name)) {
            return Ok(());
        }
        let expected = format!("the columns {}", listed(&self.columns));
        let error = InputError::new(
            place.file,
            expected,
            format!("the columns {}", listed(&found)),
        )
        .at(line);
        Err(error.hint("another table begins there: split the file"))
    }

    /// Says the units, and fills in what a file with the first time and the step at its head leaves
    /// out of its rows: the times, where these are no numbers of samples, and empty cells at the
    /// end.
    fn complete(&mut self, times: Option<[f64; 2]>, counted: bool) {
        let units = self
            .columns
            .iter()
            .zip(&self.units)
            .filter(|(_, unit)| !unit.is_empty());
        let units: Vec<String> = units
            .map(|(column, unit)| format!("{column} in {unit}"))
            .collect();
        if !units.is_empty() {
            self.remarks
                .push(format!("units of the table: {}", units.join(", ")));
        }
        let Some([start, step]) = times else { return };
        let untimed = self.rows.iter().all(|(_, cells)| cells.get(0) == Some(""));
        for (k, (_, cells)) in self.rows.iter_mut().enumerate() {
            let place = if counted {
                cells[0].parse().ok()
            } else {
                untimed.then_some(k as f64)
            };
            let time =
                place.map_or_else(|| cells[0].to_owned(), |k| (start + step * k).to_string());
            let more = self.columns.len().saturating_sub(cells.len());
            let rest = cells
                .iter()
                .skip(1)
                .map(str::to_owned)
                .chain(vec![String::new(); more]);
            *cells = [time].into_iter().chain(rest).collect();
        }
    }
}

/// Where the header is among the first lines.
fn header_place(all: &[Record], asked: &[String]) -> usize {
    let mut widths = std::collections::HashMap::new();
    all.iter()
        .for_each(|(_, cells)| *widths.entry(cells.len()).or_insert(0) += 1);
    // The usual width tells the header from a remark that holds one of the names.
    let usual = widths
        .iter()
        .max_by_key(|(width, count)| (**count, **width))
        .map(|(width, _)| *width);
    let score = |(_, cells): &Record| {
        let names = names(cells);
        (
            asked.iter().filter(|name| names.contains(name)).count(),
            Some(cells.len()) == usual,
        )
    };
    // The first of the best.
    let places = (0..all.len().min(LOOK)).rev();
    places.max_by_key(|&place| score(&all[place])).unwrap_or(0)
}

/// Columns in most of whose cells a number stands, of those that hold anything.
fn numeric_columns(all: &[Record], width: usize) -> Vec<bool> {
    let mut balance = vec![0_i64; width];
    for (_, cells) in all.iter().filter(|(_, cells)| cells.len() >= width) {
        for (balance, cell) in balance.iter_mut().zip(cells) {
            *balance += match content(cell) {
                Content::Value => 1,
                Content::Text => -1,
                Content::Empty | Content::Missing => 0,
            };
        }
    }
    balance.into_iter().map(|balance| balance > 0).collect()
}

/// A line with text and without any number, or one that numbers the columns, as forms have it: (1)
/// (2) (3). Where each field begins like a number, as `300 N`, it is a reading that cannot be read.
fn is_text(cells: &StringRecord) -> bool {
    if numbers_columns(cells) {
        return true;
    }
    let mut text = false;
    let held = || cells.iter().filter(|cell| !cell.is_empty());
    if held().count() > 1 && held().all(begins_like_number) {
        return false;
    }
    for cell in cells {
        match content(cell) {
            Content::Value => return false,
            Content::Text => text = true,
            Content::Empty | Content::Missing => {}
        }
    }
    text
}

/// A line that begins with text and is none of the rows: it has text where these have numbers,
/// another number of fields, or the name of a statistic.
fn misfits(cells: &StringRecord, numeric: &[bool]) -> bool {
    let mut held = cells.iter().filter(|cell| !cell.is_empty());
    let first = held.next();
    let begins = first.is_some_and(|cell| {
        content(cell) == Content::Text
            && !(begins_like_number(cell) && held.all(begins_like_number))
    });
    let odd = || {
        cells
            .iter()
            .zip(numeric)
            .any(|(cell, numeric)| *numeric && content(cell) == Content::Text)
    };
    begins && (cells.len() != numeric.len() || odd() || first.is_some_and(is_statistic))
}

fn numbers_columns(cells: &StringRecord) -> bool {
    cells.len() > 1
        && cells
            .iter()
            .enumerate()
            .all(|(k, cell)| cell == format!("({})", k + 1))
}

fn begins_like_number(cell: &str) -> bool {
    cell.trim_start_matches(|c: char| !c.is_alphanumeric())
        .starts_with(|c: char| c.is_ascii_digit())
}

/// Names of what is computed of a column and written below it.
fn is_statistic(cell: &str) -> bool {
    const NAMES: &str = "mean|average|avg|median|sum|total|min|minimum|max|maximum|std|stdev|std dev|sd|standard deviation|mittelwert|mittel|summe|stabw|standardabweichung";
    let word = cell.to_lowercase().replace('.', "");
    is_among(NAMES, word.trim_end_matches(':').trim())
}

fn is_comment(cells: &StringRecord) -> bool {
    cells
        .get(0)
        .is_some_and(|first| first.starts_with(['#', '%']) && content(first) == Content::Text)
}

fn lines(records: &[Record]) -> String {
    named(&records.iter().map(|(line, _)| *line).collect::<Vec<_>>())
}

/// The first of some lines as they stand there.
fn quoted(records: &[Record]) -> String {
    records.first().map_or_else(String::new, |(_, cells)| {
        format!(" ({})", quote(&joined(cells)))
    })
}

fn joined(cells: &StringRecord) -> String {
    cells
        .iter()
        .filter(|cell| !cell.is_empty())
        .collect::<Vec<_>>()
        .join(", ")
}
