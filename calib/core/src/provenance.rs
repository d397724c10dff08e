//! Where a result came from: files by hash, program, command, seed.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// A file that was read, by content hash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct InputFile {
    /// Path as given, relative to the session where it belongs to one.
    pub path: String,
    /// SHA-256 of the content, lower-case hex.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub sha256: String,
    /// What it is read for; absent: `description`.
    #[serde(default, skip_serializing_if = "Purpose::is_description")]
    pub purpose: Purpose,
}

/// What a file is read for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Purpose {
    /// Describing the session.
    #[default]
    Description,
    /// Readings that are fitted.
    Fit,
    /// Held out: no fit sees it.
    Holdout,
}

impl Purpose {
    /// No readings.
    fn is_description(&self) -> bool {
        *self == Self::Description
    }
}

/// Program and command that made an artefact.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// Program and version, e.g. `wcal 0.1.0`.
    pub program: String,
    /// Command line.
    pub command: Vec<String>,
    /// Time of creation, RFC 3339, UTC.
    pub created: String,
    /// Seed of every random draw.
    pub seed: u64,
    /// Files read.
    pub inputs: Vec<InputFile>,
    /// What was read is simulated, not measured; absent in files from before the mark, which keep
    /// their hash.
    #[serde(default, skip_serializing_if = "is_measured")]
    pub simulated: bool,
}

/// For the documents that carry the mark only where it holds.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde asks for a reference"
)]
pub(crate) fn is_measured(simulated: &bool) -> bool {
    !simulated
}

/// SHA-256 of `bytes`, lower-case hex.
pub fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect()
}

/// JSON without spaces and with the keys of every object sorted: equal content is equal text, and
/// so has one hash.
pub fn canonical_json(value: &serde_json::Value) -> String {
    use serde_json::Value;
    match value {
        Value::Array(items) => {
            let items: Vec<String> = items.iter().map(canonical_json).collect();
            format!("[{}]", items.join(","))
        }
        Value::Object(map) => {
            let mut entries: Vec<(&String, &Value)> = map.iter().collect();
            entries.sort_by_key(|(key, _)| *key);
            let entries: Vec<String> = entries
                .into_iter()
                .map(|(key, value)| {
                    format!("{}:{}", Value::from(key.as_str()), canonical_json(value))
                })
                .collect();
            format!("{{{}}}", entries.join(","))
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::{Provenance, canonical_json, sha256_hex};

    #[test]
    fn canonical_json_depends_on_content_alone() {
        let read = |text: &str| canonical_json(&serde_json::from_str(text).unwrap());
        let text = r#"{"a":[1,{"x":"y","z":null}],"b":2.5}"#;
        assert_eq!(read(text), text);
        assert_eq!(
            read("{ \"b\": 2.5, \"a\": [1, {\"z\": null, \"x\": \"y\"}] }"),
            text
        );
        assert_ne!(read(r#"{"a":[{"x":"y","z":null},1],"b":2.5}"#), text);
    }

    #[test]
    fn the_mark_of_simulated_data_is_kept_and_older_files_stay_as_they_were() {
        let measured = serde_json::to_value(Provenance::default()).unwrap();
        assert!(measured.get("simulated").is_none(), "{measured}");
        assert!(
            !serde_json::from_value::<Provenance>(measured)
                .unwrap()
                .simulated
        );
        let marked = Provenance {
            simulated: true,
            ..Provenance::default()
        };
        let again: Provenance =
            serde_json::from_value(serde_json::to_value(&marked).unwrap()).unwrap();
        assert_eq!(again, marked);
    }

    #[test]
    fn hash_of_abc_is_the_one_of_fips_180() {
        assert_eq!(
            sha256_hex(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }
}
