//! Every JSON document that the program writes, held against `docs/schemas`; tables against the
//! columns of `docs/src/formats.md`.
//!
//! The schemas are open, as a reader should be: keys may be added. Here they are closed, so that
//! the program writes no key that they lack. They are made from the types that write the documents,
//! and so is `docs/src/json.md` (`tests/support/json_reference.rs`).

mod validator;
mod written;

use crate::support::repository;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use validator::{errors, faults};

/// Schemas whose documents are not written here, and why; a document by hand stands for them below.
const BY_HAND: [(&str, &str); 1] = [("submission", "needs Slurm: slurm_program")];

/// The schemas by name.
fn schemas() -> BTreeMap<String, Value> {
    let files = std::fs::read_dir(repository("docs/schemas"))
        .unwrap()
        .map(|e| e.unwrap().path());
    let of = |path: PathBuf| {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        (
            name,
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap(),
        )
    };
    files.map(of).collect()
}

/// The same without leave for further keys.
fn closed(schema: &Value) -> Value {
    match schema {
        Value::Object(map) => {
            let mut map: serde_json::Map<String, Value> = map
                .iter()
                .map(|(key, value)| (key.clone(), closed(value)))
                .collect();
            if map.get("properties").is_some_and(Value::is_object)
                && !map.contains_key("additionalProperties")
            {
                map.insert("additionalProperties".to_owned(), false.into());
            }
            Value::Object(map)
        }
        Value::Array(items) => items.iter().map(closed).collect(),
        other => other.clone(),
    }
}

/// A value that is none of what stands there: a number for what holds others, an empty object for
/// the rest.
fn other_type(value: &Value) -> Value {
    if value.is_object() || value.is_array() {
        7.into()
    } else {
        json!({})
    }
}

/// Changes that a reader must refuse, by name.
fn spoiled(schema: &Value, document: &Value) -> Vec<(String, Value)> {
    let mut all = Vec::new();
    let mut spoil = |what: String, change: &dyn Fn(&mut serde_json::Map<String, Value>)| {
        let mut copy = document.clone();
        change(copy.as_object_mut().unwrap());
        all.push((what, copy));
    };
    let required = schema["required"]
        .as_array()
        .unwrap()
        .iter()
        .map(|r| r.as_str().unwrap());
    for key in required {
        spoil(format!("without {key}"), &|d| drop(d.remove(key)));
        // A wire is described in more than one way: any value will do.
        if schema["properties"][key].get("type").is_some()
            || schema["properties"][key].get("const").is_some()
        {
            spoil(format!("{key} of another type"), &|d| {
                drop(d.insert(key.to_owned(), other_type(&d[key])))
            });
        }
    }
    if let Some(format) = document["format"].as_str() {
        let (name, _) = format.rsplit_once('/').unwrap();
        spoil("an unknown version".to_owned(), &|d| {
            drop(d.insert("format".into(), format!("{name}/99").into()))
        });
    }
    all
}

#[test]
fn the_schemas_are_schemas_and_name_their_format() {
    let all = schemas();
    assert!(all.len() > 10, "{}", all.len());
    for (name, schema) in &all {
        assert_eq!(faults(schema), Vec::<String>::new(), "{name}");
        assert_eq!(
            schema["$schema"], "https://json-schema.org/draft/2020-12/schema",
            "{name}"
        );
        assert!(
            closed(schema)
                .to_string()
                .contains("\"additionalProperties\":false"),
            "{name} is closed"
        );
    }
    let bad = json!({"type": "nothing", "properties": {"a": {"multipleOf": 2}, "b": {"$ref": "#/$defs/none"}}, "pattern": "x+"});
    assert_eq!(
        faults(&bad).len(),
        4,
        "negative control: {:?}",
        faults(&bad)
    );
}

