//! Entries of a session.toml that are added after it was recorded: the rest of the file stays as it is, comments and order included.

use crate::error::{InputError, SessionError, quote};
use std::path::Path;
use toml::{Table, Value};
use wcal_core::files::write_atomic;

/// Sets texts of `session.toml` by table and key, e.g. `("files", "shapes", "shapes.json")`, in one step.
///
/// # Errors
/// Where the file cannot be read or written, is no TOML, or has something else where a table must be.
pub fn set_entries(folder: &Path, entries: &[(&str, &str, &str)]) -> Result<(), SessionError> {
    let path = folder.join("session.toml");
    let io = |e| SessionError::io("reading", &path, e);
    let mut text = wcal_core::files::read_text(&path).map_err(io)?;
    let wrong = |e: toml::de::Error| InputError::new("session.toml", "TOML", e.message().to_owned());
    let mut content: Table = text.parse().map_err(wrong)?;
    for (table, key, value) in entries {
        let held = content.entry(*table).or_insert_with(|| Value::Table(Table::new()));
        let Some(held) = held.as_table_mut() else {
            let found = quote(&held.to_string());
            return Err(InputError::new("session.toml", format!("a table [{table}]"), found)
                .field(*table)
                .into());
        };
        held.insert((*key).to_owned(), Value::String((*value).to_owned()));
        text = with_line(&text, table, key, value);
    }
    // Tables can be written in many ways: where a new line did not say what it should, the whole file is written anew.
    if text.parse::<Table>().ok().as_ref() != Some(&content) {
        text = toml::to_string(&content)
            .map_err(|e| InputError::new("session.toml", "content that TOML can hold", e.to_string()))?;
    }
    Ok(write_atomic(&path, text.as_bytes())?)
}

/// The text with `key = "value"` in `[table]`: in place of an earlier line, or at the end of the table.
fn with_line(text: &str, table: &str, key: &str, value: &str) -> String {
    let line = format!("{key} = {}", Value::String(value.to_owned()));
    let mut lines: Vec<&str> = text.lines().collect();
    let head = format!("[{table}]");
    let Some(begin) = lines.iter().position(|l| l.trim() == head) else {
        return format!("{}\n\n{head}\n{line}\n", text.trim_end());
    };
    let end =
        (begin + 1..lines.len()).find(|k| lines[*k].trim_start().starts_with('[')).unwrap_or(lines.len());
    let sets = |l: &str| l.split_once('=').is_some_and(|(name, _)| name.trim() == key);
    match (begin + 1..end).find(|k| sets(lines[*k])) {
        Some(k) => lines[k] = &line,
        None => {
            let last = (begin..end).rfind(|k| !lines[*k].trim().is_empty()).unwrap_or(begin);
            lines.insert(last + 1, &line);
        }
    }
    lines.join("\n") + "\n"
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
        let entries = [("files", "shapes", "shapes.json"), ("provenance", "cameras_sha256", "12")];
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
        // Inline, dotted and many-line ways of writing lose their layout, never content.
        for text in [
            "id = \"a\"\nfiles = { points = \"points.csv\" }\n",
            "id = \"a\"\nfiles.points = \"points.csv\"\n",
            "id = \"a\"\n[ files ]\npoints = \"points.csv\"\n",
            "[files]\npoints = \"points.csv\"\nlist = [\n  1,\n  2 ]\n[files.more]\nx = \"\"\"\n[files]\n\"\"\"\n",
        ] {
            std::fs::write(&path, text).unwrap();
            let mut expected: toml::Table = text.parse().unwrap();
            expected["files"].as_table_mut().unwrap().insert("shapes".into(), "shapes.json".into());
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
        assert!(set_entries(place.path(), &entry).unwrap_err().to_string().contains("session.toml"));
        for bad in ["files = 3\n", "[files\n", "files = \"x\"\n"] {
            std::fs::write(&path, bad).unwrap();
            let error = set_entries(place.path(), &entry).unwrap_err().to_string();
            assert!(error.contains("session.toml") && error.contains("expected"), "{error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), bad);
        }
    }
}
