//! WhiskerNet: a causal transformer over the whisker's signals.
//!
//! Paper: arXiv 2410.14005, section III. Two heads: the paper's three numbers of a place, or weights over the nodes of the static
//! inverse's curve, which keep the answer on what the moments allow: factors, at knots, on what the Bayes filter believes.

mod attention;
mod dense;
pub mod features;
mod fused;
mod kernels;
pub mod model;
mod product;
mod remembered;
mod widest;

pub use features::{COMMON, DOUBT, FeatureMaker, Token, between, knots};
pub use model::{NetworkConfig, Output, Prediction, WhiskerNet};
pub use remembered::Attended;