/// Each rule of the validator on a value that keeps it and on one that does not.
#[test]
fn the_validator_holds_values_against_every_keyword() {
    let sha = "0".repeat(64);
    let rules = [
        (json!({"type": "integer"}), json!(2.0), json!(2.5)),
        (json!({"type": ["string", "null"]}), json!(null), json!(1)),
        (json!({"const": 1}), json!(1.0), json!("1")),
        (json!({"enum": ["a", "b"]}), json!("b"), json!("c")),
        (
            json!({"pattern": "^[0-9a-f]{64}$"}),
            json!(sha),
            json!(sha.replace('0', "G")),
        ),
        (json!({"minimum": 0}), json!(0), json!(-1)),
        (json!({"maximum": 1}), json!(1), json!(1.5)),
        (json!({"exclusiveMinimum": 0}), json!(0.1), json!(0)),
        (
            json!({"minItems": 2, "maxItems": 2}),
            json!([1, 2]),
            json!([1]),
        ),
        (
            json!({"minItems": 2, "maxItems": 2}),
            json!([1, 2]),
            json!([1, 2, 3]),
        ),
        (
            json!({"minProperties": 1, "maxProperties": 1}),
            json!({"a": 1}),
            json!({}),
        ),
        (
            json!({"minProperties": 1, "maxProperties": 1}),
            json!({"a": 1}),
            json!({"a": 1, "b": 2}),
        ),
        (
            json!({"required": ["a"]}),
            json!({"a": null}),
            json!({"b": 1}),
        ),
        (
            json!({"items": {"type": "number"}}),
            json!([1, 2.5]),
            json!([1, "2"]),
        ),
        (
            json!({"properties": {"a": {"type": "number"}}}),
            json!({"a": 1, "b": "c"}),
            json!({"a": "1"}),
        ),
        (
            json!({"additionalProperties": {"type": "number"}}),
            json!({"a": 1}),
            json!({"a": "1"}),
        ),
        (
            json!({"properties": {"a": {}}, "additionalProperties": false}),
            json!({"a": "1"}),
            json!({"b": 1}),
        ),
        (
            json!({"anyOf": [{"type": "null"}, {"type": "number"}]}),
            json!(1),
            json!("1"),
        ),
        (
            json!({"oneOf": [{"minimum": 1}, {"maximum": 3}]}),
            json!(4),
            json!(2),
        ),
        (
            json!({"$ref": "#/$defs/a", "$defs": {"a": {"type": "null"}}}),
            json!(null),
            json!(0),
        ),
    ];
    for (schema, good, bad) in rules {
        assert_eq!(faults(&schema), Vec::<String>::new(), "{schema}");
        assert_eq!(errors(&schema, &good), Vec::<String>::new(), "{schema}");
        assert_eq!(errors(&schema, &bad).len(), 1, "{schema} {bad}");
    }
}

/// Every table that was written with the documents.
fn columns_stand_in_the_reference(folder: &Path) {
    let reference = std::fs::read_to_string(repository("docs/src/formats.md")).unwrap();
    for (table, header) in written::tables(folder) {
        assert_eq!(unnamed(&header, &reference), Vec::<&str>::new(), "{table}");
    }
    assert_eq!(
        unnamed("point,shoe_size\n", &reference),
        ["shoe_size"],
        "negative control"
    );
}

#[test]
fn what_the_program_writes_is_as_schemas_and_reference_say() {
    let (all, folder) = (schemas(), written::folder());
    let documents = written::documents(folder.path());
    columns_stand_in_the_reference(folder.path());
    let mut wrong = Vec::new();
    for (name, from, document) in &documents {
        let found = errors(&closed(&all[*name]), document);
        wrong.extend(
            found
                .iter()
                .take(5)
                .map(|e| format!("{name} ({from}): {e}")),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let seen: BTreeSet<&str> = documents.iter().map(|d| d.0).collect();
    let expected: BTreeSet<&str> = all
        .keys()
        .map(String::as_str)
        .filter(|n| BY_HAND.iter().all(|(by_hand, _)| n != by_hand))
        .collect();
    assert_eq!(
        seen, expected,
        "every schema has a document that the program wrote"
    );

    // Negative controls, on one document of each schema.
    let by_hand = [(
        "submission",
        json!({"format": "wcal-slurm/1", "array_job": "7", "check_job": "8", "tasks": 3, "shards": 9}),
    )];
    let mut one: BTreeMap<&str, &Value> = documents.iter().map(|(name, _, d)| (*name, d)).collect();
    one.extend(by_hand.iter().map(|(name, d)| (*name, d)));
    for (name, document) in one {
        let schema = &all[name];
        assert_eq!(errors(schema, document), Vec::<String>::new(), "{name}");
        let spoiled = spoiled(schema, document);
        assert!(!spoiled.is_empty(), "{name}");
        for (what, copy) in spoiled {
            assert!(
                !errors(schema, &copy).is_empty(),
                "{name} {what} is not noticed"
            );
        }
        let mut further = document.clone();
        further["further"] = 1.into();
        assert!(
            errors(schema, &further).is_empty(),
            "{name}: a reader takes further keys"
        );
        assert!(
            !errors(&closed(schema), &further).is_empty(),
            "{name}: this test does not"
        );
    }
}

/// Columns that a reference does not name, as `column` in backticks.
fn unnamed<'a>(header: &'a str, reference: &str) -> Vec<&'a str> {
    header
        .trim()
        .split(',')
        .filter(|c| !reference.contains(&format!("`{c}`")))
        .collect()
}
