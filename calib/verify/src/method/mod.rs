//! The statistics shared by every kind of session: fit, screen, refit, compare. They know
//! measurement models and effects, not whiskers.

pub mod admissible;
pub mod ambiguity;
#[cfg(test)]
pub(crate) mod columns_system_test;
pub mod covariates;
pub(crate) mod cross_validated_gain;
pub(crate) mod deletion_diagnostics;
pub mod distributions;
pub mod fit;
pub mod fitted;
pub mod hypothesis;
pub mod inference;
pub mod lack_of_fit;
pub mod linear;
pub mod min_p;
pub mod noise;
pub mod noise_estimator;
pub mod omnibus;
pub mod options;
pub mod outliers;
pub(crate) mod range_check;
mod refine;
pub mod rounding;
pub mod search;
pub mod search_result;
pub mod settings;
pub mod signature;
pub(crate) mod smooth_rival;
pub(crate) mod subsets;
