//! The decision: verdict, model, calibration and every claim that the sealed readings will be held against. It is complete before they come out.

use super::acceptance::{Unfit, far_above_floor};
use super::conclusion::{Conclusion, Facts};
use super::cross_validate::Validated;
use super::explained::Explained;
use super::left_out::LeftOut;
use super::request::VerifyRequest;
use super::session_model::{FloorStatement, SessionModel};
use super::witness::{self, Witness};
use crate::error::TraceError;
use crate::levels::ABOVE_FLOOR;
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use serde_json::{Value, json};
use wcal_core::Decide;
use wcal_core::verify_document::EffectAblation;

/// What was decided on the open readings. Its parts can be read, not changed.
pub struct Decision<M: SessionModel> {
    pub(super) of: Validated<M>,
    pub(super) conclusion: Conclusion,
    pub(super) floor: FloorStatement,
    pub(super) ablations: Vec<EffectAblation>,
    pub(super) calibration: M::Calibration,
    pub(super) claims: Vec<String>,
    pub(super) seed: u64,
}

impl<M: SessionModel> Decision<M> {
    /// The model at the open readings, as the noise made it.
    pub fn model(&self) -> &M {
        &self.of.model
    }

    /// What the search found, and its noise.
    pub fn explained(&self) -> &Explained {
        &self.of.explained
    }

    /// The verdict in parts.
    pub fn conclusion(&self) -> &Conclusion {
        &self.conclusion
    }

    /// Errors of open readings that were left out in turn.
    pub fn left_out(&self) -> &LeftOut<M> {
        &self.of.left_out
    }

    /// The declared model as a calibration would keep it: what a user without the effects has.
    pub fn declared_calibration(&self) -> M::Calibration {
        let Explained { found, declared_noise, .. } = self.explained();
        self.of.model.calibration(&found.base, &found.base, declared_noise, self.floor.sd, self.seed)
    }

    /// The accepted model as a calibration keeps it.
    pub fn calibration(&self) -> &M::Calibration {
        &self.calibration
    }
}

/// Decides on the open readings alone.
///
/// # Errors
/// Where a witness cannot use its data.
pub fn decide<M: SessionModel>(
    mut of: Validated<M>,
    witnesses: &[&dyn Witness<M>],
    request: &VerifyRequest,
) -> Result<Decision<M>, TraceError> {
    let (seed, claims) = (request.search.seed, request.claims.clone());
    let floor = of.model.floor(&of.accepted, &of.noise, of.explained.found.failed_adequacy_test().is_some());
    let mut unfit = of.model.unusable_reason(&of.accepted).map(Unfit::Unusable);
    for witness in witnesses {
        let test = witness::test(*witness, &of.model, &of.accepted, &mut of.explained.tests)?;
        unfit = unfit.or(test.filter(|t| t.refuted).map(|t| Unfit::Unusable(t.sentence)));
    }
    let Validated { model, explained, faults, accepted, on_request, withdrawn, noise, left_out } = &of;
    let unfit = unfit.or_else(|| far_above_floor(model, accepted, &left_out.errors, &floor, ABOVE_FLOOR));
    let facts = Facts::of(model, explained, faults);
    let conclusion = facts.conclude(accepted.clone(), *on_request, withdrawn.as_ref(), unfit);
    let ablations = left_out.ablations(model, &explained.found, accepted);
    let calibration = model.calibration(&explained.found.base, accepted, noise, floor.sd, seed);
    Ok(Decision { conclusion, floor, ablations, calibration, claims, seed, of })
}

/// Steps of a number within its standard error: closer numbers are the same decision.
const STEPS: f64 = 100.0;
/// Significant digits of a number that states no error.
const DIGITS: f64 = 1e4;

/// `value` in steps of a hundredth of its standard error.
fn round_to_error(value: f64, sd: f64) -> Value {
    let step = if sd > 0.0 && sd.is_finite() { sd / STEPS } else { value.abs() / DIGITS };
    if step > 0.0 { json!((value / step).round()) } else { json!(0.0) }
}

impl<M: SessionModel> Decision<M> {
    fn of_hypothesis(&self, h: &Hypothesis) -> Value {
        let spread = covariance(&h.fit, h.fit.variance());
        let sd = |slot: usize| if slot < spread.nrows() { spread[(slot, slot)].max(0.0).sqrt() } else { 0.0 };
        // Slots of the covariance: coefficients channel by channel, then the nonlinear values.
        let coefficients =
            h.fit.coefficients.iter().enumerate().map(|(slot, b)| round_to_error(*b, sd(slot)));
        let first = h.fit.coefficients.len();
        let values = h.fit.terms.iter().flat_map(|t| &t.values).enumerate();
        let values = values.map(|(k, v)| round_to_error(*v, sd(first + k)));
        let law = |t: &crate::EffectTerm| {
            let effect = &self.of.model.catalogue()[t.effect];
            (effect.id.to_owned(), effect.law(t.law).name.to_owned())
        };
        let flagged = h.flagged.iter().map(|&i| self.of.model.origin(i)).map(|o| (o.source, o.point));
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
        let repeat = self.of.noise.repeat;
        json!({
            "kind": self.of.model.kind(),
            "verdict": self.conclusion.verdict,
            "declared": self.of_hypothesis(&self.of.explained.found.base),
            "accepted": self.of_hypothesis(&self.conclusion.accepted),
            "noise": round_to_error(repeat.value, (repeat.interval95[1] - repeat.interval95[0]) / 4.0),
            "quantities": self.of.model.quantities().iter().map(|q| q.key).collect::<Vec<_>>(),
            "claims": self.claims,
        })
    }
}
