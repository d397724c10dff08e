//! Measurement models with one value a reading: kinds "transducer" and "axis".

pub mod admission;
mod bends;
pub mod cells;
mod check;
mod data_sheet;
pub mod effects;
pub mod floor;
pub mod frame;
mod inverse;
pub mod judgement;
mod measurement;
pub mod model;
pub mod next;
pub mod parameters;
pub mod polynomial;
pub mod predictions;
mod range_limit;
mod recorded_steps;
mod row;
mod scalar_effect;
mod sequence;
mod spread_trend;
pub mod stationarity;
mod stimulus_scale;
pub mod system;
pub mod table;
mod usable;
pub mod verify;

pub use crate::method::noise::spread::Spread;

pub use frame::{Declared, Frame, ScalarRow, Scaling};

pub use model::{EffectInputs, ModelError, ScalarModel};
pub use polynomial::Polynomial;
pub use scalar_effect::ScalarEffect;
pub use system::ScalarSystem;
pub use verify::{ScalarVerification, verify_scalar};
