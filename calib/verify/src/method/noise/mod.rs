//! The noise of the readings in parts, estimated from the residuals of a model.

mod estimate;
mod inputs;
mod likelihood;
mod parts;
pub mod spread;
mod spread_model;
pub mod tails;
pub(crate) mod whitening;

pub use estimate::estimate;
pub(crate) use estimate::{
    CORRELATED_PRICE, COURSE, Components, best_misfit, correlated_gain, estimate_components,
};

pub use inputs::NoiseInputs;
pub use likelihood::{MeanModel, RestrictedLikelihood};
pub use parts::Noise;
pub use spread_model::SpreadModel;

pub use whitening::Weights;
