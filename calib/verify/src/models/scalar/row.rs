//! One reading of a transducer or an axis.

use wcal_core::observation::{Role, TransducerRow};

/// One reading; `y` is the response, or measured - commanded in um.
#[derive(Debug, Clone, PartialEq)]
pub struct ScalarRow {
    /// File, line and point of the row.
    pub origin: (String, usize, i64),
    /// Role in the table.
    pub role: Role,
    /// Stimulus, or commanded position in mm.
    pub x: f64,
    /// Standard uncertainty of the stimulus, where it is stated.
    pub x_sd: Option<f64>,
    /// Response, or measured - commanded in um.
    pub y: f64,
    /// Time, s.
    pub t_s: Option<f64>,
    /// Temperature, deg C.
    pub temperature_degc: Option<f64>,
    /// +1 or -1.
    pub direction: Option<f64>,
    /// Cycle (axis) or replicate (transducer).
    pub cycle: Option<u32>,
    /// Further covariates.
    pub covariates: Vec<f64>,
    /// Place among all readings of the session, where not all of them are fitted; none: as they
    /// come.
    pub place: Option<usize>,
}

impl From<&TransducerRow> for ScalarRow {
    fn from(r: &TransducerRow) -> Self {
        Self {
            origin: (r.source.clone(), r.line, r.point),
            role: r.role,
            x: r.stimulus,
            x_sd: r.stimulus_sd,
            y: r.response,
            t_s: r.t_s,
            temperature_degc: r.temperature_degc,
            direction: r.direction,
            cycle: r.replicate,
            covariates: r.covariates.clone(),
            place: None,
        }
    }
}

impl ScalarRow {
    /// Of an axis: what its measured position is off, um.
    pub fn of_axis(r: &TransducerRow) -> Self {
        Self {
            // From mm to um.
            y: 1e3 * (r.response - r.stimulus),
            ..r.into()
        }
    }
}

pub(super) fn all<T: Copy>(
    rows: &[ScalarRow],
    f: impl Fn(&ScalarRow) -> Option<T>,
) -> Option<Vec<T>> {
    rows.iter().map(f).collect()
}

/// A reading with nothing but a place, a response and its number.
#[cfg(test)]
pub(super) fn bare(point: usize, x: f64, y: f64) -> ScalarRow {
    ScalarRow {
        origin: ("t.csv".into(), point + 2, point as i64),
        role: Role::Calibration,
        x,
        x_sd: None,
        y,
        t_s: None,
        temperature_degc: None,
        direction: None,
        cycle: None,
        covariates: Vec::new(),
        place: None,
    }
}
