//! The noise of the readings in parts, estimated from the residuals of a model.

mod estimate;
mod inputs;
mod likelihood;
mod parts;
pub mod spread;
mod spread_model;
pub mod tails;
mod whitening;

pub use estimate::{
    CORRELATED_PRICE, COURSE, MIN_HELD_REPEATS, best_misfit, correlated_gain, estimate,
};
pub use inputs::NoiseInputs;
pub use likelihood::{MeanModel, RestrictedLikelihood, restricted_likelihood};
pub use parts::Noise;
pub use spread_model::SpreadModel;
pub use whitening::{SharedNoise, Weights};
