//! Documents as they are read: syntax, format and version, the range of every number, and only then the type.

use crate::format::{self, FormatMismatch};
use crate::ranges::{self, Numbers, OutOfRange, Range};
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

impl DocumentError {
    fn content(found: &impl ToString) -> Self {
        Self::Content(found.to_string().trim().to_owned())
    }
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
    let value: serde_json::Value = serde_json::from_str(text).map_err(|e| DocumentError::content(&e))?;
    checked(&value, value["format"].as_str(), format, ranges)?;
    // From the text once more: errors of keys and types then name the line.
    serde_json::from_str(text).map_err(|e| DocumentError::content(&e))
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
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| DocumentError::content(&e))?;
    checked(&table, table.get("format").and_then(toml::Value::as_str), format, ranges)?;
    toml::from_str(text).map_err(|e| DocumentError::content(&e))
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
        assert_eq!(json("{\"format\": \"wcal-plan/1\", \"count\": 3}"), Ok(Plan { count: 3 }));
        for (text, says) in [
            ("{", "EOF"),
            ("{\"count\": 1e9}", "`format`: expected"),
            ("{\"format\": \"wcal-plan/1\", \"count\": 1e9}", "count: expected"),
            ("{\"format\": \"wcal-plan/1\"}", "missing field"),
        ] {
            let error = json(text).unwrap_err().to_string();
            assert!(error.contains(says), "{says}: {error}");
        }
        let toml = |text: &str| from_toml::<Plan>(text, "wcal-plan/1", &[RANGES]);
        assert_eq!(toml("format = \"wcal-plan/1\"\ncount = 3"), Ok(Plan { count: 3 }));
        assert!(toml("format = \"wcal-plan/1\"\ncount = inf").unwrap_err().to_string().contains("count"));
        assert!(toml("format = \"wcal-plan/2\"\ncount = 3").unwrap_err().to_string().contains("update wcal"));
    }
}
