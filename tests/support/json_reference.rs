//! Schemas of JSON documents from the types that write them (`docs/schemas`), and the page that is
//! made from these (`docs/src/json.md`).
//!
//! `WCAL_WRITE_DOCS=1 cargo test --workspace --lib schemas` writes both anew.

#[path = "json_page.rs"]
mod page;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Schema of what `T` writes. `title`: the file or command that the document is known by.
pub(crate) fn schema<T: JsonSchema>(name: &str, title: &str) -> (String, Value) {
    let generator = SchemaSettings::draft2020_12()
        .for_serialize()
        .into_generator();
    let mut schema = generator.into_root_schema_for::<T>().to_value();
    let parts = schema["$defs"].clone();
    plain(&mut schema, &parts);
    drop_unused(&mut schema);
    schema["$id"] = json!(format!("https://example.invalid/wcal/schemas/{name}.json"));
    schema["title"] = title.into();
    (name.to_owned(), schema)
}

/// Leaves what a reader in any language needs: no widths of numbers, no defaults, descriptions on
/// one line without links into the code, and no reference beside further keys (a variant that is
/// told apart by a key).
fn plain(schema: &mut Value, parts: &Value) {
    match schema {
        Value::Object(map) => {
            if map.contains_key("properties") && map.contains_key("$ref") {
                merge_reference(map, parts);
            }
            for key in ["format", "default", "title"] {
                map.remove(key);
            }
            if let Some(Value::String(text)) = map.get_mut("description") {
                let words: Vec<&str> = text.split_whitespace().collect();
                *text = words.join(" ").replace("[`", "`").replace("`]", "`");
            }
            for (key, inner) in map.iter_mut() {
                match inner {
                    // Here keys are names, not keywords.
                    Value::Object(named) if ["properties", "$defs"].contains(&key.as_str()) => {
                        named.values_mut().for_each(|s| plain(s, parts));
                    }
                    inner if !["const", "enum", "required"].contains(&key.as_str()) => {
                        plain(inner, parts)
                    }
                    _ => {}
                }
            }
        }
        Value::Array(all) => all.iter_mut().for_each(|s| plain(s, parts)),
        _ => {}
    }
}

fn merge_reference(map: &mut Map<String, Value>, parts: &Value) {
    let name = map
        .remove("$ref")
        .and_then(|r| r.as_str().map(|r| r.rsplit('/').next().unwrap().to_owned()));
    let part = &parts[name.unwrap()];
    for (key, value) in part.as_object().unwrap() {
        match (key.as_str(), map.get_mut(key)) {
            ("properties", Some(Value::Object(own))) => {
                own.extend(value.as_object().unwrap().clone());
            }
            ("required", Some(Value::Array(own))) => own.extend(value.as_array().unwrap().clone()),
            (_, Some(_)) => {}
            (_, None) => drop(map.insert(key.clone(), value.clone())),
        }
    }
}

/// Parts that nothing refers to any more.
fn drop_unused(schema: &mut Value) {
    loop {
        let text = schema.to_string();
        let Some(parts) = schema.get_mut("$defs").and_then(Value::as_object_mut) else {
            return;
        };
        let before = parts.len();
        parts.retain(|name, _| text.contains(&format!("\"#/$defs/{name}\"")));
        if parts.len() == before {
            return;
        }
    }
}

/// Holds the committed schemas of `own` and the page against the types. The folder's other schemas
/// are another program's, whose test holds them; `tests/contracts/schemas.rs` holds all against
/// documents that the programs write.
pub(crate) fn hold(repository: &Path, own: Vec<(String, Value)>) {
    let folder = repository.join("docs/schemas");
    let read = |path: &Path| std::fs::read_to_string(path).unwrap_or_default();
    let mut all: BTreeMap<String, Value> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            (name, serde_json::from_str(&read(&path)).unwrap())
        })
        .collect();
    let mut texts: Vec<(PathBuf, String)> = own
        .iter()
        .map(|(name, schema)| {
            (
                folder.join(format!("{name}.json")),
                serde_json::to_string_pretty(schema).unwrap() + "\n",
            )
        })
        .collect();
    all.extend(own);
    texts.push((repository.join("docs/src/json.md"), page::render(&all)));
    for (path, text) in texts {
        if std::env::var_os("WCAL_WRITE_DOCS").is_some() {
            std::fs::write(&path, &text).unwrap();
        }
        assert!(
            read(&path) == text,
            "{} is not what the types say: see json_reference.rs",
            path.display()
        );
    }
    // A key more is a line more, and each is said what it is.
    let mut more = all.clone();
    more.get_mut("run").unwrap()["properties"]["weather"] =
        json!({"type": "string", "description": "Rain."});
    assert!(
        page::render(&more).contains("| `weather` |") && !page::render(&all).contains("weather")
    );
    let silent: Vec<String> = all
        .iter()
        .flat_map(|(name, schema)| undescribed(name, schema))
        .collect();
    assert!(
        silent.is_empty(),
        "keys without a doc comment: {}",
        silent.join(", ")
    );
    more.get_mut("run").unwrap()["properties"]["weather"] = json!({"type": "string"});
    assert_eq!(
        undescribed("run", &more["run"]),
        ["run.weather"],
        "negative control"
    );
}

/// Keys that say nothing of themselves.
fn undescribed(place: &str, schema: &Value) -> Vec<String> {
    let mut out = Vec::new();
    match schema {
        Value::Object(map) => {
            for (key, inner) in map {
                let Value::Object(named) = inner else {
                    out.extend(undescribed(place, inner));
                    continue;
                };
                if key == "properties" {
                    // A key that tells variants apart is described by its variant.
                    let variant = named.len() == 1 && map.contains_key("description");
                    for (name, s) in named {
                        let at = format!("{place}.{name}");
                        if s.get("description").is_none() && s.get("const").is_none() && !variant {
                            out.push(at.clone());
                        }
                        out.extend(undescribed(&at, s));
                    }
                } else {
                    out.extend(undescribed(place, inner));
                }
            }
        }
        Value::Array(all) => out.extend(all.iter().flat_map(|s| undescribed(place, s))),
        _ => {}
    }
    out
}
