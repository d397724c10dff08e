//! An existing calibration at the readings of a session, against their responses.

use super::model::{ModelError, ScalarModel};
use super::system::ScalarSystem;
use crate::MeasurementModel;
use crate::method::t95;
use crate::verify::{HeldOut, SessionModel};

/// All readings, or those that were sealed, through the calibration.
///
/// # Errors
/// As [`ScalarModel::predict`].
pub fn of_model(
    system: &ScalarSystem,
    model: &ScalarModel,
    only_sealed: bool,
) -> Result<Vec<HeldOut>, ModelError> {
    let rows = &system.frame.rows;
    let predictions = model.predict(rows)?;
    let quantile = t95(model.dof);
    let of = |i: usize| {
        let (error, half95) = (rows[i].y - predictions[i].value, predictions[i].half95);
        HeldOut {
            group: system.groups()[i],
            errors: vec![vec![error]],
            stated_sd: vec![vec![half95 / quantile]],
            inside95: vec![error.abs() <= half95],
        }
    };
    Ok((0..rows.len())
        .filter(|&i| !only_sealed || system.sealed()[i])
        .map(of)
        .collect())
}
