//! What a user writes down of an instrument, in the terms of data sheets.

use crate::text::{number, readable, with_unit};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A characteristic of the accepted model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Characteristic {
    /// Name, e.g. `sensitivity`, `non-linearity`.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Half width of its 95 % interval; absent where it is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub half95: Option<f64>,
    /// Unit; `% FS`: of the response's span over the range.
    pub unit: String,
    /// What exactly it is.
    pub meaning: String,
}

impl Characteristic {
    /// One without an interval.
    pub fn new(name: &str, value: f64, unit: &str, meaning: &str) -> Self {
        Self {
            name: name.to_owned(),
            value,
            half95: None,
            unit: unit.to_owned(),
            meaning: meaning.to_owned(),
        }
    }

    /// Value, half width and unit.
    pub fn text(&self) -> String {
        let half = self.half95.map(|half| format!(" ± {}", number(half, 2)));
        let digits = self.half95.map_or(3, |half| digits(self.value, half));
        let value = number(self.value, digits) + &half.unwrap_or_default();
        with_unit(&value, &self.unit)
    }
}

/// Digits of a value down to the second one of its uncertainty.
fn digits(value: f64, half: f64) -> usize {
    let above = (value.abs() / half).log10();
    match above.is_finite() {
        true => (above.floor() + 3.0).clamp(2.0, 15.0) as usize,
        false => 4,
    }
}

/// A source of uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UncertaintySource {
    /// Where it comes from.
    pub source: String,
    /// Standard uncertainty, in the unit of the expanded one; of a bound its half width.
    pub standard: f64,
    /// It is a bound, which is added as it is.
    pub is_bound: bool,
}

/// Expanded uncertainty of one new reading, where it is largest, with its budget.
///
/// ```text
/// U = k sqrt(sum of u_i^2) + sum of bounds
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UncertaintyBudget {
    /// What is uncertain: `stimulus` of a response, or `position`.
    pub of: String,
    /// Expanded uncertainty (95 %).
    pub expanded: f64,
    /// Coverage factor.
    pub k: f64,
    /// Unit.
    pub unit: String,
    /// Stimulus at which it is largest.
    pub at: f64,
    /// Its sources.
    pub sources: Vec<UncertaintySource>,
}

/// The result of a calibration in the terms of data sheets (ISA-37.3, OIML R 60).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DataSheet {
    /// The accepted model as an equation.
    pub equation: String,
    /// Characteristics.
    pub characteristics: Vec<Characteristic>,
    /// Uncertainty of a new reading; absent where the response does not determine the stimulus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyBudget>,
    /// Range in which it holds.
    pub range: [f64; 2],
    /// Unit of the range.
    pub range_unit: String,
    /// Under which conditions, and what is not in it.
    pub conditions: Vec<String>,
}

impl DataSheet {
    /// Lines for the terminal.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.equation.clone()];
        let each = self.characteristics.iter();
        let each: Vec<String> = each.map(|c| format!("{} {}", c.name, c.text())).collect();
        lines.extend((!each.is_empty()).then(|| each.join("; ")));
        lines.extend(self.uncertainty.as_ref().map(|u| {
            format!(
                "U = {} (95 %, k = {:.2}) of a {}, {}",
                with_unit(&number(u.expanded, 2), &u.unit),
                u.k,
                u.of,
                self.range_text()
            )
        }));
        lines
    }

    /// The range in words.
    pub fn range_text(&self) -> String {
        let [low, high] = self.range.map(|v| number(v, 6));
        with_unit(&format!("from {low} to {high}"), &self.range_unit)
    }
}

impl UncertaintySource {
    /// Its size in words.
    pub fn text(&self, unit: &str) -> String {
        let size = with_unit(&readable(self.standard), unit);
        match self.is_bound {
            true => format!("± {size}, a bound"),
            false => size,
        }
    }
}
