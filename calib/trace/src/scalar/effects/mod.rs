//! The catalogue of the scalar kinds: one file an effect.
//!
//! Parameters are in half ranges of the stimulus, durations of the session and cycles over the range, so that grids and ranges hold for
//! any unit; `scalar::parameters` turns them into the session's units.

mod backlash;
mod creep;
mod cross_axis;
mod dead_zone;
mod drift;
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
use super::system::ScalarEffect;
use crate::candidate::{Law, Parameter, Role};
use std::sync::Arc;

/// Identifier of the effect on the spread of the noise, found by `scalar::spread_test`.
pub const HETEROSCEDASTIC_NOISE: &str = "heteroscedastic-noise";
/// Identifier of the periodic effect.
pub const PERIODIC: &str = "periodic";

/// Every effect of docs/src/formats.md for kinds "transducer" and "axis".
#[must_use]
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
    ]
}

fn law(name: &'static str, parameters: Vec<Parameter>, linear: &[(&'static str, &'static str)]) -> Law {
    Law { name, parameters, linear: linear.to_vec(), largest_share: None }
}

fn amplitude(name: &'static str, unit: &'static str, range: [f64; 2], probe: f64) -> Parameter {
    Parameter { name, unit, range, role: Role::Amplitude { probe } }
}

fn shape(name: &'static str, unit: &'static str, range: [f64; 2], grid: &'static [f64]) -> Parameter {
    Parameter { name, unit, range, role: Role::Shape { grid } }
}

/// Effects that act on the stimulus need a declared model that follows it.
fn needs_slope(frame: &Frame) -> Option<String> {
    (!frame.sloped()).then(|| "the declared model is constant: it does not follow the stimulus".to_owned())
}

/// Memory effects need readings in both directions.
fn needs_both_directions(frame: &Frame) -> Option<String> {
    frame.direction.is_none().then(|| {
        "the table has no readings in both directions (column direction, or times with rising and falling stimulus)".to_owned()
    })
}

/// Effects of the clock need time stamps, or an order that can be trusted.
fn needs_order(frame: &Frame) -> Option<String> {
    (!frame.ordered).then(|| {
        "the table has no time stamps and is sorted by the stimulus, repetitions side by side: the order of the readings is unknown".to_owned()
    })
}

/// Effects of time need time stamps.
fn needs_time(frame: &Frame) -> Option<String> {
    frame.time.is_none().then(|| "the session has no time stamps".to_owned())
}
