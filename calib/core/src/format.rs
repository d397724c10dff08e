//! Formats and their versions: `wcal-plan/1`. A document of another version may mean something else
//! by the same key.

/// Another format or version than the one that is read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("field `format`: expected {expected:?}, found {found}")]
pub struct FormatMismatch {
    /// The one that is read.
    pub expected: String,
    /// What the document states, and whether a newer wcal reads it or an older one wrote it.
    pub found: String,
}

/// Holds the `format` of a document against the one that is read.
///
/// # Errors
/// What was expected and found.
pub fn expect(expected: &str, found: Option<&str>) -> Result<(), FormatMismatch> {
    if found == Some(expected) {
        return Ok(());
    }
    let hint = match found {
        Some(found) if is_newer(expected, found) => " (a newer version: update wcal to read it)",
        Some(found) if is_newer(found, expected) => {
            " (an older version, which this wcal no longer reads)"
        }
        _ => "",
    };
    let shown = |found: &str| format!("{:?}{hint}", found.chars().take(60).collect::<String>());
    let found = found.map_or_else(|| "nothing".to_owned(), shown);
    Err(FormatMismatch {
        expected: expected.to_owned(),
        found,
    })
}

/// Whether `found` is a later version of the format.
fn is_newer(expected: &str, found: &str) -> bool {
    let version = |format: &str| -> Option<(String, u32)> {
        let (name, version) = format.rsplit_once('/')?;
        Some((name.to_owned(), version.parse().ok()?))
    };
    version(expected)
        .zip(version(found))
        .is_some_and(|(a, b)| a.0 == b.0 && b.1 > a.1)
}

#[cfg(test)]
mod tests {
    use super::expect;

    #[test]
    fn another_format_or_version_is_refused_and_a_newer_one_named() {
        assert_eq!(expect("wcal-plan/1", Some("wcal-plan/1")), Ok(()));
        let says = |found| expect("wcal-plan/1", found).unwrap_err().to_string();
        assert!(says(Some("wcal-plan/9")).contains("update wcal"));
        assert!(says(Some("wcal-plan/0")).contains("an older version"));
        for other in [
            None,
            Some("wcal-plan/0"),
            Some("wcal-rig/9"),
            Some("wcal-plan/1 "),
            Some(""),
        ] {
            let error = says(other);
            assert!(
                error.contains("expected \"wcal-plan/1\"") && !error.contains("update"),
                "{error}"
            );
        }
    }
}
