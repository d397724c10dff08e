//! The decision: verdict, model, calibration and every claim that the sealed readings will be held against. It is complete before they come out.

use super::acceptance::{self, Unfit};
use super::conclusion::{Conclusion, Facts, Withdrawn};
use super::evidence::Explained;
use super::held_out::{LeftOut, cross_validate};
use super::session_model::{FloorStatement, SessionModel};
use super::support::supported;
use super::witness::{self, Witness};
use crate::error::TraceError;
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use crate::method::noise::Noise;
use crate::verify::options::VerifyRequest;
use serde_json::{Value, json};
use wcal_core::Decide;
use wcal_core::verify_document::{EffectAblation, TwinFault};

/// What was decided on the open readings. Its parts can be read, not changed.
pub struct Decision<M: SessionModel> {
    pub(super) model: M,
    pub(super) explained: Explained,
    pub(super) faults: Vec<TwinFault>,
    pub(super) conclusion: Conclusion,
    pub(super) noise: Noise,
    pub(super) floor: FloorStatement,
    pub(super) left_out: LeftOut,
    pub(super) ablations: Vec<EffectAblation>,
    pub(super) calibration: M::Calibration,
    pub(super) claims: Vec<String>,
    pub(super) seed: u64,
}

impl<M: SessionModel> Decision<M> {
    /// The model at the open readings, as the noise made it.
    pub fn model(&self) -> &M {
        &self.model
    }

    /// What the search found, and its noise.
    pub fn explained(&self) -> &Explained {
        &self.explained
    }

    /// The same by value.
    pub fn into_explained(self) -> Explained {
        self.explained
    }

    /// The verdict in parts.
    pub fn conclusion(&self) -> &Conclusion {
        &self.conclusion
    }

    /// Noise of the accepted model.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// Errors of open readings that were left out in turn.
    pub fn left_out(&self) -> &LeftOut {
        &self.left_out
    }

    /// The accepted model as a calibration keeps it.
    pub fn calibration(&self) -> &M::Calibration {
        &self.calibration
    }
}

/// Decides on the open readings alone.
///
/// # Errors
/// Where no surviving explanation has the effects that are to be accepted.
pub fn decide<M: SessionModel>(
    model: M,
    mut explained: Explained,
    witnesses: &[&dyn Witness<M>],
    request: &VerifyRequest,
) -> Result<Decision<M>, TraceError> {
    let seed = request.search.seed;
    let faults = model.twin_faults();
    let facts = Facts::of(&model, &explained, &faults);
    // What is accepted: what was asked for, else what the data support term by term.
    let asked = facts.asked(&request.accept)?.cloned();
    let on_request = asked.is_some();
    let mut accepted = match asked {
        Some(chosen) => chosen,
        None if facts.is_ambiguous() => facts.accepted().clone(),
        None => supported(&model, &explained.found, facts.accepted()),
    };
    // What raises the error of readings that are left out in turn is no explanation of them.
    let (found, mut noise) = (&explained.found, &explained.noise);
    let mut left_out = cross_validate(&model, found, &accepted, noise, on_request, seed);
    let rise = left_out.rise(&model).filter(|_| !accepted.fit.terms.is_empty() && !on_request);
    let withdrawn = rise.filter(|_| facts.asserts(&accepted, on_request)).map(|errors| Withdrawn {
        names: facts.effects(&accepted).into_iter().map(|e| e.id).collect(),
        errors,
    });
    if withdrawn.is_some() {
        (accepted, noise) = (found.base.clone(), &explained.declared_noise);
        left_out = cross_validate(&model, found, &accepted, noise, on_request, seed);
    }
    let floor = model.floor(&accepted, noise, found.left().is_some());
    let mut tests = explained.tests.clone();
    let mut refuted = None;
    for witness in witnesses {
        let test = witness::test(*witness, &model, &accepted, &mut tests)?;
        refuted = refuted.or(test.filter(|t| t.refuted).map(|t| Unfit::Useless(t.sentence)));
    }
    let unfit = match model.useless(&accepted) {
        Some(why) => Some(Unfit::Useless(why)),
        None => refuted.or_else(|| acceptance::far_above_floor(&model, &accepted, &left_out.errors, &floor)),
    };
    let conclusion = facts.conclude(accepted, on_request, withdrawn, unfit);
    let ablations = left_out.ablations(&model, found, &conclusion.accepted, noise);
    let calibration = model.calibration(&found.base, &conclusion.accepted, noise, floor.sd, seed);
    let (noise, claims) = (noise.clone(), request.claims.clone());
    explained.tests = tests;
    Ok(Decision {
        model,
        explained,
        faults,
        conclusion,
        noise,
        floor,
        left_out,
        ablations,
        calibration,
        claims,
        seed,
    })
}

/// Steps of a number within its standard error: closer numbers are the same decision.
const STEPS: f64 = 100.0;
/// Significant digits of a number that states no error.
const DIGITS: f64 = 1e4;

/// `value` in steps of a hundredth of its standard error.
fn rounded(value: f64, sd: f64) -> Value {
    let step = if sd > 0.0 && sd.is_finite() { sd / STEPS } else { value.abs() / DIGITS };
    if step > 0.0 { json!((value / step).round()) } else { json!(0.0) }
}

impl<M: SessionModel> Decision<M> {
    fn of_hypothesis(&self, h: &Hypothesis) -> Value {
        let spread = covariance(&h.fit, h.fit.variance());
        let sd = |slot: usize| if slot < spread.nrows() { spread[(slot, slot)].max(0.0).sqrt() } else { 0.0 };
        // Slots of the covariance: coefficients channel by channel, then the nonlinear values.
        let coefficients = h.fit.coefficients.iter().enumerate().map(|(slot, b)| rounded(*b, sd(slot)));
        let first = h.fit.coefficients.len();
        let values = h.fit.terms.iter().flat_map(|t| &t.values).enumerate();
        let values = values.map(|(k, v)| rounded(*v, sd(first + k)));
        let law = |t: &crate::EffectTerm| {
            let effect = &self.model.catalogue()[t.effect];
            (effect.id.to_owned(), effect.law(t.law).name.to_owned())
        };
        let flagged = h.flagged.iter().map(|&i| self.model.origin(i)).map(|o| (o.source, o.point));
        json!({
            "terms": h.fit.terms.iter().map(law).collect::<Vec<_>>(),
            "coefficients": coefficients.collect::<Vec<_>>(),
            "values": values.collect::<Vec<_>>(),
            "flagged": flagged.collect::<Vec<_>>(),
        })
    }
}

impl<M: SessionModel> Decide for Decision<M> {
    fn content(&self) -> Value {
        let repeat = self.noise.repeat;
        json!({
            "kind": self.model.kind(),
            "verdict": self.conclusion.verdict,
            "declared": self.of_hypothesis(&self.explained.found.base),
            "accepted": self.of_hypothesis(&self.conclusion.accepted),
            "noise": rounded(repeat.value, (repeat.interval95[1] - repeat.interval95[0]) / 4.0),
            "quantities": self.model.quantities().iter().map(|q| q.key).collect::<Vec<_>>(),
            "claims": self.claims,
        })
    }
}
