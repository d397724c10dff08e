//! What a cell of a foreign table holds: a number in one of the forms that programs write, a word
//! for a missing value, or text.

use crate::stamp;
use std::borrow::Cow;

/// Marks between groups of three digits: blanks of several widths (ISO 80000-1), apostrophes.
const GROUP_MARKS: [char; 6] = [' ', '\u{a0}', '\u{202f}', '\u{2009}', '\'', '\u{2019}'];

/// The minus sign, and a dash that people type for it.
const MINUS: [char; 2] = ['\u{2212}', '\u{2013}'];

/// Words for a value that is not there, in small letters: those of programs, spreadsheets, and
/// instruments whose input is open or beyond its range.
const MISSING: &str = "nan|na|n/a|n.a.|null|none|nil|nd|n.d.|missing|no data|nodata|invalid|error|err|bad|fault|-|--|---|\u{2013}|\u{2014}|.|..|?|inf|infinity|\u{221e}|ol|0l|over|overload|overrange|over range|overflow|ovf|ovld|underflow";

/// What a cell holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Content {
    /// A number or a time stamp.
    Value,
    /// Nothing.
    Empty,
    /// A word for a missing value.
    Missing,
    /// Anything else.
    Text,
}

/// What a cell holds; decimals may have a dot or a comma.
pub(crate) fn content(cell: &str) -> Content {
    if cell.is_empty() {
        return Content::Empty;
    }
    // Most cells.
    if cell.parse::<f64>().is_ok_and(f64::is_finite) {
        return Content::Value;
    }
    if is_missing(cell) {
        return Content::Missing;
    }
    let is_number = |text: &str| text.parse::<f64>().is_ok();
    let plain = plain(cell);
    let is_value = is_number(&plain)
        || plain.contains(',') && is_number(&plain.replace('.', "").replace(',', "."))
        || stamp::is_stamp(cell);
    if is_value {
        Content::Value
    } else {
        Content::Text
    }
}

/// Whether a cell is a word for a missing value. Spreadsheets begin their errors with `#`, old C
/// libraries have `#` after a digit (`1.#INF`, `-1.#IND`).
pub(crate) fn is_missing(cell: &str) -> bool {
    let word = cell.to_lowercase();
    let unsigned = word
        .strip_prefix(['+', '-'])
        .filter(|rest| !rest.is_empty())
        .unwrap_or(&word);
    let of_sheet = word
        .strip_prefix('#')
        .is_some_and(|error| error == "na" || error.ends_with(['!', '?']) || error == "n/a");
    // A field that is too narrow for its number is filled.
    let filled = !word.is_empty() && word.chars().all(|c| matches!(c, '*' | '#'));
    of_sheet
        || filled
        || unsigned.starts_with("1.#")
        || is_among(MISSING, unsigned)
        || is_among(MISSING, &word)
}

/// Whether a cell holds a negative number as bookkeepers write it: `(300)`, or `300-`.
pub(crate) fn is_accounted(cell: &str) -> bool {
    let inner = cell
        .strip_prefix('(')
        .and_then(|c| c.strip_suffix(')'))
        .or_else(|| cell.strip_suffix('-'));
    inner.is_some_and(|inner| {
        inner.starts_with(|c: char| c.is_ascii_digit())
            && inner
                .chars()
                .all(|c| c.is_ascii_digit() || matches!(c, '.' | ',') || GROUP_MARKS.contains(&c))
    })
}

/// A number as Rust reads it: exponents after `D` (Fortran's double precision) with an `E`, no
/// marks between groups of three digits, a hyphen for the minus sign, also for a bookkeeper's.
pub(crate) fn plain(cell: &str) -> Cow<'_, str> {
    if is_accounted(cell) {
        let number = format!("-{}", cell.trim_matches(['(', ')', '-']));
        return Cow::Owned(plain(&number).into_owned());
    }
    let exponent = |c: char| matches!(c, 'd' | 'D');
    let odd = |c: char| exponent(c) || MINUS.contains(&c) || GROUP_MARKS.contains(&c);
    // Text keeps its marks: a name with a dash in it is no number.
    if !cell.contains(odd) || cell.contains(|c: char| c.is_alphabetic() && !exponent(c)) {
        return Cow::Borrowed(cell);
    }
    let text = cell.replace(MINUS, "-").replace(exponent, "E");
    let whole = text
        .trim_start_matches(['-', '+'])
        .split(['.', ',', 'E'])
        .next()
        .unwrap_or_default();
    if !whole.contains(GROUP_MARKS) || !grouped(whole, &GROUP_MARKS) {
        return Cow::Owned(text);
    }
    Cow::Owned(text.replace(GROUP_MARKS, ""))
}

