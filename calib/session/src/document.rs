//! `session.toml` as typed sections: what is wrong is named by its key, and keys that nobody knows
//! are remembered.

use crate::error::{InputError, not_utf8};
use nalgebra::Vector3;
use serde::de::DeserializeOwned;
use serde_path_to_error::{Deserializer, Path, Segment, Track};
use toml::Table;

/// Parses TOML; a syntax error names the line.
pub(crate) fn parse(file: &str, bytes: &[u8]) -> Result<Table, InputError> {
    let text = wcal_core::text::utf8(bytes).map_err(|other| not_utf8(file, bytes, other))?;
    text.parse::<Table>().map_err(|e| {
        let error = InputError::new(file, "valid TOML", e.message().to_owned());
        match e.span() {
            Some(span) => error.at(1 + text[..span.start.min(text.len())].matches('\n').count()),
            None => error,
        }
    })
}

/// The sections of a document; keys that they do not have are added to `unknown`.
pub(crate) fn sections<T: DeserializeOwned>(
    file: &str,
    table: &Table,
    unknown: &mut Vec<String>,
) -> Result<T, InputError> {
    let mut track = Track::new();
    let document = Deserializer::new(table.clone(), &mut track);
    // An optional table is a separate part in the path of a key.
    let note = |key: serde_ignored::Path<'_>| unknown.push(key.to_string().replace(".?", ""));
    let read: Result<T, toml::de::Error> = serde_ignored::deserialize(document, note);
    read.map_err(|e| of_serde(file, &track.path(), e.message()))
}

/// An error of a section by its key, as `trajectory #1.origin_mm`. Serde's sentences are "missing
/// field `KEY`" and "invalid type: FOUND, expected EXPECTED".
fn of_serde(file: &str, path: &Path, message: &str) -> InputError {
    let mut key = String::new();
    for segment in path.iter() {
        match segment {
            Segment::Seq { index } => key += &format!(" #{}", index + 1),
            Segment::Map { key: name } if key.is_empty() => key += name,
            Segment::Map { key: name } => key += &format!(".{name}"),
            Segment::Enum { .. } | Segment::Unknown => {}
        }
    }
    if let Some(name) = message
        .strip_prefix("missing field `")
        .and_then(|m| m.strip_suffix('`'))
    {
        let name = if key.is_empty() {
            name.to_owned()
        } else {
            format!("{key}.{name}")
        };
        return InputError::new(file, "a value", "nothing").field(name);
    }
    let (found, expected) = message
        .split_once(", expected ")
        .unwrap_or((message, "another value"));
    let found = found
        .split_once("invalid type: ")
        .map_or(found, |(_, found)| found);
    // Serde names types as Rust does; people read words.
    InputError::new(
        file,
        expected
            .replace("f64", "a number")
            .replace("a boolean", "true or false"),
        found,
    )
    .field(key)
}

/// A unit vector: exact to 1e-3, then normalised.
pub(crate) fn unit_vector(file: &str, key: &str, v: [f64; 3]) -> Result<Vector3<f64>, InputError> {
    const TOLERANCE: f64 = 1e-3;
    let v = Vector3::from(v);
    let length = v.norm();
    // NaN is no length, either.
    if (length - 1.0).abs() <= TOLERANCE {
        return Ok(v / length);
    }
    let found = format!("length {length:.6}");
    Err(InputError::new(file, "a vector of length 1 (within 0.001)", found).field(key))
}
