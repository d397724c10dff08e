//! The part of JSON Schema (draft 2020-12) that `docs/schemas` uses. A keyword that is not among
//! these is an error of the schema, so that nothing a schema says goes unchecked. A crate for all
//! of JSON Schema would bring 25 more and build the numerics anew with other features.

use serde_json::Value;

/// Keywords that say nothing of a document.
const REMARKS: [&str; 6] = ["$schema", "$id", "$defs", "title", "description", "$ref"];
/// The one pattern that is used: a SHA-256.
const SHA256: &str = "^[0-9a-f]{64}$";

/// What of a schema is none: keywords, types and patterns that are not known here, references that
/// lead nowhere.
pub(crate) fn faults(schema: &Value) -> Vec<String> {
    let mut out = Vec::new();
    in_schema(schema, schema, "", &mut out);
    out
}

fn in_schema(schema: &Value, root: &Value, at: &str, out: &mut Vec<String>) {
    let Some(keywords) = schema.as_object() else {
        // Leave for further keys, or none.
        if !schema.is_boolean() {
            out.push(format!("{at}: expected a schema, found {schema}"));
        }
        return;
    };
    for (key, value) in keywords {
        let at = format!("{at}/{key}");
        let known = match key.as_str() {
            "properties" | "$defs" => {
                let all = value.as_object();
                all.into_iter()
                    .flatten()
                    .for_each(|(name, s)| in_schema(s, root, &format!("{at}/{name}"), out));
                all.is_some()
            }
            "items" | "additionalProperties" => {
                in_schema(value, root, &at, out);
                true
            }
            "anyOf" | "oneOf" => {
                let all = value.as_array().filter(|a| !a.is_empty());
                all.into_iter()
                    .flatten()
                    .for_each(|s| in_schema(s, root, &at, out));
                all.is_some()
            }
            "$ref" => value.as_str().and_then(|r| referred(root, r)).is_some(),
            "type" => types(value).is_some_and(|all| {
                all.iter().all(|t| {
                    [
                        "object", "array", "string", "number", "integer", "boolean", "null",
                    ]
                    .contains(t)
                })
            }),
            "required" | "enum" => value.as_array().is_some_and(|a| !a.is_empty()),
            "const" => true,
            "pattern" => value == SHA256,
            "minimum" | "maximum" | "exclusiveMinimum" => value.is_number(),
            "minItems" | "maxItems" | "minProperties" | "maxProperties" => value.is_u64(),
            "prefixItems" => {
                let all = value.as_array();
                all.into_iter()
                    .flatten()
                    .for_each(|s| in_schema(s, root, &at, out));
                all.is_some()
            }
            other => REMARKS.contains(&other),
        };
        if !known {
            out.push(format!("{at}: {value}"));
        }
    }
}

/// What in a document is not as its schema says, by place.
pub(crate) fn errors(schema: &Value, document: &Value) -> Vec<String> {
    let mut out = Vec::new();
    in_value(schema, schema, document, "", &mut out);
    out
}

fn in_value(schema: &Value, root: &Value, value: &Value, at: &str, out: &mut Vec<String>) {
    let Some(keywords) = schema.as_object() else {
        if schema == &Value::Bool(false) {
            out.push(format!("{at}: a key that the schema does not have"));
        }
        return;
    };
    for (key, says) in keywords {
        let holds = match key.as_str() {
            "$ref" => {
                let other = says.as_str().and_then(|r| referred(root, r));
                other
                    .into_iter()
                    .for_each(|s| in_value(s, root, value, at, out));
                other.is_some()
            }
            "type" => types(says).is_some_and(|all| all.iter().any(|t| is(value, t))),
            "const" => same(value, says),
            "enum" => says
                .as_array()
                .is_some_and(|all| all.iter().any(|one| same(value, one))),
            "pattern" => value.as_str().is_none_or(is_sha256),
            "minimum" => number(value, says).is_none_or(|(v, limit)| v >= limit),
            "maximum" => number(value, says).is_none_or(|(v, limit)| v <= limit),
            "exclusiveMinimum" => number(value, says).is_none_or(|(v, limit)| v > limit),
            "minItems" => value
                .as_array()
                .is_none_or(|a| a.len() as u64 >= count(says)),
            "maxItems" => value
                .as_array()
                .is_none_or(|a| a.len() as u64 <= count(says)),
            "minProperties" => value
                .as_object()
                .is_none_or(|o| o.len() as u64 >= count(says)),
            "maxProperties" => value
                .as_object()
                .is_none_or(|o| o.len() as u64 <= count(says)),
            "required" => value.as_object().is_none_or(|o| {
                says.as_array()
                    .into_iter()
                    .flatten()
                    .all(|k| k.as_str().is_some_and(|k| o.contains_key(k)))
            }),
            "prefixItems" => {
                let pairs = value
                    .as_array()
                    .into_iter()
                    .flatten()
                    .zip(says.as_array().into_iter().flatten());
                pairs
                    .enumerate()
                    .for_each(|(k, (v, s))| in_value(s, root, v, &format!("{at}/{k}"), out));
                true
            }
            "items" => {
                for (k, item) in value.as_array().into_iter().flatten().enumerate() {
                    in_value(says, root, item, &format!("{at}/{k}"), out);
                }
                true
            }
            "properties" | "additionalProperties" => {
                for (name, inner) in value.as_object().into_iter().flatten() {
                    let own = schema.get("properties").and_then(|all| all.get(name));
                    let rule = if key == "properties" {
                        own
                    } else {
                        own.is_none().then_some(says)
                    };
                    rule.into_iter()
                        .for_each(|s| in_value(s, root, inner, &format!("{at}/{name}"), out));
                }
                true
            }
            "anyOf" | "oneOf" => {
                let fits = |s: &&Value| {
                    let mut inner = Vec::new();
                    in_value(s, root, value, at, &mut inner);
                    inner.is_empty()
                };
                let hold = says.as_array().into_iter().flatten().filter(fits).count();
                if key == "oneOf" { hold == 1 } else { hold > 0 }
            }
            _ => true,
        };
        if !holds {
            out.push(format!(
                "{at}: {key}: expected {says}, found {}",
                short(value)
            ));
        }
    }
}

fn referred<'a>(root: &'a Value, reference: &str) -> Option<&'a Value> {
    root.pointer(reference.strip_prefix('#')?)
}

fn types(says: &Value) -> Option<Vec<&str>> {
    match says {
        Value::String(one) => Some(vec![one]),
        Value::Array(all) => all.iter().map(Value::as_str).collect(),
        _ => None,
    }
}

fn is(value: &Value, name: &str) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|v| v.fract() == 0.0),
        "boolean" => value.is_boolean(),
        _ => value.is_null(),
    }
}

/// 1 and 1.0 are the same number.
fn same(a: &Value, b: &Value) -> bool {
    a == b || a.as_f64().is_some_and(|x| b.as_f64() == Some(x))
}

fn number(value: &Value, limit: &Value) -> Option<(f64, f64)> {
    Some((value.as_f64()?, limit.as_f64()?))
}

fn count(says: &Value) -> u64 {
    says.as_u64().unwrap_or_default()
}

fn is_sha256(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

fn short(value: &Value) -> String {
    let text = value.to_string();
    text.char_indices()
        .nth(80)
        .map_or(text.clone(), |(end, _)| format!("{}...", &text[..end]))
}
