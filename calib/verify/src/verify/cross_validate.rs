//! What predicts readings that are left out in turn keeps its name; what does not is withdrawn.

use super::conclusion::{Facts, Withdrawn};
use super::evidence::{Evidence, independent};
use super::explained::Explained;
use super::left_out::{LeftOut, leave_out};
use super::request::VerifyRequest;
use super::session_model::SessionModel;
use crate::effect::Role;
use crate::error::VerifyError;
use crate::levels::{CATALOGUE, LEFT_OUT_GAIN, NEGLIGIBLE, USUAL};
use crate::measurement_model::MeasurementModel;
use crate::method::cross_validated_gain::retain_cross_validated;
use crate::method::distributions::f_tail;
use crate::method::fit::Fit;
use crate::method::hypothesis::{Gate, Hypothesis, Rejection};
use crate::method::inference::covariance;
use crate::method::noise::Noise;
use crate::method::noise_estimator::NoiseEstimator;
use crate::method::omnibus::omnibus_test;
use crate::method::options::Options;
use crate::method::search::fit_declared_model;
use crate::method::search_result::SearchResult;
use nalgebra::{DMatrix, DVector};
use std::cell::Cell;
use wcal_core::verify_document::TwinFault;

/// An explanation that readings left out in turn bear out.
pub(crate) struct Validated<M> {
    /// The model at the open readings.
    pub model: M,
    /// What was found.
    pub explained: Explained,
    /// Faults of an outside twin.
    pub faults: Vec<TwinFault>,
    /// The explanation.
    pub accepted: Hypothesis,
    /// It was asked for.
    pub on_request: bool,
    /// What was withdrawn for it.
    pub withdrawn: Option<Withdrawn>,
    /// Its noise.
    pub noise: Noise,
    /// Errors of readings left out in turn.
    pub left_out: LeftOut<M>,
}

/// Cross-validates what the search found over whole trajectories, cycles or stimuli; each fold
/// chooses anew among the refitted explanations.
///
/// # Errors
/// Where the declared model's residuals have no noise, or no surviving explanation has the effects
/// that are to be accepted.
pub(crate) fn cross_validate<M: SessionModel>(
    e: Evidence<M>,
    found: SearchResult,
    request: &VerifyRequest,
) -> Result<Validated<M>, VerifyError> {
    let (model, mut explained) = settle_noise(e, found)?;
    let (seed, faults) = (request.search.seed, model.twin_faults());
    let facts = Facts::of(&model, &explained, &faults);
    // What is asked for, else what the data support term by term.
    let asked = facts.asked(&request.accept)?.cloned();
    let on_request = asked.is_some();
    let mut accepted = match asked {
        Some(chosen) => chosen,
        None if facts.is_ambiguous() => facts.accepted().clone(),
        None => {
            let whole = facts.accepted().clone();
            drop_unsupported(&model, &mut explained, whole, &request.search)
        }
    };
    let facts = Facts::of(&model, &explained, &faults);
    let (found, mut noise) = (&explained.found, &explained.noise);
    let mut left_out = leave_out(&model, found, &accepted, noise, on_request, seed);
    let asked = !accepted.fit.terms.is_empty() && !on_request;
    let p = if asked {
        left_out.gain_p(&model, &accepted)
    } else {
        None
    };
    let names = |h: &Hypothesis| facts.effects(h).into_iter().map(|e| e.id).collect();
    let by_chance = p
        .filter(|p| *p >= LEFT_OUT_GAIN)
        .and_then(|_| left_out.change(&model));
    let withdrawn = by_chance.map(|errors| Withdrawn {
        names: names(&accepted),
        errors,
    });
    // What chance gives is no effect: the declared model is tested on the same folds.
    if withdrawn.is_some() {
        (accepted, noise) = (found.base.clone(), &explained.declared_noise);
        left_out = leave_out(&model, found, &accepted, noise, on_request, seed);
    }
    let noise = noise.clone();
    Ok(Validated {
        model,
        explained,
        faults,
        accepted,
        on_request,
        withdrawn,
        noise,
        left_out,
    })
}

/// The noise that a decision rests on, and what remains under it. Correlated noise that takes up
/// everything is one description; a smooth course that no catalogue has may be the better one.
///
/// # Errors
/// Where the declared model's residuals have no noise.
fn settle_noise<M: SessionModel>(
    e: Evidence<M>,
    mut found: SearchResult,
) -> Result<(M, Explained), VerifyError> {
    let Evidence {
        model,
        options,
        correlated_gain,
        plain_test,
        exact,
        tests,
        rejections,
        ..
    } = e;
    found.rejections.extend(rejections);
    let judge = NoiseEstimator::new(&model, options.seed).with_correlated_gain(correlated_gain);
    let base = fit_declared_model(&model, &independent(&model)).ok_or(VerifyError::NoSolution)?;
    let declared_noise = judge.noise(&base, &[]).ok_or(VerifyError::NoSolution)?;
    if exact {
        let noise = Noise::none(declared_noise.weights.len());
        let explained = Explained {
            found,
            declared_noise: noise.clone(),
            noise,
            exact,
            tests,
        };
        return Ok((model, explained));
    }
    let nothing = found.best.fit.terms.is_empty() && found.failed_adequacy_test().is_none();
    let correlated = |h: &Hypothesis| judge.noise(h, &[]).is_some_and(|n| n.correlated.is_some());
    if nothing
        && correlated(&found.best)
        && let Some(scores) = judge.covariate_scores(&found.best, &plain_test)
    {
        found.first_test.covariates = scores;
        found.covariate_beats_catalogue = true;
    }
    if model.cross_validates_terms() {
        withdraw_below_model_error(&model, &mut found, &options);
    }
    found
        .survivors
        .extend(judge.noise_rivals(&found.best, &found.first_test.family));
    let columns = found
        .failed_adequacy_test()
        .and_then(|g| g.covariates.first())
        .map_or(Vec::new(), |d| d.columns.clone());
    let noise = judge
        .noise(&found.best, &columns)
        .or_else(|| judge.noise(&found.best, &[]));
    let noise = noise.unwrap_or_else(|| declared_noise.clone());
    let mut explained = Explained {
        found,
        noise,
        declared_noise,
        exact,
        tests,
    };
    model.complete(&mut explained, &options);
    Ok((model, explained))
}

