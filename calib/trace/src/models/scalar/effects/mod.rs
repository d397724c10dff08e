//! The catalogue of the scalar kinds: an effect is a function, in the file of what it acts on.
//!
//! Parameters are in half ranges of the stimulus, durations of the session and cycles over the range, so that grids and ranges hold for
//! any unit; `scalar::parameters` turns them into the session's units.

mod error_table;
mod memory;
mod periodic;
mod response;
mod stimulus;

use super::frame::Frame;
use super::scalar_effect::ScalarEffect;
pub use error_table::ERROR_TABLE;
pub use periodic::PERIODIC;
pub use response::HETEROSCEDASTIC_NOISE;

/// Every effect of docs/src/formats.md for kinds "transducer" and "axis".
pub fn scalar_catalogue(frame: &Frame, covariates: usize) -> Vec<ScalarEffect> {
    vec![
        stimulus::scale(frame.sloped()),
        response::nonlinearity_quadratic(),
        response::nonlinearity_cubic(),
        stimulus::saturation(),
        stimulus::dead_zone(),
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
        error_table::error_table(&frame.places()),
    ]
}
