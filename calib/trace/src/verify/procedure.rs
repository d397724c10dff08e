//! `verify`: the residual loop, one procedure for every kind of session. The stages are those of docs/src/method.md.

use super::conclusion::{Conclusion, conclude};
use super::document::document;
use super::error_summary::rmse;
use super::held_out::{Errors, Unsealed, completed, left_out_in_turn, on_unsealed, scored};
use super::holdout_check::{HOLDOUT_LEVEL, flagged, holdout_p};
use super::options::VerifyOptions;
use super::refutation;
use super::session_model::{Record, SessionModel};
use crate::error::TraceError;
use crate::method::explain::Explained;
use crate::method::hypothesis::Hypothesis;
use crate::method::noise::Noise;
use wcal_core::verify_document::VerifyDocument;
use wcal_core::{ResidualRecord, Sealed, Unsealing};

/// Everything that `verify` found.
pub struct Verification<M: SessionModel> {
    /// verify.json, without session and files.
    pub document: VerifyDocument,
    /// The model as the noise made it.
    pub model: M,
    /// The model at every reading, unsealed ones among them.
    pub whole: M,
    /// The search and its noise.
    pub explained: Explained,
    /// The verdict in parts.
    pub conclusion: Conclusion,
    /// Predictions under both models.
    pub unsealed: Unsealed<M::Predictions>,
    /// Standard deviation of the floor, in the sensor's unit.
    pub floor_sd: f64,
    /// Held-out errors.
    pub errors: Errors,
    /// Residual records of every reading and channel.
    pub residuals: Vec<ResidualRecord>,
    /// Record of the unsealing; none where nothing was sealed.
    pub unsealing: Option<Unsealing>,
}

/// Rise of the sealed error with which accepted effects are no explanation.
const SEALED_RISE: f64 = 1.1;

/// Runs the stages on a model of the open readings; sealed ones come out at the last stage, once.
///
/// # Errors
/// Where the declared model has no solution at the readings, or the explanation to be accepted is not open.
pub fn verify<M: SessionModel>(
    model: M,
    sealed: &Sealed<M::Row>,
    options: &VerifyOptions,
) -> Result<Verification<M>, TraceError> {
    let (asked, seed) = (&options.accept, options.search.seed);
    // Stage 0: the twin before reality.
    let faults = model.twin_faults();
    // Stages 1 and 3 to 7: noise in parts, baseline, gate, signatures, screening, nested refits.
    let (model, explained) = model.explain(options).ok_or(TraceError::NoSolution)?;
    // Stages 8 and 9: ambiguity set and adequacy.
    let found = &explained.found;
    let mut conclusion =
        if explained.exact { Conclusion::exact(&found.base) } else { conclude(&model, found, &faults) };
    if !asked.is_empty() {
        conclusion.accept(&model, found, asked)?;
    }
    // Stages 2 and 11: the seal held until here and is broken once; the unsealed readings have the last word.
    let (rows, unsealing) = sealed.unseal(&options.seal);
    let whole = model.whole(rows)?;
    let unsealed = last_word(&model, &whole, &explained, &mut conclusion, !asked.is_empty())?;
    let in_turn = || left_out_in_turn(&model, found, &conclusion, &unsealed, !asked.is_empty(), seed);
    let errors = if whole.scored().contains(&true) {
        completed(&model, on_unsealed(&whole, &unsealed, seed), in_turn)
    } else {
        in_turn()
    };
    // Floor, what could have been seen, stage 10 (next measurement), and what a reader must know.
    let floor = model.floor(&conclusion.accepted, &unsealed.noise, found.left().is_some());
    let document =
        document(&model, &whole, &explained, &conclusion, &faults, &floor, &unsealed, &errors, seed);
    let residuals = residuals(&model, &whole, &conclusion, &unsealed);
    let unsealing = (!sealed.is_empty()).then_some(unsealing);
    let floor_sd = floor.sd;
    Ok(Verification {
        document,
        model,
        whole,
        explained,
        conclusion,
        unsealed,
        floor_sd,
        errors,
        residuals,
        unsealing,
    })
}

