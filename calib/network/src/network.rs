//! WhiskerNet: a causal transformer over the whisker's signals.
//!
//! Paper: arXiv 2410.14005, section III. Two heads: the paper's three numbers of a place, or
//! weights over the nodes of the static inverse's curve, which keep the answer on what the moments
//! allow: factors, at knots, on the Bayes filter's posterior.

mod config;
pub mod features;
mod kv_cache;
pub mod model;

pub use config::{NETWORK_RANGES, NetworkConfig, PLACE_SCALE_MM};
pub use features::{FeatureExtractor, INITIAL_LOG_FLOOR, Token, knot_weights, knots};
pub use kv_cache::{KvCache, time_bias_slope};
pub use model::{Prediction, WhiskerNet};
