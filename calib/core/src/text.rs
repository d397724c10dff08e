//! Text as other programs write it: which encoding it has, and which way leads to UTF-8.

const SAVE: &str = "save it as UTF-8";
/// Bytes that are read to recognise what they are.
const START: usize = 4096;

/// What stands where UTF-8 text was expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected UTF-8 text, found {found} ({way_out})")]
pub struct NotUtf8 {
    /// What it is.
    pub found: &'static str,
    /// What to do.
    pub way_out: &'static str,
    /// It is text all the same: [`decoded`] reads it.
    pub is_text: bool,
}

/// What the first bytes of a file are that is no UTF-8 text by its beginning; none where it may be.
pub fn other_than_text(bytes: &[u8]) -> Option<NotUtf8> {
    let start = &bytes[..bytes.len().min(START)];
    let sheet = "save the sheet as CSV UTF-8";
    let says = |found, way_out, is_text| {
        Some(NotUtf8 {
            found,
            way_out,
            is_text,
        })
    };
    match start {
        [b'P', b'K', 3, 4, ..] => {
            let found = "a spreadsheet (.xlsx, .ods) or another zip archive";
            says(found, sheet, false)
        }
        [0xd0, 0xcf, 0x11, 0xe0, ..] => says("an Excel workbook (.xls)", sheet, false),
        [0x1f, 0x8b, ..] => says("a gzip archive", "unpack it first", false),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => says(UTF_16, SAVE, true),
        _ if !start.contains(&0) => None,
        // Western text in UTF-16 without a mark: every other byte is zero.
        _ if start
            .chunks_exact(2)
            .filter(|pair| pair.contains(&0))
            .count()
            * 5
            > start.len() * 2
            && start.iter().filter(|byte| **byte == 0).count() * 5 < start.len() * 3 =>
        {
            says(UTF_16, SAVE, true)
        }
        _ => says("binary data", "expected is a file of text", false),
    }
}

/// What a message repeats of a file's content, or of a parser's words about it: one line, the
/// middle left out where it is long.
pub fn brief(text: &str) -> String {
    /// Characters of the beginning and of the end that are kept.
    const KEPT: [usize; 2] = [220, 80];
    let text = printable(text).replace('\n', " ");
    let text = text.trim();
    let head = text.char_indices().nth(KEPT[0]).map(|(at, _)| at);
    let tail = text.char_indices().rev().nth(KEPT[1] - 1).map(|(at, _)| at);
    match (head, tail) {
        (Some(head), Some(tail)) if head < tail => {
            format!("{} ... {}", &text[..head], &text[tail..])
        }
        _ => text.to_owned(),
    }
}

/// A text for the terminal: its characters that control one (Unicode's Cc but the line's end), that
/// turn or hide others or end a line (Cf, Zl, Zp) are blanks.
pub fn printable(text: &str) -> String {
    let controls = |c: char| {
        matches!(
            c,
            '\u{ad}' | '\u{600}'..='\u{605}' | '\u{61c}' | '\u{6dd}' | '\u{70f}' | '\u{890}' | '\u{891}' | '\u{8e2}' | '\u{180e}'
                | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}' | '\u{110bd}' | '\u{110cd}' | '\u{13430}'..='\u{1343f}' | '\u{1bca0}'..='\u{1bca3}'
                | '\u{1d173}'..='\u{1d17a}' | '\u{e0001}' | '\u{e0020}'..='\u{e007f}'
        )
    };
    text.chars()
        .map(|c| {
            if c != '\n' && (c.is_control() || controls(c)) {
                ' '
            } else {
                c
            }
        })
        .collect()
}

/// UTF-8 text without its byte order mark.
///
/// # Errors
/// What the bytes are instead.
pub fn utf8(bytes: &[u8]) -> Result<&str, NotUtf8> {
    if let Some(other) = other_than_text(bytes) {
        return Err(other);
    }
    let text = std::str::from_utf8(bytes).map_err(|_| LATIN_1)?;
    Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
}

/// Bytes that are text, and not in UTF-8.
const LATIN_1: NotUtf8 = NotUtf8 {
    found: "text in Latin-1 or Windows-1252",
    way_out: SAVE,
    is_text: true,
};
const UTF_16: &str = "UTF-16 text";

