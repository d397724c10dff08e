//! An accepted effect by a richer law of it, where the plain one leaves something: two time
//! constants, a stack of plays.

use super::fit::{Status, fit};
use super::hypothesis::Hypothesis;
use super::min_p::f_test;
use crate::effect::{EffectModel, EffectTerm, Role};
use crate::levels::CATALOGUE;
use crate::measurement_model::MeasurementModel;

/// Refits `terms` from each start and keeps the best physical one (else the best).
pub(super) fn refit(
    system: &dyn MeasurementModel,
    starts: &[Vec<EffectTerm>],
    from: &Hypothesis,
) -> Option<Hypothesis> {
    let mut best: Option<Hypothesis> = None;
    for terms in starts {
        let Some(fit) = fit(system, terms, &from.weights, 10) else {
            continue;
        };
        let next = Hypothesis {
            fit,
            ..from.clone()
        };
        let better = best.as_ref().is_none_or(|b| {
            let (was, is) = (b.is_physical(system), next.is_physical(system));
            // A law with more parameters must earn them.
            let price = 2.0 * next.fit.variance();
            let cost =
                |h: &Hypothesis| h.fit.ssr + price * (h.fit.residual.len() as f64 - h.fit.dof);
            (is && !was) || (is == was && cost(&next) < cost(b))
        });
        if better {
            best = Some(next);
        }
    }
    best.map(|h| continue_to_convergence(system, h))
}

/// Steps more for a fit that was still falling.
const MORE_STEPS: usize = 40;

/// Goes on with a fit that did not converge.
pub(super) fn continue_to_convergence(system: &dyn MeasurementModel, h: Hypothesis) -> Hypothesis {
    if h.fit.status != Status::NotConverged {
        return h;
    }
    match fit(system, &h.fit.terms, &h.weights, MORE_STEPS) {
        Some(fit) => Hypothesis { fit, ..h },
        None => h,
    }
}

/// Explanations of a size that are refined: the best and its nearest rivals, so that none is judged
/// by a law that is too plain.
const REFINED: usize = 3;

/// Refines the best explanations of a size where the data ask for it; true where the first of them,
/// then sorted again, is another.
pub(super) fn refine_level(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    level: &mut [Hypothesis],
) -> bool {
    let mut changed = false;
    for h in level.iter_mut().take(REFINED) {
        while let Some(more) = add_column(system, h) {
            *h = more;
            changed = true;
        }
        if let Some(refined) = refine(system, base, h) {
            *h = refined;
            changed = true;
        }
    }
    if changed {
        let scale = level
            .iter()
            .map(|h| h.fit.variance())
            .fold(f64::INFINITY, f64::min);
        level.sort_by(|a, b| a.aic(&base.fit, scale).total_cmp(&b.aic(&base.fit, scale)));
    }
    changed
}

/// One more column of an effect that follows columns and is accepted: loads of a cell that are
/// applied in turn are one question, however many there are.
fn add_column(system: &dyn MeasurementModel, from: &Hypothesis) -> Option<Hypothesis> {
    let terms = &from.fit.terms;
    let effect = terms
        .iter()
        .find(|t| system.catalogue()[t.effect].by_column)?
        .effect;
    let taken = |law: usize| terms.iter().any(|t| t.effect == effect && t.law == law);
    let free = (0..system.catalogue()[effect].laws.len()).filter(|law| !taken(*law));
    let with = |law: usize| {
        let more = EffectTerm {
            effect,
            law,
            values: Vec::new(),
        };
        refit(
            system,
            &[terms.iter().cloned().chain([more]).collect()],
            from,
        )
    };
    let tried: Vec<Hypothesis> = free.filter_map(with).collect();
    let count = tried.len() as f64;
    let allowed = tried
        .into_iter()
        .filter(|h| h.is_admissible(system) && system.not_identified(h).is_none());
    let tested = allowed.filter_map(|h| {
        Some((
            f_test(from.fit.ssr - h.fit.ssr, from.fit.ssr, from.fit.dof, 1)?,
            h,
        ))
    });
    let best = tested.min_by(|a, b| a.0.total_cmp(&b.0));
    // Bonferroni over the columns that were tried.
    best.filter(|(p, _)| p * count < CATALOGUE).map(|(_, h)| h)
}

/// The best refinement of one of its terms, where it is physical and earns its parameters (F test
/// over all that were tried).
fn refine(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    from: &Hypothesis,
) -> Option<Hypothesis> {
    let mut tried = 0;
    let mut best: Option<(f64, Hypothesis)> = None;
    for (slot, term) in from.fit.terms.iter().enumerate() {
        let effect = &system.catalogue()[term.effect];
        let plain = effect.laws.len();
        if term.law >= plain {
            continue;
        }
        for (k, law) in effect.refinements.iter().enumerate() {
            let starts: Vec<Vec<EffectTerm>> = starts(law, term)
                .into_iter()
                .map(|values| {
                    let mut terms = from.fit.terms.clone();
                    terms[slot] = EffectTerm {
                        effect: term.effect,
                        law: plain + k,
                        values,
                    };
                    terms
                })
                .collect();
            tried += 1;
            let Some(to) = refit(system, &starts, from).filter(|h| h.is_admissible(system)) else {
                continue;
            };
            let extra = (to.parameters(&base.fit) - from.parameters(&base.fit)).max(1.0);
            let p = f_test(
                from.fit.ssr - to.fit.ssr,
                from.fit.ssr,
                from.fit.dof,
                extra as usize,
            );
            if let Some(p) = p.filter(|p| best.as_ref().is_none_or(|(least, _)| p < least)) {
                best = Some((p, to));
            }
        }
    }
    // Bonferroni over the laws that were tried.
    best.filter(|(p, _)| p * f64::from(tried) < CATALOGUE)
        .map(|(_, h)| h)
}

/// Places to start from: the amplitude shared out, shapes from their grids in rising order.
fn starts(law: &EffectModel, term: &EffectTerm) -> Vec<Vec<f64>> {
    let amplitudes = law
        .parameters
        .iter()
        .filter(|p| matches!(p.role, Role::Amplitude { .. }))
        .count();
    let share = term
        .values
        .first()
        .map_or(0.0, |size| size / amplitudes.max(1) as f64);
    let mut all: Vec<Vec<f64>> = vec![Vec::new()];
    let mut highest: Vec<f64> = vec![f64::NEG_INFINITY];
    for p in &law.parameters {
        let (mut next, mut next_highest) = (Vec::new(), Vec::new());
        for (values, high) in all.iter().zip(&highest) {
            let choices: Vec<f64> = match p.role {
                Role::Amplitude { .. } => vec![share],
                // Two elements of one law can change places: rising shapes are each pair once.
                Role::Shape { grid } => grid.iter().copied().filter(|g| g > high).collect(),
            };
            for choice in choices {
                let shape = matches!(p.role, Role::Shape { .. });
                next.push(values.iter().copied().chain([choice]).collect());
                next_highest.push(if shape { choice } else { *high });
            }
        }
        (all, highest) = (next, next_highest);
    }
    all
}
