//! The catalogue of the scalar kinds: one file an effect.
//!
//! Parameters are in half ranges of the stimulus, durations of the session and cycles over the range, so that grids and ranges hold for
//! any unit; `scalar::parameters` turns them into the session's units.

mod backlash;
mod creep;
mod cross_axis;
mod dead_zone;
mod drift;
mod error_table;
mod heteroscedastic_noise;
mod hysteresis;
mod lag;
mod memory;
mod nonlinearity_cubic;
mod nonlinearity_quadratic;
mod outliers;
mod periodic;
mod saturation;
mod scale;
mod step;
mod temperature;

use super::frame::Frame;
use super::scalar_effect::ScalarEffect;
use crate::effect::{EffectModel, Parameter, Role};
use std::sync::Arc;

/// Identifier of the effect on the spread of the noise, found by `scalar::spread_test`.
pub const HETEROSCEDASTIC_NOISE: &str = "heteroscedastic-noise";
/// Identifier of the table of errors by place.
pub const ERROR_TABLE: &str = "error-table";
/// Identifier of the periodic effect.
pub const PERIODIC: &str = "periodic";

/// Every effect of docs/src/formats.md for kinds "transducer" and "axis".
pub fn scalar_catalogue(frame: &Frame, covariate_names: &[String]) -> Vec<Arc<dyn ScalarEffect>> {
    vec![
        Arc::new(scale::Scale { sloped: frame.sloped() }),
        Arc::new(nonlinearity_quadratic::NonlinearityQuadratic),
        Arc::new(nonlinearity_cubic::NonlinearityCubic),
        Arc::new(saturation::Saturation),
        Arc::new(dead_zone::DeadZone),
        Arc::new(periodic::Periodic),
        Arc::new(drift::Drift),
        Arc::new(creep::Creep),
        Arc::new(hysteresis::Hysteresis { declared: frame.declared }),
        Arc::new(backlash::Backlash { declared: frame.declared }),
        Arc::new(temperature::Temperature),
        Arc::new(lag::Lag),
        Arc::new(step::Step),
        Arc::new(outliers::Outliers),
        Arc::new(heteroscedastic_noise::HeteroscedasticNoise),
        Arc::new(cross_axis::CrossAxis { count: covariate_names.len() }),
        Arc::new(error_table::ErrorTable { places: frame.places() }),
    ]
}

fn law(
    name: &'static str,
    parameters: Vec<Parameter>,
    linear: &[(&'static str, &'static str)],
) -> EffectModel {
    EffectModel { name, parameters, linear: linear.to_vec(), largest_share: None, needs: Vec::new() }
}

fn amplitude(name: &'static str, unit: &'static str, range: [f64; 2], probe: f64) -> Parameter {
    Parameter { name, unit, range, role: Role::Amplitude { probe } }
}

fn shape(name: &'static str, unit: &'static str, range: [f64; 2], grid: &'static [f64]) -> Parameter {
    Parameter { name, unit, range, role: Role::Shape { grid } }
}
