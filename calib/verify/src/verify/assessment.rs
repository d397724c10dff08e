//! One look at the sealed readings: do they agree with what was decided?
//!
//! ```text
//! contradicted: P(F_{n, dof} > F) < alpha_k              F of `prediction_residual`; look k of the same files: alpha_k = alpha / (k (k + 1))
//! ```
//!
//! The decision cannot change by it: the sealed readings confirm it, do not contradict it, or veto
//! its calibration. A reading is set aside only where both models put it beyond the limit that the
//! open readings gave.

use super::acceptance::far_above_floor;
use super::decision::Decision;
use super::error_summary::{coverage95, summarise};
use super::left_out::{Errors, SharedNoise, noise_ratio};
use super::prediction_residual::PredictionResidual;
use super::session_model::{HeldOut, Quantity, SessionModel};
use crate::error::VerifyError;
use crate::levels::{HOLDOUT, SEALED_ABOVE_FLOOR, SEALED_RIVAL, SEALED_SINGLE_READINGS};
use crate::method::fit::{Weights, fit};
use crate::method::hypothesis::Hypothesis;
use crate::method::noise::Noise;
use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, Normal};
use wcal_core::verify_document::{HoldoutJudgement, HoldoutOutcome};
use wcal_core::{Look, ResidualRecord};

/// More of them than this share are no single readings; of fewer than ten none is.
const MAX_SHARE: f64 = 0.1;

/// What the sealed readings say of a decision, and every reading under both models.
pub struct Assessment<M: SessionModel> {
    /// The model at every reading, the sealed ones among them.
    pub whole: M,
    /// Every reading under the declared model.
    pub before: M::Predictions,
    /// Every reading under the accepted model.
    pub after: M::Predictions,
    /// Errors on the sealed readings; none where nothing that counts was sealed.
    pub errors: Option<Errors>,
    /// Sealed readings that both models put far outside the noise.
    pub flagged: Vec<usize>,
    /// What the sealed readings say.
    pub holdout: HoldoutJudgement,
    /// Residual records of every reading and channel.
    pub residuals: Vec<ResidualRecord>,
}

/// Holds a decision against the rows that came out.
///
/// # Errors
/// Where the rows cannot be modelled, or a model has no solution at them.
pub fn assess<M: SessionModel>(
    decision: &Decision<M>,
    rows: &[M::Row],
    look: Option<&Look>,
) -> Result<Assessment<M>, VerifyError> {
    let whole = decision.of.model.with_holdout(rows)?;
    let (noise, base) = (&decision.of.noise, &decision.of.explained.found.base);
    let accepted = &decision.conclusion.accepted;
    let sd = noise.reading_sd(&whole.noise_inputs());
    let at = |h: &Hypothesis| whole.predict(h, &sd).ok_or(VerifyError::NoSolution);
    let (before, after) = (at(base)?, at(accepted)?);
    let flagged = holdout_outliers(&whole, [base, accepted], noise);
    let counts = whole.scored().contains(&true);
    let errors = counts.then(|| errors(&whole, [&before, &after], &flagged, noise));
    let holdout = match (&errors, look) {
        (Some(errors), Some(look)) => judgement(decision, &whole, &flagged, errors, look),
        _ => HoldoutJudgement::default(),
    };
    let residuals = residuals(decision, &whole, [&before, &after], &flagged);
    Ok(Assessment {
        whole,
        before,
        after,
        errors,
        flagged,
        holdout,
        residuals,
    })
}

/// Sealed readings that count, without `left_out`.
fn scored_rows(whole: &impl SessionModel, left_out: &[usize]) -> Vec<usize> {
    let counts = |i: &usize| whole.scored()[*i] && !left_out.contains(i);
    (0..whole.scored().len()).filter(counts).collect()
}

/// Their errors.
fn scored<M: SessionModel>(
    whole: &M,
    predictions: &M::Predictions,
    left_out: &[usize],
) -> Vec<HeldOut> {
    scored_rows(whole, left_out)
        .into_iter()
        .map(|i| whole.errors(predictions, i))
        .collect()
}

/// Errors of both models on every sealed reading that counts, and without those that are set aside.
fn errors<M: SessionModel>(
    whole: &M,
    [before, after]: [&M::Predictions; 2],
    flagged: &[usize],
    noise: &Noise,
) -> Errors {
    let sum = |rows: &[HeldOut]| summarise(rows, whole.quantities(), "holdout");
    let rows = scored(whole, after, &[]);
    let trimmed = |p: &M::Predictions| sum(&scored(whole, p, flagged));
    Errors {
        before: sum(&scored(whole, before, &[])),
        after: sum(&rows),
        trimmed: (!flagged.is_empty()).then(|| [trimmed(before), trimmed(after)]),
        noise_ratio: noise_ratio(whole, noise, &scored_rows(whole, &[])),
        shared: Some(shared_noise(whole, flagged, noise)),
        coverage95: coverage95(&rows),
        ..Errors::default()
    }
}

