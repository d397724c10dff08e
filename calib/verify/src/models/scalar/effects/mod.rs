//! The catalogue of the scalar kinds: an effect is a function, in the file of what it acts on.
//!
//! Parameters are in half ranges of the stimulus, durations of the session and cycles over the
//! range, so that grids and ranges hold for any unit; `scalar::parameters` turns them into the
//! session's units.

mod bends;
mod error_table;
mod memory;
mod periodic;
mod response;
mod scales;
mod series;
mod stimulus;

use super::frame::{Declared, Frame};
use super::scalar_effect::ScalarEffect;
pub(crate) use bends::POLYNOMIAL;
pub(crate) use error_table::{ERROR_TABLE, left_out_rms, share_of_gap};
pub(crate) use periodic::{PERIODIC, of_a_turn};
pub(crate) use response::HETEROSCEDASTIC_NOISE;
pub(crate) use series::ZERO_BY_SERIES;

/// Every effect of docs/src/method.md for kinds "transducer" and "axis".
pub(crate) fn scalar_catalogue(frame: &Frame, covariates: usize) -> Vec<ScalarEffect> {
    let declared = match frame.declared {
        Declared::Polynomial(degree) => degree,
        Declared::Axis => 1,
    };
    vec![
        stimulus::scale(frame.sloped()),
        bends::nonlinearity_quadratic(),
        bends::nonlinearity_cubic(),
        bends::polynomial(declared),
        bends::saturation(),
        bends::knee(),
        bends::dead_zone(),
        scales::logarithmic_scale(),
        scales::callendar_van_dusen(),
        periodic::periodic(),
        response::drift(),
        stimulus::creep(),
        stimulus::hysteresis(frame.declared),
        stimulus::backlash(frame.declared),
        response::temperature(),
        stimulus::lag(),
        response::step(),
        response::outliers(),
        response::heteroscedastic_noise(),
        response::cross_axis(covariates),
        series::zero_by_series(frame.scaling.series.len()),
        series::count_wrap(),
        error_table::error_table(&frame.places()),
    ]
}
