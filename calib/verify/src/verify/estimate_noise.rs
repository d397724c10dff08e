//! Feasible generalised least squares, iterated: what the noise and the instrument are like under
//! the accepted model, until neither changes the other.

use super::evidence::{Evidence, independent};
use super::request::VerifyRequest;
use super::session_model::SessionModel;
use crate::error::VerifyError;
use crate::measurement_model::MeasurementModel;
use crate::method::admissible::REFIT_STEPS;
use crate::method::fit::Weights;
use crate::method::hypothesis::Hypothesis;
use crate::method::noise::CORRELATED_PRICE;
use crate::method::noise_estimator::{NoiseEstimator, same_whitening};
use crate::method::search::fit_declared_model;

/// A residual below this share of the measured values is rounding.
const ROUNDING: f64 = 1e-13;

/// Beside the upper quartile of the values: one that is huge says nothing of the digits of the
/// others.
fn is_interpolated(system: &dyn MeasurementModel, base: &Hypothesis) -> bool {
    let mut sizes: Vec<f64> = system.measured().iter().map(|v| v.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let size = sizes.get(3 * sizes.len() / 4).copied().unwrap_or(0.0);
    // Without single readings that stand out of it, the search is to name them.
    base.flagged.is_empty() && base.fit.residual.iter().all(|r| r.abs() <= ROUNDING * size)
}

/// The declared model on readings that are taken for independent, and the instrument as it shows
/// it.
///
/// # Errors
/// Where the declared model has no solution at the readings.
pub(crate) fn fit_baseline<M: SessionModel>(
    model: M,
    request: &VerifyRequest,
) -> Result<Evidence<M>, VerifyError> {
    let fitted = |model: &M| fit_declared_model(model, &independent(model));
    let model = model.prepared(&fitted).ok_or(VerifyError::NoSolution)?;
    Evidence::new(model, request.search.clone())
}

/// The noise under the accepted model, what of it holds under that noise, and the instrument as it
/// shows it. True where that is not what the search was made under: it begins anew.
pub(crate) fn estimate_noise<M: SessionModel>(e: &mut Evidence<M>) -> bool {
    let seed = e.options.seed;
    if is_interpolated(&e.model, &e.search.found.base) {
        e.search.found.best = e.search.found.base.clone();
        e.exact = true;
        return false;
    }
    // Neighbours share something: whether it is noise or an effect is the question, not whether it
    // is there.
    if e.search.found.last_test.generic() {
        e.correlated_gain = CORRELATED_PRICE;
    }
    let judge = NoiseEstimator::new(&e.model, seed).with_correlated_gain(e.correlated_gain);
    let kept = judge.backward_eliminate(&e.search.found.best, &e.search.found.first_test.family);
    let Some(noise) = judge.noise(&kept, &[]) else {
        return false;
    };
    let dropped = kept.fit.terms.len() < e.search.found.best.fit.terms.len();
    let tails_dof = noise.tails.filter(|t| t.heavy).map(|t| t.dof);
    let heavier = tails_dof.is_some() && e.options.tails_dof.is_none() && e.search.is_inadequate();
    // A search under other weights is another search: only what whitens alike may stand.
    let changed = dropped || heavier || !same_whitening(&noise.weights, &e.weights);
    // What correlated noise would swallow may be an effect that no catalogue has: the better
    // description stands.
    let scores = (changed && !dropped && e.search.found.last_test.generic())
        .then(|| judge.covariate_scores(&kept, &e.search.found.last_test))
        .flatten();
    let settled = !changed || scores.is_some();
    if let Some(scores) = scores {
        e.search.found.last_test.covariates = scores;
    }
    // An effect that was not declared hides how the instrument is, too.
    let renewed = e.model.renewed(e.search.accepted(), settled, seed);
    if settled && renewed.is_none() {
        return false;
    }
    e.options.tails_dof = tails_dof;
    let Some(model) = renewed else {
        return e.restart(noise.weights.unmasked());
    };
    let weights = weights_of(&model, &kept, e.correlated_gain, seed);
    e.model = model;
    e.restart(weights.unwrap_or_else(|| independent(&e.model)))
}

/// Weights of what `h` leaves on the readings of `model`, which are seen otherwise than those that
/// it was fitted to.
fn weights_of(
    model: &impl SessionModel,
    h: &Hypothesis,
    correlated_gain: f64,
    seed: u64,
) -> Option<Weights> {
    let judge = NoiseEstimator::new(model, seed).with_correlated_gain(correlated_gain);
    let weights = independent(model).masked(|i| h.weights.counts(i));
    let refitted = Hypothesis::fitted(model, &h.fit.terms, &weights, REFIT_STEPS)?;
    Some(judge.noise(&refitted, &[])?.weights.unmasked())
}