/// The tests that were fixed in advance: noise and parameters, the floor of repeats, and which of
/// the two models the readings speak against.
fn judgement<M: SessionModel>(
    decision: &Decision<M>,
    whole: &M,
    flagged: &[usize],
    errors: &Errors,
    look: &Look,
) -> HoldoutJudgement {
    let (noise, accepted) = (&decision.of.noise, &decision.conclusion.accepted);
    // Shared noise at the upper ends: what the open readings hardly tell must not contradict.
    let upper = noise.at_upper_ends();
    let judged = |i: usize| whole.scored()[i] && !flagged.contains(&i);
    let of = |h: &Hypothesis| {
        let tangents = fit(
            whole,
            &h.fit.terms,
            &Weights::equal(whole.scored().len()),
            0,
        )?;
        PredictionResidual::of(whole, h, &tangents, &upper, judged)
    };
    let (declared, after) = (of(&decision.of.explained.found.base), of(accepted));
    let p = after.as_ref().and_then(PredictionResidual::p);
    // Look k may spend alpha / (k (k + 1)): over all looks the sum stays below alpha.
    let level = look.level(HOLDOUT);
    // The error without readings that are set aside, against what repeats differ by.
    let trimmed = errors
        .trimmed
        .as_ref()
        .map_or(errors.after.clone(), |[_, after]| after.clone());
    let trimmed = Errors {
        after: trimmed,
        ..errors.clone()
    };
    let far = far_above_floor(
        whole,
        accepted,
        &trimmed,
        &decision.floor,
        look.level(SEALED_ABOVE_FLOOR),
    );
    let (plain, unit) = (accepted.fit.terms.is_empty(), whole.quantities()[0].unit);
    // Of two models the one that the other refutes.
    let group = |i: usize| whole.groups()[i];
    let refuted = |wrong: &Option<PredictionResidual>, right: &Option<PredictionResidual>| {
        let p = wrong
            .as_ref()
            .zip(right.as_ref())
            .and_then(|(wrong, right)| wrong.beside(right, group).p());
        !plain && p.is_some_and(|p| p < look.level(SEALED_RIVAL))
    };
    let (outcome, why) = match (p, far) {
        (Some(p), _) if p < level => (
            HoldoutOutcome::Contradicted,
            "The sealed readings contradict what the fitted readings allow: something acts there that they do not show."
                .to_owned(),
        ),
        (_, Some(far)) => (HoldoutOutcome::Contradicted, far.sentence(unit)),
        _ if refuted(&after, &declared) => (
            HoldoutOutcome::Contradicted,
            "The sealed readings contradict the accepted effects: their error rises with them, beyond chance.".to_owned(),
        ),
        (Some(_), _) if plain => {
            (HoldoutOutcome::Confirmed, "The sealed readings agree with the accepted model.".to_owned())
        }
        _ if refuted(&declared, &after) => (
            HoldoutOutcome::Confirmed,
            "The sealed readings agree with the accepted model, and contradict the declared one.".to_owned(),
        ),
        _ => (
            HoldoutOutcome::NotContradicted,
            "The sealed readings do not contradict the accepted model, and do not tell it from the declared one."
                .to_owned(),
        ),
    };
    HoldoutJudgement {
        outcome,
        p,
        look: look.number,
        level: Some(level),
        decision_sha256: Some(look.decision_sha256.clone()),
        why,
    }
}

/// `sealed` with the quantities that no sealed reading shows (contacts, where no sealed pose has a
/// picture), left out in turn.
pub(crate) fn fill_missing(
    model: &impl SessionModel,
    mut sealed: Errors,
    in_turn: &Errors,
) -> Errors {
    let shown = |q: &&Quantity| !sealed.shows(q.key);
    let missing: Vec<&str> = model
        .quantities()
        .iter()
        .filter(shown)
        .map(|q| q.key)
        .collect();
    for (to, from) in [
        (&mut sealed.before, &in_turn.before),
        (&mut sealed.after, &in_turn.after),
    ] {
        let (Some(to), Some(from)) = (to, from) else {
            continue;
        };
        for key in &missing {
            to.rmse
                .extend(from.rmse.get(*key).map(|v| ((*key).to_owned(), *v)));
            to.interval95
                .extend(from.interval95.get(*key).map(|v| ((*key).to_owned(), *v)));
        }
    }
    let keys: Vec<&str> = missing.into_iter().filter(|k| in_turn.shows(k)).collect();
    if !keys.is_empty() {
        let keys = keys.join(", ");
        sealed.remark = format!(" No sealed reading shows {keys}: it is {}.", in_turn.words);
    }
    sealed
}

