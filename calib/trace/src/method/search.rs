//! From a rejected omnibus test to explanations: screen, refit, add, compare. At most three effects, smallest set that passes the omnibus test first.

use super::ambiguity::compared;
use super::fit::{Fit, Weights, fit};
use super::hypothesis::{AMBIGUITY_LEVEL, Evidence, Hypothesis, NotIdentified, SearchResult};
use super::inference::not_told;
use super::min_p::f_test;
use super::omnibus::{CATALOGUE_LEVEL, OmnibusTest, omnibus_test};
use super::options::Options;
use super::outliers::{initial_outliers, reject_outliers};
use super::refine::{refine_level, refit, settle};
use super::signature::{Signature, nuisance, signatures_of_catalogue};
use super::subsets::best_subsets;
use crate::effect::{EffectTerm, TermKey};
use crate::measurement_model::MeasurementModel;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Refits tried at each size.
const REFITS: usize = 7;

fn outlier_index(system: &dyn MeasurementModel) -> Option<usize> {
    system.outliers().filter(|&e| system.not_observable(e).is_none())
}

/// Explanations with one term more than `from`: the best laws of each key refitted, and outliers removed.
fn extend(system: &dyn MeasurementModel, from: &Hypothesis, signatures: &[Signature]) -> Vec<Hypothesis> {
    let residual = from.fit.stacked();
    let gains: Vec<f64> = signatures.iter().map(|a| a.gain(&residual)).collect();
    let mut best_of: BTreeMap<TermKey, f64> = BTreeMap::new();
    for (signature, gain) in signatures.iter().zip(&gains) {
        let best = best_of.entry(signature.term.key(system.catalogue())).or_insert(0.0);
        *best = best.max(*gain);
    }
    let mut ranked: Vec<(TermKey, f64)> =
        best_of.into_iter().filter(|b| b.1 > 4.0 * from.fit.variance().min(1.0e300)).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
    ranked.truncate(REFITS);
    let mut out: Vec<Hypothesis> = ranked
        .par_iter()
        .flat_map_iter(|&(key, top)| {
            let laws = &system.catalogue()[key.effect].laws;
            // Laws are rivals of their own; within a law the best point of the grid starts the refit.
            let starts: Vec<Vec<EffectTerm>> = (0..laws.len())
                .filter_map(|l| {
                    let best = (0..gains.len())
                        .filter(|&i| signatures[i].term.law == l)
                        .filter(|&i| signatures[i].term.key(system.catalogue()) == key)
                        .max_by(|&a, &b| gains[a].total_cmp(&gains[b]))?;
                    (gains[best] > 0.5 * top).then(|| {
                        let mut terms = from.fit.terms.clone();
                        terms.push(signatures[best].start(&residual, &laws[l]));
                        terms
                    })
                })
                .collect();
            refit(system, &starts, from)
        })
        .collect();
    let single = outlier_index(system).filter(|_| from.flagged.is_empty());
    out.extend(single.and_then(|_| reject_outliers(system, &from.fit.terms, &from.fit, &from.weights)));
    out
}

/// Sets of effects that all subsets of the projected linear model put before everything in `next`, refitted.
fn by_subsets(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    signatures: &[Signature],
    next: &[Hypothesis],
    size: usize,
) -> Vec<Hypothesis> {
    const KEPT: usize = 2;
    let fitting = || next.iter().filter(|h| h.acceptable(system));
    let Some(scale) = fitting().map(|h| h.fit.variance()).min_by(f64::total_cmp) else { return Vec::new() };
    let top = fitting().map(|h| h.criterion(&base.fit, scale)).fold(f64::INFINITY, f64::min);
    let residual = base.fit.stacked();
    let known: Vec<Vec<TermKey>> = next.iter().map(|h| h.key(system, None)).collect();
    best_subsets(system.catalogue(), signatures, &residual, size, scale, KEPT + known.len())
        .into_iter()
        .filter(|s| base.fit.ssr / scale - s.merit < top)
        .filter_map(|s| {
            if known.contains(&s.key(system.catalogue(), signatures)) {
                return None;
            }
            let law = |a: &Signature| system.catalogue()[a.term.effect].law(a.term.law);
            Some(
                s.signatures
                    .iter()
                    .map(|&i| signatures[i].start(&residual, law(&signatures[i])))
                    .collect::<Vec<EffectTerm>>(),
            )
        })
        .take(KEPT)
        .filter_map(|terms| refit(system, &[terms], base))
        .collect()
}

/// Adds the explanations of `more` that are not there yet; of two with the same key the better stays.
fn merge(
    system: &dyn MeasurementModel,
    all: &mut Vec<Hypothesis>,
    more: Vec<Hypothesis>,
    outliers: Option<usize>,
    base: &Fit,
    variance: f64,
) {
    for h in more {
        let key = h.key(system, outliers);
        match all.iter_mut().find(|o| o.key(system, outliers) == key) {
            Some(old) if old.criterion(base, variance) <= h.criterion(base, variance) => {}
            Some(old) => *old = h,
            None => all.push(h),
        }
    }
}