/// Takes back what does not earn its name on readings that are left out, and calls what is then
/// left by its size.
fn withdraw_below_model_error(
    system: &dyn MeasurementModel,
    found: &mut SearchResult,
    options: &Options,
) {
    let (best, within) = retain_cross_validated(system, &found.best);
    let mut small = found.last_test.is_small(&found.best.fit);
    if !within.is_empty() {
        // Where nothing was left beside it, what remains is what was withdrawn: a finding of
        // chance, or more than that.
        let nothing_beside = small || !found.last_test.generic();
        found.last_test = omnibus_test(system, &best.fit, &best.weights, options);
        // A name that was tried and withdrawn must not reject the model again by the same gain.
        found.last_test.leave_out(&best.fit, &within);
        let by_chance = found.last_test.p_covariates().min(found.last_test.p_serial) >= NEGLIGIBLE;
        small = (nothing_beside && by_chance) || found.last_test.is_small(&best.fit);
        let lacks = |h: &Hypothesis| h.fit.terms.iter().all(|t| !within.contains(&t.effect));
        found.survivors = vec![best.clone()];
        found.refitted.retain(lacks);
        found.refitted.insert(0, best.clone());
        found.best = best;
        let names = within
            .iter()
            .map(|&e| system.catalogue()[e].id.to_owned())
            .collect();
        found.rejections.push(Rejection {
            effects: names,
            gate: Gate::LeftOutError,
            why: String::new(),
        });
    }
    found.last_test.within_model_error = small;
}

/// `h` without the terms that are none: beside the others each has to pass the level at which the
/// search names, with a size that is not zero. The least supported one first; itself where all are.
/// Noise is then that of what is kept; where the fit needs a term of no size, something remains.
fn drop_unsupported(
    model: &impl SessionModel,
    explained: &mut Explained,
    h: Hypothesis,
    options: &Options,
) -> Hypothesis {
    let needed = Cell::new(false);
    let family = &explained.found.first_test.family;
    let weakest = |kept: &Hypothesis, dropped: Vec<(usize, Hypothesis)>| {
        let tested = dropped
            .into_iter()
            .map(|d| (d.1.removal_p(&kept.fit, family), d));
        let none = |(p, (term, _)): &(f64, (usize, Hypothesis))| {
            *p >= CATALOGUE || amplitudes_hold_zero(model, &kept.fit, *term)
        };
        let (p, dropped) = tested.filter(none).max_by(|a, b| a.0.total_cmp(&b.0))?;
        // Its size is zero and the fit needs it all the same: something else stands behind it.
        needed.set(needed.get() || p < CATALOGUE);
        Some(dropped)
    };
    let (kept, gone) = h.eliminate(model, weakest);
    if !gone.is_empty()
        && let Some(noise) = NoiseEstimator::new(model, options.seed).noise(&kept, &[])
    {
        explained.noise = noise;
    }
    if needed.get() {
        explained.found.last_test = omnibus_test(model, &kept.fit, &kept.weights, options);
    }
    kept
}

/// The joint 95 % region of a term's amplitudes, linear coefficients among them, holds zero (Wald).
/// Each by itself may well hold it: sine and cosine of an error whose period is not known exactly
/// do.
fn amplitudes_hold_zero(model: &impl SessionModel, fit: &Fit, term: usize) -> bool {
    let (q, channels) = (fit.design.ncols(), fit.residual.ncols());
    let (slots, of) = (&fit.slots(model.catalogue())[term], &fit.terms[term]);
    let law = model.catalogue()[of.effect].law(of.law);
    // Coefficients stand channel by channel in the covariance, nonlinear values behind them.
    let linear = slots.columns.clone();
    let linear =
        linear.flat_map(|j| (0..channels).map(move |k| (fit.coefficients[(j, k)], k * q + j)));
    let values = law
        .parameters
        .iter()
        .zip(of.values.iter().zip(slots.values.clone()));
    let values = values
        .filter(|(p, _)| matches!(p.role, Role::Amplitude { .. }))
        .map(|(_, (value, k))| (*value, q * channels + k));
    let amplitudes: Vec<(f64, usize)> = linear.chain(values).collect();
    let (n, c) = (amplitudes.len(), covariance(fit, fit.variance()));
    let values = DVector::from_iterator(n, amplitudes.iter().map(|a| a.0));
    let spread = DMatrix::from_fn(n, n, |i, j| c[(amplitudes[i].1, amplitudes[j].1)]);
    // Singular: an amplitude that nothing determines cannot be distinguished from zero.
    let Some(factor) = spread.cholesky() else {
        return true;
    };
    // Wald: b' V^-1 b / n is F with n and the residual's degrees of freedom.
    let f = values.dot(&factor.solve(&values)) / n as f64;
    f_tail(f, [n as f64, fit.dof]).is_none_or(|p| p >= USUAL)
}
