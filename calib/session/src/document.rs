//! Typed access to `session.toml` that names the key in every error and remembers which keys were understood.

use crate::error::{InputError, not_utf8, quote};
use nalgebra::Vector3;
use std::cell::RefCell;
use std::collections::BTreeSet;
use toml::{Table, Value};

/// One table of a TOML document.
pub(crate) struct Section<'a> {
    file: &'a str,
    path: String,
    table: &'a Table,
    known: RefCell<BTreeSet<String>>,
}

type Outcome<T> = Result<T, InputError>;

impl<'a> Section<'a> {
    /// The document's top level.
    pub(crate) fn root(file: &'a str, table: &'a Table) -> Self {
        Self { file, path: String::new(), table, known: RefCell::default() }
    }

    /// The document's name.
    pub(crate) fn file(&self) -> &str {
        self.file
    }

    fn name(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// An error of one key.
    pub(crate) fn error(
        &self,
        key: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> InputError {
        InputError::new(self.file, expected, found).field(self.name(key))
    }

    pub(crate) fn value(&self, key: &str) -> Option<&'a Value> {
        self.known.borrow_mut().insert(key.to_owned());
        self.table.get(key)
    }

    /// Keys that nobody asked for.
    pub(crate) fn unknown_keys(&self) -> Vec<String> {
        let known = self.known.borrow();
        self.table.keys().filter(|key| !known.contains(*key)).map(|key| self.name(key)).collect()
    }

    /// Sub-table, if present.
    pub(crate) fn section(&self, key: &str) -> Outcome<Option<Section<'a>>> {
        match self.value(key) {
            None => Ok(None),
            Some(Value::Table(table)) => {
                Ok(Some(Section { file: self.file, path: self.name(key), table, known: RefCell::default() }))
            }
            Some(other) => Err(self.error(key, "a table", describe(other))),
        }
    }