/// Digits in groups of three with one kind of mark between them, as 1.000 or 12 500 000.
pub(crate) fn grouped(text: &str, marks: &[char]) -> bool {
    let mut groups = text.split(marks);
    let digits = |g: &str| g.chars().all(|c| c.is_ascii_digit());
    // Thousands do not begin with a zero: 0.500 is one half.
    let first = groups
        .next()
        .is_some_and(|g| (1..=3).contains(&g.len()) && digits(g) && !g.starts_with('0'));
    let between: Vec<char> = text.chars().filter(|c| !c.is_ascii_digit()).collect();
    let alike = between
        .first()
        .is_some_and(|mark| between.iter().all(|other| other == mark));
    first && alike && groups.all(|g| g.len() == 3 && digits(g))
}

/// +1 or -1 for a word or sign of a direction.
pub(crate) fn direction(cell: &str) -> Option<f64> {
    const UP: &str = "+|up|rising|increasing|increase|inc|loading|forward|fwd|ascending|auf|aufw\u{e4}rts|steigend|belastung|hin|mont\u{e9}e|croissant|charge";
    const DOWN: &str = "-|down|falling|decreasing|decrease|dec|unloading|backward|bwd|reverse|rev|descending|ab|abw\u{e4}rts|fallend|entlastung|zur\u{fc}ck|descente|d\u{e9}croissant|d\u{e9}charge";
    let word = cell.replace('\u{2212}', "-").to_lowercase();
    if is_among(UP, &word) {
        return Some(1.0);
    }
    is_among(DOWN, &word).then_some(-1.0)
}

/// Whether a word is one of a list, which has `|` between its words.
pub fn is_among(words: &str, word: &str) -> bool {
    words.split('|').any(|known| known == word)
}

/// Name of a column in one line with single blanks.
pub fn name_of(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_the_forms_of_other_programs_are_read_and_words_are_told_apart() {
        let number = |cell: &str| plain(cell).parse::<f64>().ok();
        for (cell, value) in [
            ("1.5D+03", 1500.0),
            ("-2.5d-1", -0.25),
            ("12 500", 12500.0),
            ("1\u{202f}234\u{202f}567.25", 1_234_567.25),
            ("-5'000", -5000.0),
            ("\u{2212}3.5", -3.5),
            ("\u{2013}100", -100.0),
            ("(1 300.5)", -1300.5),
            ("12.5-", -12.5),
            ("+7", 7.0),
        ] {
            assert_eq!(number(cell), Some(value), "{cell}");
        }
        // Groups that are none: no number, never another one.
        for cell in [
            "1 00",
            "12 3456",
            "0 123",
            "1 000'000",
            "5 N",
            "1D",
            "end",
            "D",
            "(5 N)",
            "(-5)",
            "()",
            "1\u{2013}2",
        ] {
            assert_eq!(number(cell), None, "{cell}");
        }
        for cell in [
            "NaN",
            "n/a",
            "-",
            "#DIV/0!",
            "#N/A",
            "1.#INF",
            "-1.#IND00",
            "-inf",
            "+OL",
            "Overflow",
            "0L",
        ] {
            assert_eq!(content(cell), Content::Missing, "{cell}");
        }
        for cell in ["Mean", "#40", "-b", "A1", "mV/V", "1.5.2"] {
            assert_eq!(content(cell), Content::Text, "{cell}");
        }
        assert_eq!(
            ["+", "Down", "0", "auf", "Entlastung", "abc"].map(direction),
            [Some(1.0), Some(-1.0), None, Some(1.0), Some(-1.0), None]
        );
    }
}
