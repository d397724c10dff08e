//! `verify`: the residual loop, one procedure for every kind of session. The stages are those of docs/src/method.md.

use super::acceptance::{Fault, fault, readable};
use super::conclusion::{Conclusion, conclude};
use super::document::document;
use super::held_out::{
    Errors, SharedNoise, Unsealed, cross_validate, fill_from_cross_validation, holdout_errors, scored,
};
use super::holdout_check::{HOLDOUT_LEVEL, flagged, holdout_p};
use super::options::VerifyOptions;
use super::refutation::refuted;
use super::session_model::{FloorStatement, Record, SessionModel};
use crate::error::TraceError;
use crate::method::explain::Explained;
use crate::method::hypothesis::Hypothesis;
use crate::method::noise::Noise;
use crate::method::omnibus::LACK_OF_FIT_LEVEL;
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
    // Twin check: the twin before reality.
    let faults = model.twin_faults();
    // Noise in parts, baseline fit, omnibus test, signatures, screening, refits.
    let (model, explained) = model.explain(options).ok_or(TraceError::NoSolution)?;
    // Competing explanations and adequacy.
    let found = &explained.found;
    let mut conclusion =
        if explained.exact { Conclusion::exact(&found.base) } else { conclude(&model, found, &faults) };
    if asked.is_empty() {
        conclusion.only_supported(&model, found);
    } else {
        conclusion.accept(&model, found, asked)?;
    }
    // The split's seal held until here and is broken once; the unsealed readings have the last word.
    let (rows, unsealing) = sealed.unseal(&options.seal).map_err(TraceError::NoLedger)?;
    let whole = model.whole(rows)?;
    let stage =
        Stage { model: &model, whole: &whole, explained: &explained, on_request: !asked.is_empty(), seed };
    let (unsealed, errors, floor) = stage.apply_holdout(&mut conclusion)?;
    // What could have been seen, the next measurement, and what a reader must know.
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

/// What the last stage works on.
struct Stage<'a, M> {
    model: &'a M,
    whole: &'a M,
    explained: &'a Explained,
    on_request: bool,
    seed: u64,
}

/// Predictions, held-out errors and floor of a conclusion.
type Judged<M> = (Unsealed<<M as SessionModel>::Predictions>, Errors, FloorStatement);

impl<M: SessionModel> Stage<'_, M> {
    /// The held-out readings have the last word: what they or the last rule contradict is taken back.
    fn apply_holdout(&self, conclusion: &mut Conclusion) -> Result<Judged<M>, TraceError> {
        let unit = self.whole.quantities()[0].unit;
        let mut judged = self.judged(conclusion, &self.explained.noise)?;
        let speaks = |conclusion: &Conclusion, judged: &Judged<M>| {
            fault(self.model, &conclusion.accepted, &judged.1, &judged.2, self.shown(&judged.0))
                .filter(|_| conclusion.claims(self.on_request))
        };
        let mut noise = &self.explained.noise;
        let (base, declared) = (&self.explained.found.base, &self.explained.declared_noise);
        if let Some(Fault::Worse([low, high])) = speaks(conclusion, &judged)
            && !self.on_request
            && !self.by_sealed(base, declared)
        {
            // Where the sealed readings contradict both models, which of them is further off says nothing.
            noise = declared;
            let rise = format!("rises from {} to {} {unit}", readable(low), readable(high));
            conclusion.withdrawn(base, self.model.noise_effect(), rise.trim_end(), self.left_by(base));
            judged = self.judged(conclusion, noise)?;
        }
        let p = holdout_p(self.whole, &conclusion.accepted, noise, &judged.0.left_out);
        if let Some(p) = p.filter(|p| *p < HOLDOUT_LEVEL) {
            conclusion.contradicted(p, self.on_request);
        }
        if let Some(fault) = speaks(conclusion, &judged) {
            conclusion.not_accepted(&fault.sentence(unit));
        }
        Ok(judged)
    }

    /// The declared model leaves something that is no noise, by its own tests or its repeats.
    fn left_by(&self, base: &Hypothesis) -> bool {
        let by_repeats = self.model.lack_of_fit(base).is_some_and(|(l, _)| l.p_value < LACK_OF_FIT_LEVEL);
        self.explained.found.first_test.generic() || by_repeats
    }

    /// The sealed readings contradict `h`.
    fn by_sealed(&self, h: &Hypothesis, noise: &Noise) -> bool {
        let left_out = flagged(self.whole, h, noise);
        holdout_p(self.whole, h, noise, &left_out).is_some_and(|p| p < HOLDOUT_LEVEL)
    }

    /// A rise of the error is beyond chance: sealed readings must be able to show it; errors left out in turn are taken as they are.
    fn shown(&self, unsealed: &Unsealed<M::Predictions>) -> bool {
        let whole = self.whole;
        if !whole.scored().contains(&true) {
            return true;
        }
        let sd = unsealed.noise.reading_sd(&whole.noise_inputs());
        let counts = (0..sd.len()).filter(|i| whole.scored()[*i] && !unsealed.left_out.contains(i));
        let sd: Vec<f64> = counts.map(|i| sd[i] * whole.noise_factor()).collect();
        let of = |p: &M::Predictions| scored(whole, p, &unsealed.left_out);
        refuted(&of(&unsealed.before), &of(&unsealed.after), &sd)
    }

    /// Predicts every reading under both models, and states errors and floor.
    fn judged(&self, conclusion: &Conclusion, noise: &Noise) -> Result<Judged<M>, TraceError> {
        let (model, whole, found) = (self.model, self.whole, &self.explained.found);
        let at = |h: &Hypothesis| {
            whole.predict(h, &noise.reading_sd(&whole.noise_inputs())).ok_or(TraceError::NoSolution)
        };
        let unsealed = Unsealed {
            noise: noise.clone(),
            before: at(&found.base)?,
            after: at(&conclusion.accepted)?,
            left_out: flagged(whole, &conclusion.accepted, noise),
        };
        let in_turn = || cross_validate(model, found, conclusion, &unsealed, self.on_request, self.seed);
        let errors = if whole.scored().contains(&true) {
            let errors =
                fill_from_cross_validation(model, holdout_errors(whole, &unsealed, self.seed), in_turn);
            Errors { shared: Some(shared_noise(whole, &unsealed)), ..errors }
        } else {
            in_turn()
        };
        let floor = model.floor(&conclusion.accepted, noise, found.left().is_some());
        Ok((unsealed, errors, floor))
    }
}

/// Readings of which the covariance is taken at most: it is dense.
const MAX_DENSE: usize = 500;

/// What the unsealed readings share by the noise: those that share it say less than they are.
fn shared_noise<M: SessionModel>(whole: &M, unsealed: &Unsealed<M::Predictions>) -> SharedNoise {
    let counts = |i: &usize| whole.scored()[*i] && !unsealed.left_out.contains(i);
    let rows: Vec<usize> = (0..whole.scored().len()).filter(counts).collect();
    let step = rows.len().div_ceil(MAX_DENSE).max(1);
    let rows: Vec<usize> = rows.into_iter().step_by(step).collect();
    let covariance = |upper: bool| unsealed.noise.weights_of(&whole.noise_inputs(), upper).covariance(&rows);
    let (c, estimated) = (covariance(true), covariance(false));
    SharedNoise {
        independent: c.trace().powi(2) / c.norm_squared(),
        widening: (c.trace() / estimated.trace()).max(1.0).sqrt(),
    }
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