/// Predicts every reading under both models; accepted effects that make the unsealed readings worse are withdrawn, and a verdict that they
/// contradict is taken back.
fn last_word<M: SessionModel>(
    model: &M,
    whole: &M,
    explained: &Explained,
    conclusion: &mut Conclusion,
    on_request: bool,
) -> Result<Unsealed<M::Predictions>, TraceError> {
    let found = &explained.found;
    let at = |h: &Hypothesis, noise: &Noise| {
        whole.predict(h, &noise.reading_sd(&whole.noise_inputs())).ok_or(TraceError::NoSolution)
    };
    let mut noise = &explained.noise;
    let before = at(&found.base, noise)?;
    let mut after = at(&conclusion.accepted, noise)?;
    let mut left_out = flagged(whole, &conclusion.accepted, noise);
    let error = |p: &M::Predictions| rmse(&scored(whole, p, &left_out), 0);
    let [low, high] = [error(&before), error(&after)];
    let refuted = || {
        let sd = noise.reading_sd(&whole.noise_inputs());
        let counts = (0..sd.len()).filter(|i| whole.scored()[*i] && !left_out.contains(i));
        let sd: Vec<f64> = counts.map(|i| sd[i] * whole.noise_factor()).collect();
        let of = |p: &M::Predictions| scored(whole, p, &left_out);
        refutation::refuted(&of(&before), &of(&after), &sd)
    };
    let worse =
        high > SEALED_RISE * low && !conclusion.accepted.fit.terms.is_empty() && !on_request && refuted();
    if worse {
        noise = &explained.declared_noise;
        after = at(&found.base, noise)?;
        left_out = flagged(whole, &found.base, noise);
        let p = holdout_p(whole, &found.base, noise, &left_out);
        let unit = whole.quantities()[0].unit;
        let rise = format!("rises from {} to {} {unit}", readable(low), readable(high));
        let contradicted = p.is_some_and(|p| p < HOLDOUT_LEVEL);
        conclusion.withdrawn(&found.base, model.noise_effect(), rise.trim_end(), contradicted);
    }
    if let Some(p) = holdout_p(whole, &conclusion.accepted, noise, &left_out).filter(|p| *p < HOLDOUT_LEVEL) {
        conclusion.contradicted(p, on_request);
    }
    Ok(Unsealed { noise: noise.clone(), before, after, left_out })
}

/// Three decimals, or an exponent where these would hide the number.
fn readable(value: f64) -> String {
    if (0.01..1e6).contains(&value.abs()) { format!("{value:.3}") } else { format!("{value:.3e}") }
}

/// Records of every reading and channel.
fn residuals<M: SessionModel>(
    model: &M,
    whole: &M,
    conclusion: &Conclusion,
    unsealed: &Unsealed<M::Predictions>,
) -> Vec<ResidualRecord> {
    let covariates = whole.covariates();
    let sd = unsealed.noise.reading_sd(&whole.noise_inputs());
    let place = |m: &M, i: usize| {
        let o = m.origin(i);
        (o.source, o.line)
    };
    let flags: Vec<_> = conclusion.accepted.flagged.iter().map(|&i| place(model, i)).collect();
    let fitted: std::collections::BTreeSet<_> =
        (0..model.measured().nrows()).map(|i| place(model, i)).collect();
    let rejected = |i: usize| {
        let own = place(whole, i);
        if flags.contains(&own) || unsealed.left_out.contains(&i) {
            return Some("single reading far outside the noise".to_owned());
        }
        (!whole.sealed()[i] && !fitted.contains(&own))
            .then(|| "left out of the search: too many readings".to_owned())
    };
    (0..sd.len())
        .flat_map(|i| {
            let at = Record {
                reading: i,
                noise_sd: sd[i] * whole.noise_factor(),
                rejected: rejected(i),
                covariates: covariates.iter().map(|(n, v)| (n.clone(), v[i])).collect(),
            };
            whole.records(&unsealed.before, &unsealed.after, &at)
        })
        .collect()
}