/// p-value of the step from `from` to `to`, adjusted by the family that was searched.
fn step_p(from: &Hypothesis, to: &Hypothesis, base: &Fit, test: &OmnibusTest) -> f64 {
    if to.flagged.len() > from.flagged.len() {
        return to.flag_p;
    }
    let extra = to.parameters(base) - from.parameters(base);
    let gain = from.fit.ssr - to.fit.ssr;
    let single = f_test(gain, from.fit.ssr, from.fit.dof, extra.max(1.0) as usize);
    test.family.adjusted(single)
}

/// Runs the search.
pub fn search(system: &dyn MeasurementModel, weights: &Weights, options: &Options) -> Option<SearchResult> {
    options.progress.at("testing the declared model", 0.0);
    let outliers = outlier_index(system);
    let base = declared(system, weights, options.seed)?;
    let first_test = omnibus_test(system, &base.fit, &base.weights, options);
    // Gross readings that the declared model's first fit left out are no step of the search.
    let given = base.key(system, outliers).len();
    let mut best = base.clone();
    let mut level: Vec<Hypothesis> = vec![base.clone()];
    let mut level_test = first_test.clone();
    let mut final_level: Vec<Hypothesis> = Vec::new();
    let mut not_converged: Vec<Vec<String>> = Vec::new();
    let mut not_identified: Vec<NotIdentified> = Vec::new();
    for size in 1..=options.largest {
        options.progress.at("searching for effects", (size - 1) as f64 / options.largest as f64);
        if !level_test.rejected() && !single_readings(system, &best) {
            break;
        }
        let mut next = larger(system, &base, &best, &level, [&level_test, &first_test], size);
        let open = next.iter().filter(|h| h.physical(system) && !h.acceptable(system));
        not_converged.extend(open.map(|h| names(system, &h.key(system, outliers))));
        next.retain(|h| h.acceptable(system) && h.key(system, outliers).len() == given + size);
        let (mut physical, refused) = identified(system, next);
        let Some(scale) = physical.iter().map(|h| h.fit.variance()).min_by(f64::total_cmp) else {
            not_identified.extend(ahead(&refused, &best, &base.fit));
            break;
        };
        physical.sort_by(|a, b| a.criterion(&base.fit, scale).total_cmp(&b.criterion(&base.fit, scale)));
        let candidate = physical[0].clone();
        let p = step_p(&best, &candidate, &base.fit, &level_test);
        not_identified.extend(ahead(&refused, &candidate, &base.fit));
        if p > CATALOGUE_LEVEL || candidate.criterion(&base.fit, scale) >= best.criterion(&base.fit, scale) {
            break;
        }
        best = settle(system, flag_anew(system, candidate));
        physical[0] = best.clone();
        level_test = rerun_omnibus(system, &best, options, size as u64);
        if level_test.rejected() && refine_level(system, &base, &mut physical) {
            best = settle(system, flag_anew(system, physical[0].clone()));
            physical[0] = best.clone();
            level_test = rerun_omnibus(system, &best, options, (options.largest + size) as u64);
        }
        level = physical.clone();
        final_level = physical;
    }
    let variance = best.fit.variance();
    let top = best.criterion(&base.fit, variance);
    let behind = |h: &Hypothesis| h.criterion(&base.fit, variance) - top;
    let p_values = compared(system, &best, &mut final_level, options);
    let survivors: Vec<Hypothesis> = final_level
        .iter()
        .zip(&p_values)
        .filter(|(h, p)| **p >= AMBIGUITY_LEVEL || not_told(system, &base, &best, h, behind(h)))
        .map(|(h, _)| h.clone())
        .collect();
    let line = |(h, p_value): (&Hypothesis, &f64)| Evidence {
        effects: names(system, &h.key(system, outliers)),
        laws: laws(system, h),
        gain: (base.fit.ssr - h.fit.ssr) / variance,
        behind: behind(h),
        parameters: h.parameters(&base.fit) as usize,
        p_value: *p_value,
    };
    let evidence = final_level.iter().zip(&p_values).map(line).collect();
    let covariate_beats_catalogue = covariate_wins(&base, &first_test, &best, variance);
    Some(SearchResult {
        base,
        first_test,
        best,
        last_test: level_test,
        survivors,
        evidence,
        refitted: final_level,
        not_converged,
        not_identified,
        covariate_beats_catalogue,
        within_model_error: Vec::new(),
    })
}

