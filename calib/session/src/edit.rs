//! Entries of a session.toml that are added after it was recorded: the rest of the file stays as it
//! is, comments and order included.

use crate::error::{InputError, SessionError, quote};
use std::path::Path;
use toml_edit::{DocumentMut, TomlError, table, value};
use wcal_core::files::write_atomic;

/// Sets texts of `session.toml` by table and key, e.g. `("files", "shapes", "shapes.json")`, in one
/// step.
///
/// # Errors
/// Where the file cannot be read or written, is no TOML, or has something else where a table must
/// be.
pub fn set_entries(folder: &Path, entries: &[(&str, &str, &str)]) -> Result<(), SessionError> {
    let path = folder.join("session.toml");
    let text = wcal_core::files::read_text(&path).map_err(SessionError::reading)?;
    let wrong = |e: TomlError| InputError::new("session.toml", "TOML", e.message().to_owned());
    let mut content: DocumentMut = text.parse().map_err(wrong)?;
    for (name, key, entry) in entries {
        let held = content.entry(name).or_insert_with(table);
        let found = quote(held.to_string().trim());
        let Some(held) = held.as_table_like_mut() else {
            return Err(
                InputError::new("session.toml", format!("a table [{name}]"), found)
                    .field(*name)
                    .into(),
            );
        };
        held.insert(key, value(*entry));
    }
    // By a side file: a session.toml that is cut off in the middle loses the session.
    Ok(write_atomic(&path, content.to_string().as_bytes())?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::*;

    #[test]
    fn entries_are_set_and_the_rest_stays_to_the_letter() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("session.toml");
        let before = "# by hand\nid = \"a\" # kept\n[files]\npoints   = \"points.csv\"\n\n[whisker]\ndiameter_mm = 0.30\n";
        std::fs::write(&path, before).unwrap();
        let entries = [
            ("files", "shapes", "shapes.json"),
            ("provenance", "cameras_sha256", "12"),
        ];
        set_entries(place.path(), &entries).unwrap();
        let after = std::fs::read_to_string(&path).unwrap();
        for line in before.lines() {
            assert!(after.contains(line), "{after}");
        }
        let table: toml::Table = after.parse().unwrap();
        assert_eq!(table["files"]["shapes"].as_str(), Some("shapes.json"));
        assert_eq!(table["files"]["points"].as_str(), Some("points.csv"));
        assert_eq!(table["provenance"]["cameras_sha256"].as_str(), Some("12"));
        // Again: replaced, not added.
        set_entries(place.path(), &[("files", "shapes", "other.json")]).unwrap();
        let again = std::fs::read_to_string(&path).unwrap();
        assert_eq!(again, after.replace("shapes.json", "other.json"));
        // Whichever way the tables are written.
        for text in [
            "id = \"a\"\nfiles = { points = \"points.csv\" }\n",
            "id = \"a\"\nfiles.points = \"points.csv\"\n",
            "id = \"a\"\n[ files ]\npoints = \"points.csv\"\n",
            "[files]\npoints = \"points.csv\"\nlist = [\n  1,\n  2 ]\n[files.more]\nx = \"\"\"\n[files]\n\"\"\"\n",
        ] {
            std::fs::write(&path, text).unwrap();
            let mut expected: toml::Table = text.parse().unwrap();
            expected["files"]
                .as_table_mut()
                .unwrap()
                .insert("shapes".into(), "shapes.json".into());
            set_entries(place.path(), &[("files", "shapes", "shapes.json")]).unwrap();
            let found: toml::Table = std::fs::read_to_string(&path).unwrap().parse().unwrap();
            assert_eq!(found, expected, "{text}");
        }
    }

    #[test]
    fn what_is_no_session_is_refused_and_stays() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("session.toml");
        let entry = [("files", "shapes", "shapes.json")];
        assert!(
            set_entries(place.path(), &entry)
                .unwrap_err()
                .to_string()
                .contains("session.toml")
        );
        for bad in ["files = 3\n", "[files\n", "files = \"x\"\n"] {
            std::fs::write(&path, bad).unwrap();
            let error = set_entries(place.path(), &entry).unwrap_err().to_string();
            assert!(
                error.contains("session.toml") && error.contains("expected"),
                "{error}"
            );
            assert_eq!(std::fs::read_to_string(&path).unwrap(), bad);
        }
    }
}
