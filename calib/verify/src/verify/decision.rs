//! The decision: verdict, model, calibration and every claim that the sealed readings will be held
//! against. It is complete before they come out.

use super::acceptance::{Unfit, far_above_floor};
use super::conclusion::{Conclusion, Facts};
use super::cross_validate::Validated;
use super::explained::Explained;
use super::left_out::{FoldCalibrations, LeftOut, declared_calibration};
use super::request::VerifyRequest;
use super::session_model::{FloorStatement, SessionModel};
use super::witness::{self, Witness};
use crate::error::VerifyError;
use crate::levels::ABOVE_FLOOR;
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use crate::method::noise::tails::Tails;
use crate::method::noise::{Noise, SpreadModel};
use crate::method::smooth_rival::smooth_rival;
use serde_json::{Value, json};
use wcal_core::Decide;
use wcal_core::text::number;
use wcal_core::verify_document::{EffectAblation, EffectParameter, NoisePart};

/// What was decided on the open readings. Its parts can be read, not changed.
pub struct Decision<M: SessionModel> {
    pub(super) of: Validated<M>,
    pub(super) conclusion: Conclusion,
    pub(super) floor: FloorStatement,
    pub(super) ablations: Vec<EffectAblation>,
    pub(super) calibration: M::Calibration,
    predicting: Noise,
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
        let models = [&self.explained().found.base, &self.conclusion.accepted];
        declared_calibration(&self.of.model, models, &self.predicting, self.floor.sd)
    }

    /// The declared and the chosen model of each fold as calibrations, which know nothing of the
    /// readings that the fold leaves out.
    pub fn fold_calibrations(&self) -> Vec<FoldCalibrations<'_, M>>
    where
        M::Calibration: Send,
    {
        let left = self.explained().found.failed_adequacy_test().is_some();
        self.of.left_out.calibrations(&self.of.model, left)
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
pub(crate) fn decide<M: SessionModel>(
    mut of: Validated<M>,
    witnesses: &[&dyn Witness<M>],
    request: &VerifyRequest,
) -> Result<Decision<M>, VerifyError> {
    let (seed, claims) = (request.search.seed, request.claims.clone());
    let floor = of.model.floor(
        &of.accepted,
        &of.noise,
        of.explained.found.failed_adequacy_test().is_some(),
    );
    let mut unfit = of.model.unusable_reason(&of.accepted).map(Unfit::Unusable);
    for witness in witnesses {
        let test = witness::test(*witness, &of.model, &of.accepted, &mut of.explained.tests)?;
        unfit = unfit.or(test
            .filter(|t| t.refuted)
            .map(|t| Unfit::Unusable(t.sentence)));
    }
    let Validated {
        model,
        explained,
        faults,
        accepted,
        on_request,
        withdrawn,
        noise,
        left_out,
    } = &of;
    let unfit =
        unfit.or_else(|| far_above_floor(model, accepted, &left_out.errors, &floor, ABOVE_FLOOR));
    let rival =
        || smooth_rival(model, accepted, noise, &left_out.split.fold, seed).map(Unfit::Predictable);
    // Rounding is a function of the place, and what an accepted effect leaves that is not quite of
    // its law is said.
    let left = &explained.found.last_test;
    let is_said =
        left.is_rounding || (left.rejected() && model.residual_explained(&explained.found));
    let unfit = unfit.or_else(|| {
        if explained.exact || is_said {
            None
        } else {
            rival()
        }
    });
    // A name that something without physics outdoes is no explanation.
    let outdone = || {
        let driver = explained
            .found
            .outdone_by(model, accepted, &request.search)?;
        Some(Unfit::Outdone(driver.to_owned()))
    };
    let named = !explained.exact && !accepted.fit.terms.is_empty() && !on_request;
    let unfit = unfit.or_else(|| if named { outdone() } else { None });
    let facts = Facts::of(model, explained, faults);
    let conclusion = facts.conclude(accepted.clone(), *on_request, withdrawn.as_ref(), unfit);
    let ablations = left_out.ablations(model, &explained.found, accepted);
    let predicting = model
        .prediction_noise(accepted, seed)
        .unwrap_or_else(|| noise.clone());
    let calibration = model.calibration(&explained.found.base, accepted, &predicting, floor.sd);
    Ok(Decision {
        conclusion,
        floor,
        ablations,
        calibration,
        predicting,
        claims,
        seed,
        of,
    })
}

/// Steps of a number within its standard error: closer numbers are the same decision.
const STEPS: f64 = 100.0;
/// Significant digits of a number that states no error.
const DIGITS: usize = 4;

/// `value` in steps of a hundredth of its standard error.
fn round_to_error(value: f64, sd: f64) -> Value {
    // Last digits depend on the machine and on the order of the rows; the hash must not.
    let stated = sd > 0.0 && sd.is_finite();
    if stated {
        json!((value * STEPS / sd).round())
    } else {
        json!(number(value, DIGITS))
    }
}

/// The noise that sealed readings are judged by. Every part is named: one that is added to
/// [`Noise`] must be added here.
fn of_noise(noise: &Noise) -> Value {
    let Noise {
        weights: _,
        repeat,
        pose,
        correlated,
        law,
        common,
        tails,
        step,
    } = noise;
    // A 95 % interval is about four standard deviations wide.
    let rounded = |value: f64, [low, high]: [f64; 2]| round_to_error(value, (high - low) / 4.0);
    let part = |e: &NoisePart| [e.value, e.interval95[1]].map(|value| rounded(value, e.interval95));
    // What states no error is known to a hundredth at best.
    let coarse = |value: f64| round_to_error(value.ln(), 1.0);
    json!({
        "repeat": part(repeat),
        "pose": pose.as_ref().map(part),
        "correlated": correlated.as_ref().map(|(e, tau)| json!([part(e), coarse(*tau)])),
        "law": law.as_ref().map(|SpreadModel { follows, spread, typical }| {
            json!([follows, rounded(spread.exponent, spread.interval95), round_to_error(*typical, 0.0)])
        }),
        "common": round_to_error(*common, 0.0),
        "tails": tails.as_ref().map(|Tails { dof, heaviest, interval95, scale, heaviest_scale, heavy, by_one }| {
            json!([dof, heaviest, interval95, coarse(*scale), coarse(*heaviest_scale), heavy, by_one])
        }),
        "step": step.iter().map(|step| step.map(|step| round_to_error(step, 0.0))).collect::<Vec<_>>(),
    })
}

impl<M: SessionModel> Decision<M> {
    fn of_hypothesis(&self, h: &Hypothesis) -> Value {
        let spread = covariance(&h.fit, h.fit.variance());
        let sd = |slot: usize| {
            if slot < spread.nrows() {
                spread[(slot, slot)].max(0.0).sqrt()
            } else {
                0.0
            }
        };
        // Slots of the covariance: coefficients channel by channel, then the nonlinear values.
        let coefficients = h
            .fit
            .coefficients
            .iter()
            .enumerate()
            .map(|(slot, b)| round_to_error(*b, sd(slot)));
        let first = h.fit.coefficients.len();
        let values = h.fit.terms.iter().flat_map(|t| &t.values).enumerate();
        let values = values.map(|(k, v)| round_to_error(*v, sd(first + k)));
        let law = |t: &crate::EffectTerm| {
            let effect = &self.of.model.catalogue()[t.effect];
            (effect.id.to_owned(), effect.law(t.law).name.to_owned())
        };
        let flagged = h
            .flagged
            .iter()
            .map(|&i| self.of.model.origin(i))
            .map(|o| (o.source, o.point));
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
        let spread = self.of.model.noise_effect().map(|named| {
            let sd = |p: &EffectParameter| (p.interval95[1] - p.interval95[0]) / 4.0;
            let values = named
                .parameters
                .iter()
                .map(|p| round_to_error(p.value, sd(p)));
            json!([named.laws, values.collect::<Vec<_>>()])
        });
        json!({
            "kind": self.of.model.kind(),
            "verdict": self.conclusion.verdict,
            "declared": self.of_hypothesis(&self.of.explained.found.base),
            "accepted": self.of_hypothesis(&self.conclusion.accepted),
            "noise": of_noise(&self.of.noise),
            "spread": spread,
            "floor": json!([round_to_error(self.floor.sd, 0.0), self.floor.dof.map(f64::round)]),
            "quantities": self.of.model.quantities().iter().map(|q| q.key).collect::<Vec<_>>(),
            "claims": self.claims,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::noise::spread::{Spread, SpreadLaw};

    #[test]
    fn whatever_part_of_the_noise_changes_the_decision_changes() {
        let part = |value: f64| NoisePart {
            value,
            interval95: [0.8 * value, 1.2 * value],
        };
        let tails = Tails {
            dof: 5.0,
            heaviest: 4.0,
            interval95: [4.0, f64::INFINITY],
            scale: 1.0,
            heaviest_scale: 0.9,
            heavy: false,
            by_one: false,
        };
        let law = |exponent: f64| SpreadModel {
            follows: "t_s".to_owned(),
            spread: Spread {
                p_value: 0.001,
                correlation: 0.5,
                law: SpreadLaw::Exponential,
                exponent,
                interval95: [exponent - 0.2, exponent + 0.2],
                relative_sd: Vec::new(),
            },
            typical: 2.0,
        };
        let whole = Noise {
            repeat: part(1.0),
            pose: Some(part(0.5)),
            correlated: Some((part(0.7), 60.0)),
            law: Some(law(0.5)),
            common: 0.25,
            tails: Some(tails),
            step: vec![Some(0.01), None],
            ..Noise::none(4)
        };
        let changes: [fn(&mut Noise); 10] = [
            |n| n.repeat.value = 1.1,
            |n| n.repeat.interval95[1] = 1.5,
            |n| n.pose = None,
            |n| n.correlated = None,
            |n| n.correlated.as_mut().unwrap().1 = 90.0,
            |n| n.law.as_mut().unwrap().spread.exponent = 0.7,
            |n| n.common = 0.5,
            |n| n.tails.as_mut().unwrap().heaviest = 3.0,
            |n| n.tails.as_mut().unwrap().heavy = true,
            |n| n.step[0] = Some(0.1),
        ];
        for (k, change) in changes.into_iter().enumerate() {
            let mut other = whole.clone();
            change(&mut other);
            assert_ne!(of_noise(&whole), of_noise(&other), "{k}");
        }
        // Negative control: the same outcome on another machine.
        let mut same = whole.clone();
        same.repeat.value += 1e-9;
        same.correlated.as_mut().unwrap().1 += 1e-7;
        assert_eq!(of_noise(&whole), of_noise(&same));
    }
}