/// Text in the encoding that its bytes have (UTF-8, UTF-16, else Windows-1252, which has all of
/// Latin-1), and which it is where it is not UTF-8.
///
/// # Errors
/// What the bytes are that are no text.
pub fn decoded(bytes: &[u8]) -> Result<(String, Option<&'static str>), NotUtf8> {
    let other = match utf8(bytes) {
        Ok(text) => return Ok((text.to_owned(), None)),
        Err(other) => other,
    };
    let (text, damaged) = match other {
        NotUtf8 { is_text: false, .. } => return Err(other),
        NotUtf8 { found: UTF_16, .. } if bytes.starts_with(&[0xfe, 0xff]) => {
            encoding_rs::UTF_16BE.decode_with_bom_removal(bytes)
        }
        NotUtf8 { found: UTF_16, .. } => encoding_rs::UTF_16LE.decode_with_bom_removal(bytes),
        _ => encoding_rs::WINDOWS_1252.decode_without_bom_handling(bytes),
    };
    if damaged {
        let found = "UTF-16 text that is cut or damaged";
        return Err(NotUtf8 {
            found,
            way_out: SAVE,
            is_text: false,
        });
    }
    Ok((text.into_owned(), Some(other.found)))
}

/// A name or number with its unit; "1" is no unit.
pub fn with_unit(what: &str, unit: &str) -> String {
    if matches!(unit, "" | "1") {
        what.to_owned()
    } else {
        format!("{what} {unit}")
    }
}

/// A number with so many significant digits at most and no zeros behind them; an exponent where it
/// is very small or large.
pub fn number(value: f64, digits: usize) -> String {
    let Ok(rounded) = format!("{value:.*e}", digits.saturating_sub(1)).parse::<f64>() else {
        return value.to_string();
    };
    if rounded == 0.0 || (1e-4..1e7).contains(&rounded.abs()) || !rounded.is_finite() {
        rounded.to_string()
    } else {
        format!("{rounded:e}")
    }
}

/// A value and its interval's ends in one format, to the second digit of the half width.
pub fn with_interval(value: f64, interval: [f64; 2]) -> [String; 3] {
    let all = [value, interval[0], interval[1]];
    // The difference of 0.0201 and 0.0199 is a little below 0.0002.
    let half = (interval[1] - interval[0]).abs() / 2.0 * (1.0 + 1e-9);
    let largest = all.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let power = match largest.log10().floor() {
        power if (-3.0..6.0).contains(&power) => 0,
        power => power as i32,
    };
    let decimals = 1.0 - half.log10().floor() + f64::from(power);
    // Without a finite width there is nothing to round to; an interval that is far narrower than
    // its value is not worth its digits.
    if !(all.iter().all(|v| v.is_finite()) && decimals <= 9.0) {
        return all.map(readable);
    }
    all.map(|v| {
        let text = format!("{:.*}", decimals.max(0.0) as usize, v / 10f64.powi(power));
        // Rounding may leave -0.00, whose sign would suggest a direction.
        let is_zero = text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.'));
        match (is_zero, power) {
            (true, _) => text.replace('-', ""),
            (false, 0) => text,
            (false, power) => format!("{text}e{power}"),
        }
    })
}

/// A p-value; the model of the noise says nothing of chances below a billionth.
pub fn chance(p: f64) -> String {
    match p {
        p if p < 1e-9 => "p < 1e-9".to_owned(),
        p if p < 0.01 => format!("p = {p:.1e}"),
        p => format!("p = {p:.2}"),
    }
}