/// Measured less predicted at every reading of `whole`, in the engine's channels.
fn residual(whole: &impl SessionModel, h: &Hypothesis) -> Option<DMatrix<f64>> {
    Some(whole.measured() - whole.design(&h.fit.terms)? * &h.fit.coefficients)
}

/// Sealed readings that no tails of the noise explain under any of `models`, as in the fit: single
/// slips are no misfit.
fn holdout_outliers(
    whole: &impl SessionModel,
    models: [&Hypothesis; 2],
    noise: &Noise,
) -> Vec<usize> {
    let rows = scored_rows(whole, &[]);
    if !(noise.repeat.value > 0.0) {
        return Vec::new();
    }
    let Some(left) = models
        .iter()
        .map(|h| residual(whole, h))
        .collect::<Option<Vec<_>>>()
    else {
        return Vec::new();
    };
    let sd = noise.reading_sd(&whole.noise_inputs());
    let heavy = noise.tails.filter(|t| t.heaviest.is_finite());
    let tail = |x: f64| heavy.map_or_else(|| 2.0 * Normal::standard().sf(x), |t| t.two_sided(x));
    // Every sealed value is one more look at the same level.
    let level = SEALED_SINGLE_READINGS / (whole.measured().ncols() * rows.len().max(1)) as f64;
    // One model alone could set aside what speaks against it.
    let beyond = |i: &usize| left.iter().all(|r| tail(r.row(*i).amax() / sd[*i]) < level);
    let out: Vec<usize> = rows.iter().copied().filter(beyond).collect();
    if out.len() as f64 > MAX_SHARE * rows.len() as f64 {
        Vec::new()
    } else {
        out
    }
}

/// Readings of which the covariance is taken at most: it is dense.
const MAX_DENSE: usize = 500;

/// What the unsealed readings share by the noise: those that share it say less than they are.
fn shared_noise(whole: &impl SessionModel, flagged: &[usize], noise: &Noise) -> SharedNoise {
    let rows = scored_rows(whole, flagged);
    let step = rows.len().div_ceil(MAX_DENSE).max(1);
    let rows: Vec<usize> = rows.into_iter().step_by(step).collect();
    let covariance = |noise: &Noise| noise.weights_of(&whole.noise_inputs()).covariance(&rows);
    let (c, estimated) = (covariance(&noise.at_upper_ends()), covariance(noise));
    SharedNoise {
        // Satterthwaite: the mean of correlated squares scatters like that of fewer independent
        // ones.
        independent: c.trace().powi(2) / c.norm_squared(),
        widening: (c.trace() / estimated.trace()).max(1.0).sqrt(),
    }
}

/// Records of every reading and channel.
fn residuals<M: SessionModel>(
    decision: &Decision<M>,
    whole: &M,
    [before, after]: [&M::Predictions; 2],
    set_aside: &[usize],
) -> Vec<ResidualRecord> {
    let model = &decision.of.model;
    let covariates = whole.covariates();
    let sd = decision.of.noise.reading_sd(&whole.noise_inputs());
    let place = |m: &M, i: usize| {
        let o = m.origin(i);
        (o.source, o.line)
    };
    let flags: Vec<_> = decision
        .conclusion
        .accepted
        .flagged
        .iter()
        .map(|&i| place(model, i))
        .collect();
    let fitted: std::collections::BTreeSet<_> = (0..model.measured().nrows())
        .map(|i| place(model, i))
        .collect();
    let rejected = |i: usize| {
        let own = place(whole, i);
        if flags.contains(&own) || set_aside.contains(&i) {
            return Some("single reading far outside the noise".to_owned());
        }
        (!whole.sealed()[i] && !fitted.contains(&own))
            .then(|| "left out of the search: too many readings".to_owned())
    };
    let of = |i: usize| {
        let origin = whole.origin(i);
        let record = |(channel, values): (String, [f64; 3])| ResidualRecord {
            source: origin.source.clone(),
            line: origin.line,
            point: origin.point,
            role: format!("{:?}", origin.role).to_lowercase(),
            group: whole.groups()[i],
            channel,
            unit: whole.unit(),
            measured: values[0],
            predicted_before: values[1],
            predicted_after: values[2],
            noise_sd: sd[i] * whole.noise_factor(),
            rejected: rejected(i),
            covariates: covariates.iter().map(|(n, v)| (n.clone(), v[i])).collect(),
        };
        let channels = whole.channels(before, after, i).into_iter();
        channels.map(record).collect::<Vec<_>>()
    };
    (0..sd.len()).flat_map(of).collect()
}