/// Explanations with one effect more: the few best of the last size extended, since the true set need not contain the best single effect, and
/// subsets of the first test's signatures. `tests`: of the best explanation so far, and of the declared model.
fn larger(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    best: &Hypothesis,
    level: &[Hypothesis],
    [test, first_test]: [&OmnibusTest; 2],
    size: usize,
) -> Vec<Hypothesis> {
    let (outliers, variance) = (outlier_index(system), best.fit.variance());
    let mut next: Vec<Hypothesis> = Vec::new();
    for (k, h) in level.iter().take(if size == 1 { 1 } else { 3 }).enumerate() {
        let more = if k == 0 {
            extend(system, h, &test.signatures)
        } else {
            extend(system, h, &signatures_of_catalogue(system, &h.fit, &h.weights, &nuisance(&h.fit)))
        };
        merge(system, &mut next, more, outliers, &base.fit, variance);
    }
    if size > 1 {
        let more = by_subsets(system, base, &first_test.signatures, &next, size);
        merge(system, &mut next, more, outliers, &base.fit, variance);
    }
    next
}

/// Names of the laws of an explanation's terms.
fn laws(system: &dyn MeasurementModel, h: &Hypothesis) -> Vec<String> {
    h.fit.terms.iter().map(|t| system.catalogue()[t.effect].law(t.law).name.to_owned()).collect()
}

/// Identifiers of what terms stand for.
fn names(system: &dyn MeasurementModel, key: &[TermKey]) -> Vec<String> {
    key.iter().map(|k| system.catalogue()[k.effect].id.to_owned()).collect()
}

/// An explanation that the design does not identify, and why.
type Refused = (Hypothesis, NotIdentified);

/// Explanations whose every effect the design identifies, and the others.
fn identified(system: &dyn MeasurementModel, all: Vec<Hypothesis>) -> (Vec<Hypothesis>, Vec<Refused>) {
    let (mut kept, mut refused) = (Vec::new(), Vec::new());
    for h in all {
        match system.not_identified(&h) {
            None => kept.push(h),
            Some(why) => refused.push((h, why)),
        }
    }
    (kept, refused)
}

/// The best of `refused`, where it would have stood in place of `taken`.
fn ahead(refused: &[Refused], taken: &Hypothesis, base: &Fit) -> Option<NotIdentified> {
    let lead = |h: &Hypothesis| {
        let scale = h.fit.variance().min(taken.fit.variance());
        taken.criterion(base, scale) - h.criterion(base, scale)
    };
    let best = refused.iter().max_by(|a, b| lead(&a.0).total_cmp(&lead(&b.0)))?;
    (lead(&best.0) > 0.0).then(|| best.1.clone())
}

/// One generic score alone explains the residual better than the accepted effects do.
fn covariate_wins(base: &Hypothesis, test: &OmnibusTest, best: &Hypothesis, variance: f64) -> bool {
    const MARGIN: f64 = 10.0;
    let Some(score) = test.covariates.first() else { return false };
    // Periods and steps were scanned: some forty places each.
    let scanned = if matches!(score.shape, "sinusoid" | "step") { 2.0 * 40f64.ln() } else { 2.0 };
    let by_covariate = (base.fit.ssr - score.gain) / variance + 2.0 * score.dimension as f64 + scanned;
    test.generic() && by_covariate + MARGIN < best.criterion(&base.fit, variance)
}

/// Readings stand out singly although nothing smooth is left.
fn single_readings(system: &dyn MeasurementModel, h: &Hypothesis) -> bool {
    h.flagged.is_empty()
        && outlier_index(system).is_some()
        && reject_outliers(system, &h.fit.terms, &h.fit, &h.weights).is_some()
}

fn rerun_omnibus(
    system: &dyn MeasurementModel,
    h: &Hypothesis,
    options: &Options,
    round: u64,
) -> OmnibusTest {
    let seed = options.seed.wrapping_add(round.wrapping_mul(0x9e37));
    omnibus_test(system, &h.fit, &h.weights, &Options { seed, ..options.clone() })
}

/// The declared model, fitted without readings that stand far out of it.
pub fn declared(system: &dyn MeasurementModel, weights: &Weights, seed: u64) -> Option<Hypothesis> {
    let plain = |weights: &Weights| {
        let fit = fit(system, &[], weights, 15)?;
        Some(Hypothesis { fit, weights: weights.clone(), flagged: Vec::new(), flag_p: 1.0 })
    };
    let out =
        if outlier_index(system).is_some() { initial_outliers(system, weights, seed) } else { Vec::new() };
    if out.is_empty() {
        return plain(weights);
    }
    let without = plain(&weights.masked(|i| !out.contains(&i)))?;
    reject_outliers(system, &[], &without.fit, &without.weights).or_else(|| plain(weights))
}

/// Flags of a model that has changed: a reading that it explains is taken back.
fn flag_anew(system: &dyn MeasurementModel, h: Hypothesis) -> Hypothesis {
    if h.flagged.is_empty() {
        return h;
    }
    reject_outliers(system, &h.fit.terms, &h.fit, &h.weights).unwrap_or_else(|| {
        let weights = h.weights.unmasked();
        let refitted = fit(system, &h.fit.terms, &weights, 15);
        refitted.map_or(h, |fit| Hypothesis { fit, weights, flagged: Vec::new(), flag_p: 1.0 })
    })
}
