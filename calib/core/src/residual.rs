//! The residual as a record: what was read, what each model said, and whether the reading counted.

use serde::{Deserialize, Serialize};

/// One reading with its residuals before and after, traceable to file and line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResidualRecord {
    /// File.
    pub source: String,
    /// Line in the file, header = 1.
    pub line: usize,
    /// Point number.
    pub point: i64,
    /// Role as in the table.
    pub role: String,
    /// Trajectory, cycle or group; 0 where there is none.
    pub group: u32,
    /// Channel name, e.g. `fbg_1`, `response`.
    pub channel: String,
    /// Unit of the values below.
    pub unit: String,
    /// Measured value.
    pub measured: f64,
    /// Prediction of the declared model.
    pub predicted_before: f64,
    /// Prediction of the accepted model (the same when nothing was accepted).
    pub predicted_after: f64,
    /// Noise standard deviation assumed.
    pub noise_sd: f64,
    /// Why the reading was not used, if it was not.
    pub rejected: Option<String>,
    /// Named covariates, e.g. `("stage_mm", 1.5)`; absent ones are left out.
    pub covariates: Vec<(String, f64)>,
}
