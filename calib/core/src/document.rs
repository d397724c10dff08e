//! Documents as they are read: syntax, format and version, the range of every number, and only then
//! the type. Files are read by [`crate::files::read_text`], which limits their size; what is wrong
//! is said in one line of limited length.

use crate::format::{self, FormatMismatch};
use crate::ranges::{self, Numbers, OutOfRange, Range};
use crate::text::brief;
use serde::de::DeserializeOwned;

/// Why a text is no such document.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DocumentError {
    /// Neither JSON nor TOML, or other keys and types than it has.
    #[error("{0}")]
    Content(String),
    /// Another format or version.
    #[error(transparent)]
    Format(#[from] FormatMismatch),
    /// A number that its key cannot have.
    #[error(transparent)]
    Range(#[from] OutOfRange),
}

impl From<serde_json::Error> for DocumentError {
    /// Its words end with the line.
    fn from(error: serde_json::Error) -> Self {
        Self::Content(brief(&error.to_string()))
    }
}

/// An error of TOML by its line; its own text repeats the whole line, however long that is.
fn toml_error(text: &str, error: &toml::de::Error) -> DocumentError {
    DocumentError::Content(match error.span() {
        Some(span) => {
            let before = &text.as_bytes()[..span.start.min(text.len())];
            let line = before.iter().filter(|byte| **byte == b'\n').count();
            let key = text
                .split('\n')
                .nth(line)
                .and_then(|own| own.split_once('='))
                .map(|(key, _)| key.trim());
            let key = key
                .filter(|key| !key.is_empty())
                .map_or_else(String::new, |key| format!("{}: ", brief(key)));
            format!("{key}{} at line {}", brief(error.message()), line + 1)
        }
        None => brief(&error.to_string()),
    })
}

/// Reads JSON of any format.
///
/// # Errors
/// Where it is none.
pub fn json(text: &str) -> Result<serde_json::Value, DocumentError> {
    Ok(serde_json::from_str(text)?)
}

/// Reads TOML of any format.
///
/// # Errors
/// Where it is none.
pub fn toml(text: &str) -> Result<toml::Table, DocumentError> {
    text.parse()
        .map_err(|e: toml::de::Error| toml_error(text, &e))
}

/// Reads JSON whose format is no matter, or is judged later.
///
/// # Errors
/// Where it has other keys and types.
pub fn json_as<T: DeserializeOwned>(text: &str) -> Result<T, DocumentError> {
    Ok(serde_json::from_str(text)?)
}

/// Reads TOML whose format is no matter, or is judged later.
///
/// # Errors
/// Where it has other keys and types.
pub fn toml_as<T: DeserializeOwned>(text: &str) -> Result<T, DocumentError> {
    toml::from_str(text).map_err(|e| toml_error(text, &e))
}

/// Reads a JSON document of a format.
///
/// # Errors
/// The first thing that is wrong, in the order of the module.
pub fn from_json<T: DeserializeOwned>(
    text: &str,
    format: &str,
    ranges: &[&[Range]],
) -> Result<T, DocumentError> {
    let value = json(text)?;
    checked(&value, value["format"].as_str(), format, ranges)?;
    // From the text once more: errors of keys and types then name the line.
    json_as(text)
}

/// Reads a TOML document of a format.
///
/// # Errors
/// As [`from_json`].
pub fn from_toml<T: DeserializeOwned>(
    text: &str,
    format: &str,
    ranges: &[&[Range]],
) -> Result<T, DocumentError> {
    let table = toml(text)?;
    checked(
        &table,
        table.get("format").and_then(toml::Value::as_str),
        format,
        ranges,
    )?;
    toml_as(text)
}

fn checked(
    document: &impl Numbers,
    found: Option<&str>,
    format: &str,
    ranges: &[&[Range]],
) -> Result<(), DocumentError> {
    format::expect(format, found)?;
    Ok(ranges::check(document, ranges)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Deserialize)]
    struct Plan {
        count: usize,
    }

    const RANGES: &[Range] = &[Range::whole("count", 1.0, 9.0)];

    #[test]
    fn syntax_format_ranges_and_types_are_judged_in_this_order() {
        let json = |text: &str| from_json::<Plan>(text, "wcal-plan/1", &[RANGES]);
        assert_eq!(
            json("{\"format\": \"wcal-plan/1\", \"count\": 3}"),
            Ok(Plan { count: 3 })
        );
        for (text, says) in [
            ("{", "EOF"),
            ("{\"count\": 1e9}", "`format`: expected"),
            (
                "{\"format\": \"wcal-plan/1\", \"count\": 1e9}",
                "count: expected",
            ),
            ("{\"format\": \"wcal-plan/1\"}", "missing field"),
        ] {
            let error = json(text).unwrap_err().to_string();
            assert!(error.contains(says), "{says}: {error}");
        }
        let toml = |text: &str| from_toml::<Plan>(text, "wcal-plan/1", &[RANGES]);
        assert_eq!(
            toml("format = \"wcal-plan/1\"\ncount = 3"),
            Ok(Plan { count: 3 })
        );
        let long = format!(
            "format = \"wcal-plan/1\"\ncount = \"{}\"",
            "x".repeat(100_000)
        );
        let error = toml(&long).unwrap_err().to_string();
        assert!(
            error.starts_with("count: ")
                && error.ends_with("at line 2")
                && error.len() < 400
                && !error.contains('\n'),
            "{error}"
        );
        let error = json(&format!(
            "{{\"format\": \"wcal-plan/1\",\n\"count\": \"{}\"}}",
            "x".repeat(100_000)
        ));
        let error = error.unwrap_err().to_string();
        assert!(error.contains("line 2") && error.len() < 400, "{error}");
        assert!(
            toml("format = \"wcal-plan/1\"\ncount = inf")
                .unwrap_err()
                .to_string()
                .contains("count")
        );
        assert!(
            toml("format = \"wcal-plan/2\"\ncount = 3")
                .unwrap_err()
                .to_string()
                .contains("update wcal")
        );
    }
}
