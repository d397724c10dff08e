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

// What the kinds of session use of it.
pub(crate) use admissible::REFIT_STEPS;
pub(crate) use ambiguity::power;
pub(crate) use deletion_diagnostics::influential_set;
pub(crate) use distributions::{chi_squared_tail, sd_interval95};
pub(crate) use fit::{fit, linear};
pub(crate) use fitted::{Fit, Status};
pub(crate) use hypothesis::{Hypothesis, NotIdentified};
pub(crate) use inference::{CLASS_COSINE, cosine, covariance, prediction_sd, t95};
pub(crate) use lack_of_fit::{
    LackOfFit, Part, Split, extra_sum_of_squares_p, members, split, split_of,
};
pub(crate) use linear::{Basis, stack_with};
pub(crate) use min_p::{f_test, strongest};
pub(crate) use noise::spread::{
    MIN_READINGS, Spread, SpreadLaw, heteroscedasticity_test, relative_sd,
};
pub(crate) use noise::{Noise, NoiseInputs, Weights};
pub(crate) use noise_estimator::noise_for_predictions;
pub(crate) use omnibus::{OmnibusTest, omnibus_test};
pub(crate) use options::Options;
pub(crate) use rounding::is_rounding;
pub(crate) use search_result::{RankedHypothesis, SearchResult};
pub(crate) use settings::{means, reliability, settings};
pub(crate) use signature::{
    Signature, nuisance_basis, signatures_of_catalogue, signatures_of_effect,
};
