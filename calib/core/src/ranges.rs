//! Which numbers a document may hold: a table of ranges by key, checked on the text's own values,
//! before anything is made of them.
//!
//! A key is matched by its last parts: `youngs_gpa` or `whisker.youngs_gpa`; the first range that
//! fits counts, and `""` fits every key. Positions in arrays are no part of it.

use crate::text::{brief, number};
use serde_json::Value;
use std::fmt;

/// Numbers that a key may have, both ends included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    key: &'static str,
    low: f64,
    high: f64,
    whole: bool,
}

impl Range {
    /// Real numbers.
    pub const fn real(key: &'static str, low: f64, high: f64) -> Self {
        Self {
            key,
            low,
            high,
            whole: false,
        }
    }

    /// Whole numbers.
    pub const fn whole(key: &'static str, low: f64, high: f64) -> Self {
        Self {
            key,
            low,
            high,
            whole: true,
        }
    }

    fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// Judges one number: `name` is what a message calls it, `whole` whether it is written as a
    /// whole one.
    ///
    /// # Errors
    /// Where it is out of the range.
    pub fn judge(&self, name: &str, value: f64, whole: bool) -> Result<(), OutOfRange> {
        if self.holds(value) && (whole || !self.whole) {
            return Ok(());
        }
        let found = format!(
            "{}{}",
            number(value, 17),
            self.other_unit(own_part(name), value)
        );
        Err(OutOfRange {
            key: brief(name),
            expected: self.to_string(),
            found,
        })
    }

    /// Judges a number by its own key.
    ///
    /// # Errors
    /// As [`Range::judge`].
    pub fn judge_own(&self, value: f64) -> Result<(), OutOfRange> {
        self.judge(self.key, value, value.fract() == 0.0)
    }

    /// The unit in which the value would be in the range, as a question.
    fn other_unit(&self, key: &str, value: f64) -> String {
        const UNITS: [(&str, f64, &str); 5] = [
            ("_mm", 1e3, "m"),
            ("_mm", 1e-3, "um"),
            ("_gpa", 1e-3, "MPa"),
            ("_gpa", 1e-9, "Pa"),
            ("_nm", 1e9, "m"),
        ];
        let fits = |(suffix, factor, _): &&(&str, f64, &str)| {
            key.ends_with(suffix) && self.holds(value * factor)
        };
        UNITS
            .iter()
            .find(fits)
            .map_or_else(String::new, |unit| format!(" (in {}?)", unit.2))
    }

    fn fits(&self, path: &str) -> bool {
        let before = path.strip_suffix(self.key);
        self.key.is_empty() || before.is_some_and(|b| b.is_empty() || b.ends_with('.'))
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.whole {
            "a whole number"
        } else {
            "a number"
        };
        write!(
            f,
            "{kind} between {} and {}",
            number(self.low, 17),
            number(self.high, 17)
        )
    }
}

/// A number that its key cannot have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: expected {expected}, found {found}")]
pub struct OutOfRange {
    /// Key with the tables above it; entries of arrays as `#1`.
    pub key: String,
    /// What it may be.
    pub expected: String,
    /// What it is.
    pub found: String,
}

