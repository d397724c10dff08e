//! Lines of delimited text and the fields in them.

use csv::StringRecord;

/// Most columns: what has more was never written as a table.
pub(crate) const MAX_COLUMNS: usize = 1000;
/// Lines that are looked at to tell another separator.
const LOOK: usize = 20;
/// Most line ends within one quoted field: with more the quote was none.
const MAX_BREAKS: usize = 8;

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
    /// Each with its character, and its name in a sentence and on the command line.
    const ALL: [(Self, char, &'static str, &'static str); 3] = [
        (Self::Comma, ',', "commas", "comma"),
        (Self::Semicolon, ';', "semicolons", "semicolon"),
        (Self::Tab, '\t', "tabs", "tab"),
    ];

    /// Its name in a sentence and on the command line.
    pub(crate) fn called(self) -> (&'static str, &'static str) {
        Self::ALL
            .iter()
            .find(|s| s.0 == self)
            .map_or(("blanks", "whitespace"), |s| (s.2, s.3))
    }

    /// By its character.
    pub(crate) fn of(mark: char) -> Option<Self> {
        Self::ALL.iter().find(|s| s.1 == mark).map(|s| s.0)
    }
}

impl std::str::FromStr for Separator {
    type Err = String;

    /// By its name on the command line.
    fn from_str(name: &str) -> Result<Self, String> {
        let listed = Self::ALL.iter().find(|s| s.3 == name).map(|s| s.0);
        let found = listed.or((name == "whitespace").then_some(Self::Whitespace));
        found.ok_or_else(|| format!("expected comma, semicolon, tab or whitespace, found {name:?}"))
    }
}

/// The records of a text, each with the line where it begins, the first of the text being `first`.
/// A quoted field may hold line ends (RFC 4180, 2.6). Lines without a field that holds something
/// are none.
pub(crate) fn records(
    text: &str,
    first: usize,
    separator: Separator,
) -> Vec<(usize, StringRecord)> {
    let mark = Separator::ALL
        .iter()
        .find(|s| s.0 == separator)
        .map(|s| s.1);
    let mut rest = text;
    let (mut out, mut line) = (Vec::new(), first);
    while !rest.is_empty() {
        let whole = mark.map_or_else(|| first_line(rest), |mark| record(rest, mark));
        let cells = split(whole, mark);
        if cells.iter().any(|cell| !cell.is_empty()) {
            out.push((line, cells));
        }
        line += whole.matches('\n').count();
        rest = &rest[whole.len()..];
    }
    out
}

fn first_line(text: &str) -> &str {
    text.split_inclusive('\n').next().unwrap_or_default()
}

/// The first record: lines until none of its quotes is open; a quote that stays open is none.
fn record(text: &str, mark: char) -> &str {
    let ends = || {
        text.match_indices('\n')
            .map(|(at, _)| at + 1)
            .chain([text.len()])
            .take(MAX_BREAKS + 1)
    };
    let closed = ends()
        .map(|end| &text[..end])
        .find(|lines| !is_open(lines, mark));
    closed.unwrap_or_else(|| first_line(text))
}

/// Whether a quoted field is open at the end of the text. A quote opens a field at its beginning;
/// two within it are one.
fn is_open(text: &str, mark: char) -> bool {
    let (mut open, mut before) = (false, mark);
    for c in text.chars() {
        open ^= c == '"' && (open || before == mark || before == '"');
        before = if open { ' ' } else { c };
    }
    open
}

fn split(record: &str, mark: Option<char>) -> StringRecord {
    let Some(mark) = mark else {
        // The mark of a comment belongs to its first word.
        let record = record.trim_start();
        let (comment, rest) = record
            .strip_prefix('#')
            .map_or(("", record), |rest| ("#", rest));
        return (comment.to_owned() + rest.trim_start())
            .split_whitespace()
            .collect();
    };
    // A quote that stays open is none, as an inch mark: the line is split as it stands.
    if !record.contains('"') || is_open(record, mark) {
        return record.split(mark).map(str::trim).collect();
    }
    let mut reader = csv::ReaderBuilder::new();
    reader
        .has_headers(false)
        .delimiter(mark as u8)
        .trim(csv::Trim::All);
    // Reading from memory cannot fail.
    reader
        .from_reader(record.as_bytes())
        .records()
        .next()
        .and_then(Result::ok)
        .unwrap_or_default()
}

/// Another separator than the stated one, which stands equally often in every line while the stated
/// one stands in none; in words.
pub(crate) fn other_separator(text: &str, stated: Separator) -> Option<String> {
    let lines = || {
        text.lines()
            .filter(|line| !line.trim().is_empty())
            .take(LOOK)
    };
    let counts = |mark: char| lines().map(move |line| line.matches(mark).count());
    let (_, own, not, _) = Separator::ALL.iter().find(|s| s.0 == stated)?;
    let (_, mark, called, option) =
        *Separator::ALL
            .iter()
            .filter(|s| s.0 != stated)
            .find(|(_, mark, ..)| {
                let first = counts(*mark).next().unwrap_or(0);
                first > 0 && counts(*mark).all(|n| n == first)
            })?;
    // Decimal commas stand in the rows and not in the header.
    let decimals = lines()
        .skip(1)
        .any(|line| line.split(mark).any(is_decimal_comma));
    if counts(*own).next() != Some(0) || (counts(*own).any(|n| n > 0) && !decimals) {
        return None;
    }
    let decimals = if decimals && *own == ',' {
        " --decimal-comma"
    } else {
        ""
    };
    Some(format!(
        "fields are separated by {called}, not {not}; wcal import reads them with --separator {option}{decimals}"
    ))
}

/// `1,5` and `-0,25`.
fn is_decimal_comma(cell: &str) -> bool {
    let cell = cell.trim();
    cell.matches(',').count() == 1 && cell.replace(',', ".").parse::<f64>().is_ok()
}