/// Four decimals, or an exponent where these would hide the number.
pub fn readable(value: f64) -> String {
    if value == 0.0 || (0.01..1e6).contains(&value.abs()) {
        format!("{value:.4}")
    } else {
        format!("{value:.4e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utf16(text: &str, mark: bool) -> Vec<u8> {
        let units = mark
            .then_some(0xfeff)
            .into_iter()
            .chain(text.encode_utf16());
        units.flat_map(u16::to_le_bytes).collect()
    }

    #[test]
    fn each_encoding_is_found_by_its_bytes() {
        let text = "Force (N),T (\u{b0}C)\n1,2\n";
        let read = |bytes: &[u8]| decoded(bytes).unwrap();
        assert_eq!(
            read(format!("\u{feff}{text}").as_bytes()),
            (text.to_owned(), None)
        );
        let latin: Vec<u8> = text
            .chars()
            .map(|c| u8::try_from(u32::from(c)).unwrap())
            .collect();
        assert_eq!(
            utf8(&latin),
            Err(LATIN_1),
            "a session's own tables are UTF-8"
        );
        assert_eq!(read(&latin), (text.to_owned(), Some(LATIN_1.found)));
        let swapped: Vec<u8> = utf16(text, true)
            .chunks(2)
            .flat_map(|pair| [pair[1], pair[0]])
            .collect();
        for wide in [utf16(text, true), utf16(text, false), swapped] {
            let (found, name) = read(&wide);
            assert_eq!(
                (found.trim_start_matches('\u{feff}'), name),
                (text, Some("UTF-16 text"))
            );
        }
        assert!(
            decoded(&utf16(text, true)[..11]).is_err(),
            "cut in a character"
        );
        assert_eq!(read(b"\x80\x99").0, "\u{20ac}\u{2122}");
    }

    #[test]
    fn a_message_repeats_the_ends_of_what_is_long_and_in_one_line() {
        assert_eq!(brief(" a\nb\tc "), "a b c");
        let long = format!("begin{}end at line 3", "\u{e9}".repeat(6_000_000));
        let found = brief(&long);
        assert!(
            found.starts_with("begin") && found.ends_with("end at line 3"),
            "{found}"
        );
        assert!(found.chars().count() < 320, "{}", found.chars().count());
        let hidden = brief("a\u{1b}]0;t\u{7}b\u{9b}2J\u{202e}c\u{200b}d\ne");
        assert_eq!(hidden, "a ]0;t b 2J c d e");
        assert_eq!(
            printable("Kraft (N) \u{b0}C\n\u{4e2d}"),
            "Kraft (N) \u{b0}C\n\u{4e2d}",
            "negative control"
        );
        let whole = "x".repeat(299);
        assert_eq!(brief(&whole), whole, "negative control");
    }

    #[test]
    fn a_value_and_its_interval_have_one_format() {
        for (value, interval, texts) in [
            (0.01, [9.92e-3, 0.0102], ["0.01000", "0.00992", "0.01020"]),
            (
                7.0319e-6,
                [6.62e-6, 7.44e-6],
                ["7.03e-6", "6.62e-6", "7.44e-6"],
            ),
            (-1e-4, [-2e-2, 2e-2], ["0.000", "-0.020", "0.020"]),
            (0.0200, [0.0199, 0.0201], ["0.02000", "0.01990", "0.02010"]),
            (2.5, [2.5, 2.5], ["2.5000", "2.5000", "2.5000"]),
        ] {
            assert_eq!(with_interval(value, interval), texts);
        }
        assert_ne!(
            readable(9.925e-3).len(),
            readable(0.0102).len(),
            "negative control"
        );
    }

    #[test]
    fn a_number_has_its_digits_and_no_more() {
        for (value, digits, text) in [
            (20.0, 4, "20"),
            (0.8000000000000002, 12, "0.8"),
            (0.00012345678, 4, "0.0001235"),
            (0.000012345678, 4, "1.235e-5"),
            (1_234_567.8, 4, "1235000"),
            (6.894757293168, 12, "6.89475729317"),
            (-1e9, 4, "-1e9"),
            (0.0, 3, "0"),
        ] {
            assert_eq!(number(value, digits), text);
        }
        assert_eq!(number(f64::NAN, 3), "NaN");
        assert_ne!(number(0.8000000000000002, 17), "0.8", "negative control");
    }

    #[test]
    fn archives_and_other_bytes_are_named() {
        for (bytes, found) in [
            (&b"PK\x03\x04xl/workbook"[..], ".xlsx"),
            (b"\xd0\xcf\x11\xe0\xa1\xb1", ".xls"),
            (b"\x1f\x8b\x08", "gzip"),
            (b"\x00\x01\x02\x03\x00\x00\x00\x07", "binary"),
        ] {
            assert!(utf8(bytes).unwrap_err().found.contains(found), "{found}");
        }
        assert_eq!(utf8(b""), Ok(""));
    }
}
