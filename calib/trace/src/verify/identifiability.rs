//! What each accepted effect is worth.

use super::error_summary::rmse;
use super::held_out::scored;
use super::session_model::SessionModel;
use crate::method::hypothesis::{Hypothesis, SearchResult};
use crate::method::noise::Noise;
use wcal_core::verify_document::EffectAblation;

/// What the fit and the held-out readings lose without each accepted effect, the others refitted.
pub fn left_out<M: SessionModel>(
    model: &M,
    whole: &M,
    found: &SearchResult,
    accepted: &Hypothesis,
    noise: &Noise,
    left_out: &[usize],
) -> Vec<EffectAblation> {
    let mut effects: Vec<usize> = accepted.fit.terms.iter().map(|t| t.effect).collect();
    effects.dedup();
    let sealed = whole.scored().contains(&true);
    let sd = noise.reading_sd(&whole.noise_inputs());
    let held_out = |h: &Hypothesis| {
        let predictions = whole.predict(h, &sd).filter(|_| sealed)?;
        Some(rmse(&scored(whole, &predictions, left_out), 0)).filter(|e| e.is_finite())
    };
    let with = held_out(accepted);
    effects
        .into_iter()
        .filter_map(|effect| {
            let without = accepted.without(model, |_, t| t.effect == effect, 15)?;
            Some(EffectAblation {
                id: model.catalogue()[effect].id.to_owned(),
                misfit_ratio: (without.fit.ssr / accepted.fit.ssr).sqrt(),
                p_value: without.removal_p(&accepted.fit, &found.first_test.family),
                held_out: with,
                held_out_without: held_out(&without),
            })
        })
        .collect()
}
