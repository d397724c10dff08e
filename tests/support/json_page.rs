//! The page of the JSON documents: a table a schema, a table a shared part.

use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;

const HEAD: &str = "# JSON documents\n\n\
    Every JSON document that the program writes, key by key. The page and the schemas in `docs/schemas` (JSON Schema, draft 2020-12) are made from\n\
    the types that write the documents, and a test holds real outputs against them. Keys may be added, so a reader must take further ones. Where a\n\
    key may be absent, the table says so; units are in the names.\n";

/// Files first, then what `--json` prints.
const ORDER: [&str; 22] = [
    "verify",
    "calibration",
    "fit-gpr",
    "unsealed",
    "run",
    "stereo",
    "shapes",
    "dataset",
    "shard",
    "recipe",
    "submission",
    "model",
    "evaluation",
    "track",
    "bench",
    "import",
    "check",
    "predict",
    "path",
    "sweep",
    "live",
    "reduction",
];

/// The page; schemas that `ORDER` lacks come last.
pub(crate) fn render(schemas: &BTreeMap<String, Value>) -> String {
    let mut out = HEAD.to_owned();
    let further = schemas
        .keys()
        .map(String::as_str)
        .filter(|n| !ORDER.contains(n));
    for name in ORDER
        .into_iter()
        .filter(|n| schemas.contains_key(*n))
        .chain(further)
    {
        let schema = &schemas[name];
        let text = |key: &str| schema[key].as_str().unwrap_or_default();
        let format = schema["properties"]["format"]["const"].as_str();
        let format = format.map_or_else(String::new, |f| format!(" Format `{f}`."));
        let _ = write!(
            out,
            "\n## {}\n\n{}{format} Schema: `docs/schemas/{name}.json`.\n",
            text("title"),
            text("description")
        );
        table(schema, &mut out);
        for (part, shared) in schema["$defs"].as_object().into_iter().flatten() {
            let about = shared["description"].as_str().unwrap_or_default();
            let _ = write!(out, "\n*{part}*: {about}\n");
            table(shared, &mut out);
        }
    }
    out
}

/// What a schema holds, a line a key; each of several variants by itself.
fn table(schema: &Value, out: &mut String) {
    let mut lines = Vec::new();
    rows("", schema, &mut lines);
    if !lines.is_empty() {
        out.push_str("\n| key | value | meaning |\n|---|---|---|\n");
        lines.iter().for_each(|line| out.push_str(line));
    }
    let variants = alternatives(schema);
    let words: Vec<&Value> = variants
        .iter()
        .copied()
        .filter(|v| v.get("properties").is_none())
        .collect();
    if !words.is_empty() {
        out.push_str("\n| value | meaning |\n|---|---|\n");
        for word in &words {
            let _ = writeln!(out, "| {} | {} |", kind(word), about(word));
        }
    }
    for variant in variants.iter().filter(|v| v.get("properties").is_some()) {
        let _ = write!(out, "\n{}\n", or(&about(variant), "Or:"));
        table(variant, out);
    }
    if lines.is_empty() && variants.is_empty() {
        let _ = write!(out, "\n{}\n", kind(schema));
    }
}

fn alternatives(schema: &Value) -> Vec<&Value> {
    ["anyOf", "oneOf"]
        .iter()
        .flat_map(|key| schema[*key].as_array().into_iter().flatten())
        .collect()
}

fn about(schema: &Value) -> String {
    schema["description"]
        .as_str()
        .unwrap_or_default()
        .replace('|', "\\|")
}

fn or<'a>(text: &'a str, other: &'a str) -> &'a str {
    if text.is_empty() { other } else { text }
}

fn rows(prefix: &str, schema: &Value, out: &mut Vec<String>) {
    let required: Vec<&str> = schema["required"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .collect();
    for (key, value) in schema["properties"].as_object().into_iter().flatten() {
        let absent = if required.contains(&key.as_str()) {
            ""
        } else {
            " May be absent."
        };
        out.push(format!(
            "| `{prefix}{key}` | {} | {}{absent} |\n",
            kind(value),
            about(value)
        ));
        inside(&format!("{prefix}{key}"), value, out);
    }
}

/// Keys inside lists, maps and alternatives.
fn inside(path: &str, value: &Value, out: &mut Vec<String>) {
    rows(&format!("{path}."), value, out);
    if value["items"].is_object() {
        inside(&format!("{path}[]"), &value["items"], out);
    }
    if value["additionalProperties"].is_object() {
        inside(&format!("{path}.NAME"), &value["additionalProperties"], out);
    }
    alternatives(value)
        .into_iter()
        .for_each(|one| inside(path, one, out));
}

/// What a value is, in words.
fn kind(value: &Value) -> String {
    if let Some(part) = value["$ref"].as_str() {
        return format!("*{}*", part.rsplit('/').next().unwrap_or_default());
    }
    if let Some(fixed) = value.get("const") {
        return format!("`{}`", fixed.to_string().replace('"', ""));
    }
    let one = alternatives(value);
    if !one.is_empty() && value.get("type").is_none() {
        return one.into_iter().map(kind).collect::<Vec<_>>().join(" or ");
    }
    let types: Vec<&str> = match &value["type"] {
        Value::Array(all) => all.iter().filter_map(Value::as_str).collect(),
        other => other.as_str().into_iter().collect(),
    };
    let words: Vec<String> = types.iter().map(|t| word(t, value)).collect();
    if words.is_empty() {
        "any".to_owned()
    } else {
        words.join(" or ")
    }
}

fn word(name: &str, value: &Value) -> String {
    match name {
        "string" if value["enum"].is_array() => {
            let all = value["enum"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(Value::as_str);
            all.map(|e| format!("`{e}`")).collect::<Vec<_>>().join(", ")
        }
        "string" => "text".to_owned(),
        "boolean" => "true or false".to_owned(),
        "array" if value["prefixItems"].is_array() => {
            let all = value["prefixItems"].as_array().into_iter().flatten();
            format!("list: {}", all.map(kind).collect::<Vec<_>>().join(", "))
        }
        "array" => {
            let count = match (value["minItems"].as_u64(), value["maxItems"].as_u64()) {
                (Some(least), Some(most)) if least == most => format!("{least} "),
                _ => String::new(),
            };
            format!("list of {count}{}", kind(&value["items"]))
        }
        "object" if value["additionalProperties"].is_object() => {
            format!("by name: {}", kind(&value["additionalProperties"]))
        }
        other => other.to_owned(),
    }
}