    /// Array of tables (`[[key]]`), empty when absent. Entries are named `key #n`, n from 1.
    pub(crate) fn sections(&self, key: &str) -> Outcome<Vec<Section<'a>>> {
        let entries = match self.value(key) {
            None => return Ok(Vec::new()),
            Some(Value::Array(entries)) => entries,
            Some(other) => {
                return Err(self.error(key, format!("tables written as [[{key}]]"), describe(other)));
            }
        };
        let mut out = Vec::with_capacity(entries.len());
        for (index, entry) in entries.iter().enumerate() {
            let Value::Table(table) = entry else {
                return Err(self.error(key, format!("tables written as [[{key}]]"), describe(entry)));
            };
            let path = format!("{} #{}", self.name(key), index + 1);
            out.push(Section { file: self.file, path, table, known: RefCell::default() });
        }
        Ok(out)
    }

    /// Text, if present; a TOML date-time counts as text.
    pub(crate) fn text(&self, key: &str) -> Outcome<Option<String>> {
        match self.value(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text.clone())),
            Some(Value::Datetime(time)) => Ok(Some(time.to_string())),
            Some(other) => Err(self.error(key, "text in quotes", describe(other))),
        }
    }

    /// Text that must be there.
    pub(crate) fn required_text(&self, key: &str, expected: &str) -> Outcome<String> {
        match self.text(key)? {
            Some(text) if !text.trim().is_empty() => Ok(text),
            Some(_) => Err(self.error(key, expected, "an empty text")),
            None => Err(self.error(key, expected, "nothing")),
        }
    }

    /// `true` or `false`, if present.
    pub(crate) fn flag(&self, key: &str) -> Outcome<Option<bool>> {
        match self.value(key) {
            None => Ok(None),
            Some(Value::Boolean(flag)) => Ok(Some(*flag)),
            Some(other) => Err(self.error(key, "true or false", describe(other))),
        }
    }

    /// Finite number, if present.
    pub(crate) fn number(&self, key: &str) -> Outcome<Option<f64>> {
        self.value(key).map(|value| self.finite(key, value)).transpose()
    }

    /// Finite number within `[low, high]`, if present.
    pub(crate) fn number_in(&self, key: &str, low: f64, high: f64) -> Outcome<Option<f64>> {
        let Some(value) = self.number(key)? else { return Ok(None) };
        if (low..=high).contains(&value) {
            return Ok(Some(value));
        }
        let hint = "check the unit in the key's name";
        Err(self.error(key, format!("a number between {low} and {high}"), format!("{value}")).hint(hint))
    }

    fn finite(&self, key: &str, value: &Value) -> Outcome<f64> {
        let number = match value {
            Value::Float(x) => *x,
            #[allow(clippy::cast_precision_loss)]
            Value::Integer(i) => *i as f64,
            other => return Err(self.error(key, "a number", describe(other))),
        };
        if number.is_finite() {
            Ok(number)
        } else {
            Err(self.error(key, "a finite number", format!("{number}")))
        }
    }

    /// Array of exactly `N` finite numbers, if present.
    pub(crate) fn numbers<const N: usize>(&self, key: &str) -> Outcome<Option<[f64; N]>> {
        self.value(key).map(|value| self.array(key, value)).transpose()
    }

    /// Three finite numbers, if present.
    pub(crate) fn vector(&self, key: &str) -> Outcome<Option<Vector3<f64>>> {
        Ok(self.numbers::<3>(key)?.map(Vector3::from))
    }

    /// Rows of three finite numbers, if present.
    pub(crate) fn vectors(&self, key: &str) -> Outcome<Option<Vec<Vector3<f64>>>> {
        let Some(value) = self.value(key) else { return Ok(None) };
        let Value::Array(entries) = value else {
            return Err(self.error(key, "an array of [x, y, z]", describe(value)));
        };
        entries.iter().map(|e| self.array::<3>(key, e).map(Vector3::from)).collect::<Outcome<_>>().map(Some)
    }

    fn array<const N: usize>(&self, key: &str, value: &Value) -> Outcome<[f64; N]> {
        let Value::Array(entries) = value else {
            return Err(self.error(key, format!("an array of {N} numbers"), describe(value)));
        };
        if entries.len() != N {
            return Err(self.error(
                key,
                format!("an array of {N} numbers"),
                format!("{} entries", entries.len()),
            ));
        }
        let mut out = [0.0; N];
        for (slot, entry) in out.iter_mut().zip(entries) {
            *slot = self.finite(key, entry)?;
        }
        Ok(out)
    }

    /// A unit vector: exact to 1e-3, then normalised; `None` when absent.
    pub(crate) fn unit_vector(&self, key: &str) -> Outcome<Option<Vector3<f64>>> {
        self.vector(key)?.map(|v| self.normalised(key, v)).transpose()
    }

    pub(crate) fn normalised(&self, key: &str, v: Vector3<f64>) -> Outcome<Vector3<f64>> {
        const TOLERANCE: f64 = 1e-3;
        let length = v.norm();
        if (length - 1.0).abs() > TOLERANCE {
            return Err(self.error(
                key,
                "a vector of length 1 (within 0.001)",
                format!("length {length:.6}"),
            ));
        }
        Ok(v / length)
    }
}

fn describe(value: &Value) -> String {
    match value {
        Value::Table(_) => "a table".to_owned(),
        Value::Array(_) => "an array".to_owned(),
        Value::String(text) => format!("the text {}", quote(text)),
        other => format!("{other}"),
    }
}

/// Parses TOML; a syntax error names the line.
pub(crate) fn parse(file: &str, bytes: &[u8]) -> Outcome<Table> {
    let text = wcal_core::text::utf8(bytes).map_err(|other| {
        let valid = std::str::from_utf8(bytes).map_or_else(|e| e.valid_up_to(), str::len);
        let line = 1 + bytes[..valid].iter().filter(|b| **b == b'\n').count();
        not_utf8(file, other).at(line)
    })?;
    text.parse::<Table>().map_err(|e| {
        let error = InputError::new(file, "valid TOML", e.message().to_owned());
        match e.span() {
            Some(span) => error.at(1 + text[..span.start.min(text.len())].matches('\n').count()),
            None => error,
        }
    })
}
