//! Formats and their versions: `wcal-plan/1`. A document of another version may mean something else by the same key.

/// Holds the `format` of a document against the one that is read.
///
/// # Errors
/// What was expected and found; for a newer version of the same format, that a newer wcal reads it.
pub fn expect(expected: &str, found: Option<&str>) -> Result<(), String> {
    let Some(found) = found else {
        return Err(format!("field `format`: expected {expected:?}, found nothing"));
    };
    if found == expected {
        return Ok(());
    }
    let hint = if is_newer(expected, found) { " (a newer version: update wcal to read it)" } else { "" };
    let shown: String = found.chars().take(60).collect();
    Err(format!("field `format`: expected {expected:?}, found {shown:?}{hint}"))
}

/// Whether `found` is a later version of the format.
#[must_use]
pub fn is_newer(expected: &str, found: &str) -> bool {
    let version = |format: &str| -> Option<(String, u32)> {
        let (name, version) = format.rsplit_once('/')?;
        Some((name.to_owned(), version.parse().ok()?))
    };
    version(expected).zip(version(found)).is_some_and(|(a, b)| a.0 == b.0 && b.1 > a.1)
}

#[cfg(test)]
mod tests {
    use super::expect;

    #[test]
    fn another_format_or_version_is_refused_and_a_newer_one_named() {
        assert_eq!(expect("wcal-plan/1", Some("wcal-plan/1")), Ok(()));
        let says = |found| expect("wcal-plan/1", found).unwrap_err();
        assert!(says(Some("wcal-plan/9")).contains("update wcal"));
        for other in [None, Some("wcal-plan/0"), Some("wcal-rig/9"), Some("wcal-plan/1 "), Some("")] {
            let error = says(other);
            assert!(error.contains("expected \"wcal-plan/1\"") && !error.contains("update"), "{error}");
        }
    }
}
