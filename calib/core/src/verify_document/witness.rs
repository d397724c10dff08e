//! What further measurements of the instrument say of the explanations.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An explanation before a witness: a measurement of the same instrument with its own noise, or its
/// repeated readings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct WitnessTest {
    /// Identifier of the witness: `sweep`, `pictures`, `replicates`.
    pub witness: String,
    /// Effects of the explanation; empty for the declared model.
    pub effects: Vec<String>,
    /// Test statistic, chi-squared distributed where the explanation is right within its
    /// uncertainty; of replicates F.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub dof: f64,
    /// Chance of a statistic as large.
    #[schemars(range(min = 0, max = 1))]
    pub p: f64,
    /// Whether the witness refutes the explanation; pictures join the fit and are weighed by their
    /// scatter: they refute nothing by themselves. Replicates that refute say that something
    /// remains beside it.
    pub refuted: bool,
    /// Size of what speaks against it: of a sweep the median distance of the nearest possible
    /// contact from the object, of pictures their scatter over what the shapes state, of replicates
    /// the standard deviation within a setting.
    pub magnitude: f64,
    /// Unit of the magnitude.
    pub unit: String,
    /// In words.
    pub sentence: String,
}