/// A value of a document, whatever language it is written in.
pub trait Numbers {
    /// Calls `see` with every number below, the key that it stands under (without positions), and
    /// its own name.
    ///
    /// # Errors
    /// The first that `see` gives.
    fn each(&self, key: &str, name: &str, see: &mut See<'_>) -> Result<(), OutOfRange>;
}

/// Judges a number: key, name, value, and whether it is written as a whole one.
pub type See<'a> = dyn FnMut(&str, &str, f64, bool) -> Result<(), OutOfRange> + 'a;

/// A key without the tables above it and without its place in an array.
fn own_part(name: &str) -> &str {
    let last = name.rsplit('.').next().unwrap_or_default();
    last.split(" #").next().unwrap_or_default()
}

/// `above.key`.
fn below(above: &str, key: &str) -> String {
    if above.is_empty() {
        key.to_owned()
    } else {
        format!("{above}.{key}")
    }
}

impl<T: Numbers> Numbers for Vec<T> {
    fn each(&self, key: &str, name: &str, see: &mut See<'_>) -> Result<(), OutOfRange> {
        let mut entries = self.iter().enumerate();
        entries.try_for_each(|(k, v)| v.each(key, &format!("{name} #{}", k + 1), see))
    }
}

impl Numbers for Value {
    fn each(&self, key: &str, name: &str, see: &mut See<'_>) -> Result<(), OutOfRange> {
        match self {
            Self::Number(n) => see(key, name, n.as_f64().unwrap_or(f64::NAN), !n.is_f64()),
            Self::Array(entries) => entries.each(key, name, see),
            Self::Object(map) => map
                .iter()
                .try_for_each(|(k, v)| v.each(&below(key, k), &below(name, k), see)),
            Self::Null | Self::Bool(_) | Self::String(_) => Ok(()),
        }
    }
}

impl Numbers for toml::Value {
    fn each(&self, key: &str, name: &str, see: &mut See<'_>) -> Result<(), OutOfRange> {
        match self {
            #[allow(clippy::cast_precision_loss, reason = "a range is no finer")]
            Self::Integer(n) => see(key, name, *n as f64, true),
            Self::Float(x) => see(key, name, *x, false),
            Self::Array(entries) => entries.each(key, name, see),
            Self::Table(table) => table.each(key, name, see),
            Self::String(_) | Self::Boolean(_) | Self::Datetime(_) => Ok(()),
        }
    }
}

impl Numbers for toml::Table {
    fn each(&self, key: &str, name: &str, see: &mut See<'_>) -> Result<(), OutOfRange> {
        self.iter()
            .try_for_each(|(k, v)| v.each(&below(key, k), &below(name, k), see))
    }
}

/// Holds every number of a document against its range; keys without one are free.
///
/// # Errors
/// The first number out of its range.
pub fn check(document: &impl Numbers, ranges: &[&[Range]]) -> Result<(), OutOfRange> {
    // Most numbers stand in arrays, one key for all of them.
    let mut latest: (String, Option<&Range>) = (String::new(), None);
    document.each("", "", &mut |key, name, value, whole| {
        if latest.0 != key || key.is_empty() {
            latest = (
                key.to_owned(),
                ranges
                    .iter()
                    .copied()
                    .flatten()
                    .find(|range| range.fits(key)),
            );
        }
        latest
            .1
            .map_or(Ok(()), |range| range.judge(name, value, whole))
    })
}

/// The same of a value in memory; what no document can hold is not judged.
///
/// # Errors
/// As [`check`].
pub fn check_value(value: &impl serde::Serialize, ranges: &[&[Range]]) -> Result<(), OutOfRange> {
    // TOML's values hold NaN, where JSON's have nothing; JSON's hold whole numbers of 64 bits.
    match toml::Table::try_from(value) {
        Ok(table) => check(&table, ranges),
        Err(_) => serde_json::to_value(value).map_or(Ok(()), |value| check(&value, ranges)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const RANGES: &[Range] = &[
        Range::whole("net.layers", 1.0, 64.0),
        Range::real("rate", 0.0, 1e9),
        Range::real("", -1e12, 1e12),
    ];

    #[test]
    fn a_number_is_refused_by_its_key_in_either_language() {
        let good = json!({"net": {"layers": 3, "rate": [1.5, 2]}, "title": "x", "none": null});
        assert_eq!(check(&good, &[RANGES]), Ok(()));
        for (bad, says) in [
            (
                json!({"net": {"layers": 0}}),
                "net.layers: expected a whole number between 1 and 64, found 0",
            ),
            (
                json!({"net": {"layers": 2.5}}),
                "net.layers: expected a whole number between 1 and 64, found 2.5",
            ),
            (
                json!({"a": [{"rate": [1, 1e300]}]}),
                "a #1.rate #2: expected a number between 0 and 1e9, found 1e300",
            ),
            (
                json!({"crate": 1e13}),
                "crate: expected a number between -1e12 and 1e12, found 1e13",
            ),
        ] {
            assert_eq!(check(&bad, &[RANGES]).unwrap_err().to_string(), says);
        }
        let length = [Range::real("length_mm", 1.0, 2000.0)];
        let error = check(&json!({"length_mm": 0.06}), &[&length])
            .unwrap_err()
            .to_string();
        assert!(error.ends_with("found 0.06 (in m?)"), "{error}");
        let table: toml::Table = "[net]\nlayers = 3\n[[a]]\nrate = nan\n".parse().unwrap();
        assert_eq!(
            check(&table, &[RANGES]).unwrap_err().to_string(),
            "a #1.rate: expected a number between 0 and 1e9, found NaN"
        );
        assert_eq!(
            check(&json!({"rate": 1e300}), &[]),
            Ok(()),
            "negative control: no range, no refusal"
        );
    }
}
