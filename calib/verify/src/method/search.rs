//! From a rejected omnibus test to explanations: at most three effects, smallest set that passes
//! the omnibus test first. One function a stage, in the order in which `verify` calls them for each
//! size.

use super::ambiguity::cox_p_values;
use super::fit::{Fit, Weights};
use super::hypothesis::{Gate, Hypothesis, NotIdentified, Rejection};
use super::inference::indistinguishable;
use super::min_p::f_test;
use super::omnibus::{OmnibusTest, omnibus_test};
use super::options::Options;
use super::outliers::{reject_outliers, without_gross_readings};
use super::refine::{continue_to_convergence, refine_level, refit as refit_starts};
use super::search_result::{RankedHypothesis, SearchResult};
use super::signature::{Signature, nuisance_basis, signatures_of_catalogue};
use super::subsets::best_subsets;
use crate::effect::{EffectTerm, TermKey};
use crate::levels::{CATALOGUE, RIVAL};
use crate::measurement_model::MeasurementModel;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Refits tried at each size.
const REFITS: usize = 7;
/// Explanations of a size that are gone on from.
const PARENTS: usize = 3;

/// A search under one noise: the best explanation of each size so far.
pub struct Search {
    options: Options,
    size: usize,
    /// Explanations of the last size, best first.
    level: Vec<Hypothesis>,
    /// Explanations of any size that the design does not identify.
    refused: Vec<Refused>,
    /// What was found so far; rivals are not compared yet.
    pub found: SearchResult,
}

impl Search {
    /// Begins with the declared model under these weights; none where that has no fit.
    pub fn new(
        system: &dyn MeasurementModel,
        weights: &Weights,
        options: &Options,
    ) -> Option<Self> {
        options.progress.at("testing the declared model", 0.0);
        let base = fit_declared_model(system, weights)?;
        let test = omnibus_test(system, &base.fit, &base.weights, options);
        Some(Self {
            options: options.clone(),
            size: 1,
            level: vec![base.clone()],
            refused: Vec::new(),
            found: SearchResult {
                first_test: test.clone(),
                best: base.clone(),
                last_test: test,
                survivors: Vec::new(),
                evidence: Vec::new(),
                refitted: Vec::new(),
                rejections: Vec::new(),
                covariate_beats_catalogue: false,
                base,
            },
        })
    }

    /// The explanation that the noise is taken from: the best one, but for where a generic driver
    /// explains more.
    pub fn accepted(&self) -> &Hypothesis {
        if self.found.generic_driver_wins() {
            &self.found.base
        } else {
            &self.found.best
        }
    }

    /// Something was found or remains: heavier tails would be a reason to look again.
    pub(crate) fn is_inadequate(&self) -> bool {
        let found = !self.found.best.fit.terms.is_empty() || !self.found.best.flagged.is_empty();
        found || self.found.last_test.rejected() || self.found.generic_driver_wins()
    }
}

/// Whether anything remains beyond noise by the best explanation of the last size, and a larger one
/// may be tried.
pub fn test_adequacy(system: &dyn MeasurementModel, search: &Search) -> bool {
    let done = (search.size - 1) as f64 / search.options.largest as f64;
    search.options.progress.at("searching for effects", done);
    search.size <= search.options.largest
        && (search.found.last_test.rejected() || single_readings(system, &search.found.best))
}

/// Signatures of the catalogue off the nuisances of each explanation that is gone on from.
pub fn project_signatures(system: &dyn MeasurementModel, search: &Search) -> Signatures {
    let parents = search
        .level
        .iter()
        .take(if search.size == 1 { 1 } else { PARENTS })
        .enumerate();
    let of = |(k, h): (usize, &Hypothesis)| {
        let known = || search.found.last_test.signatures.clone();
        let anew =
            || signatures_of_catalogue(system, &h.fit, &h.weights, &nuisance_basis(&h.fit)).into();
        (h.clone(), if k == 0 { known() } else { anew() })
    };
    Signatures {
        parents: parents.map(of).collect(),
    }
}

/// The terms that would lower the projected misfit of each of them most.
pub fn screen_subsets(system: &dyn MeasurementModel, signatures: Signatures) -> Candidates {
    let of =
        |(k, (h, own)): (usize, &(Hypothesis, Arc<[Signature]>))| extensions(system, (k, h), own);
    let extended = signatures.parents.iter().enumerate().flat_map(of).collect();
    Candidates {
        parents: signatures.parents.into_iter().map(|(h, _)| h).collect(),
        extended,
    }
}

/// The candidates through the full forward model, outliers taken out of each, and sets of effects
/// whose linear merit is before all of them.
pub fn refit(
    system: &dyn MeasurementModel,
    search: &Search,
    candidates: &Candidates,
) -> Vec<Hypothesis> {
    let (outliers, variance) = (outlier_index(system), search.found.best.fit.variance());
    let base = &search.found.base;
    let join = |next: &mut Vec<Hypothesis>, more| {
        merge(system, next, more, outliers, &base.fit, variance);
    };
    let mut next: Vec<Hypothesis> = Vec::new();
    for (k, from) in candidates.parents.iter().enumerate() {
        let own: Vec<&Candidate> = candidates.extended.iter().filter(|c| c.from == k).collect();
        let mut more: Vec<Hypothesis> = own
            .par_iter()
            .flat_map_iter(|c| refit_starts(system, &c.starts, from))
            .collect();
        let single = outliers.filter(|_| from.flagged.is_empty());
        more.extend(
            single.and_then(|_| reject_outliers(system, &from.fit.terms, &from.fit, &from.weights)),
        );
        join(&mut next, more);
    }
    if search.size > 1 {
        let signatures = &search.found.first_test.signatures;
        let more = subset_candidates(system, base, signatures, &next, search.size);
        join(&mut next, more);
    }
    next
}

/// Takes the best of the refitted explanations where it is one that the design identifies, and that
/// earns its parameters; true where it did.
pub fn select_model(
    system: &dyn MeasurementModel,
    search: &mut Search,
    mut refitted: Vec<Hypothesis>,
) -> bool {
    let outliers = outlier_index(system);
    let open = refitted
        .iter()
        .filter(|h| h.is_physical(system) && !h.is_admissible(system));
    search.found.rejections.extend(open.map(|h| Rejection {
        effects: names(system, &h.key(system, outliers)),
        gate: Gate::NotConverged,
        why: String::new(),
    }));
    // Gross readings that a step takes back, or that were there before the first, are no step of
    // the search.
    let size = count(system, &search.found.best.key(system, outliers)) + 1;
    refitted.retain(|h| h.is_admissible(system) && count(system, &h.key(system, outliers)) == size);
    let (mut physical, refused) = split_by_identifiability(system, refitted);
    search.refused.extend(refused);
    let (refused, base) = (&search.refused, &search.found.base.fit);
    let unidentified = |taken: &Hypothesis| {
        unidentified_rivals(refused, taken, base)
            .first()
            .map(|(_, n)| Rejection {
                effects: vec![system.catalogue()[n.effect].id.to_owned()],
                gate: Gate::Identifiability,
                why: n.why.clone(),
            })
    };
    let Some(scale) = physical
        .iter()
        .map(|h| h.fit.variance())
        .min_by(f64::total_cmp)
    else {
        search
            .found
            .rejections
            .extend(unidentified(&search.found.best));
        return false;
    };
    // One variance for all, that of the best: their criteria can be compared.
    physical.sort_by(|a, b| a.aic(base, scale).total_cmp(&b.aic(base, scale)));
    let candidate = physical[0].clone();
    search.found.rejections.extend(unidentified(&candidate));
    // Two gates: chance within the family that was searched, and the price of the parameters.
    let p = f_to_enter(
        &search.found.best,
        &candidate,
        base,
        &search.found.last_test,
    );
    if p > CATALOGUE || candidate.aic(base, scale) >= search.found.best.aic(base, scale) {
        return false;
    }
    let rivals = unidentified_rivals(refused, &candidate, base);
    take(system, search, physical);
    // A name does not win by a test that only its rival can fail.
    search
        .found
        .refitted
        .extend(rivals.into_iter().map(|(h, _)| h));
    true
}

/// The explanations that the data do not reject (Cox's test), and what they are worth.
pub fn compare_rivals(system: &dyn MeasurementModel, search: &Search) -> SearchResult {
    let SearchResult { base, best, .. } = &search.found;
    let mut refitted = search.found.refitted.clone();
    let outliers = outlier_index(system);
    let variance = best.fit.variance();
    let top = best.aic(&base.fit, variance);
    let behind = |h: &Hypothesis| h.aic(&base.fit, variance) - top;
    let p_values = cox_p_values(system, best, &mut refitted, &search.options);
    let survivors: Vec<Hypothesis> = refitted
        .iter()
        .zip(&p_values)
        .filter(|(h, p)| **p >= RIVAL || indistinguishable(system, base, best, h, behind(h)))
        .map(|(h, _)| h.clone())
        .collect();
    let line = |(h, p_value): (&Hypothesis, &f64)| RankedHypothesis {
        effects: names(system, &h.key(system, outliers)),
        laws: laws(system, h),
        gain: (base.fit.ssr - h.fit.ssr) / variance,
        behind: behind(h),
        parameters: h.parameters(&base.fit) as usize,
        p_value: *p_value,
    };
    let evidence = refitted.iter().zip(&p_values).map(line).collect();
    let covariate_beats_catalogue = search.found.generic_driver_wins();
    SearchResult {
        survivors,
        evidence,
        refitted,
        covariate_beats_catalogue,
        ..search.found.clone()
    }
}

/// The explanations of a size, the first of them the best so far; richer laws of it where something
/// remains.
fn take(system: &dyn MeasurementModel, search: &mut Search, mut physical: Vec<Hypothesis>) {
    let test = |h: &Hypothesis, round: usize| {
        let seed = search
            .options
            .seed
            .wrapping_add((round as u64).wrapping_mul(0x9e37));
        omnibus_test(
            system,
            &h.fit,
            &h.weights,
            &Options {
                seed,
                ..search.options.clone()
            },
        )
    };
    physical[0] = continue_to_convergence(system, reflag_outliers(system, physical[0].clone()));
    let mut left = test(&physical[0], search.size);
    if left.rejected() && refine_level(system, &search.found.base, &mut physical) {
        physical[0] = continue_to_convergence(system, reflag_outliers(system, physical[0].clone()));
        left = test(&physical[0], search.options.largest + search.size);
    }
    (search.found.best, search.found.last_test) = (physical[0].clone(), left);
    (search.level, search.found.refitted) = (physical.clone(), physical);
    search.size += 1;
}

fn outlier_index(system: &dyn MeasurementModel) -> Option<usize> {
    system
        .outliers()
        .filter(|&e| system.not_observable(e).is_none())
}

/// A start of a refit: the explanation that it goes on from, and the terms with it.
struct Candidate {
    from: usize,
    starts: Vec<Vec<EffectTerm>>,
}

/// Explanations that are worth a refit.
pub struct Candidates {
    parents: Vec<Hypothesis>,
    extended: Vec<Candidate>,
}

/// Signatures of one term more on the explanations that are gone on from: the few best of the last
/// size, since the true set need not contain the best single effect.
pub struct Signatures {
    parents: Vec<(Hypothesis, Arc<[Signature]>)>,
}

/// Starts with one term more than the explanation `from`: the best laws of each key.
fn extensions(
    system: &dyn MeasurementModel,
    (k, from): (usize, &Hypothesis),
    signatures: &[Signature],
) -> Vec<Candidate> {
    // The projected linear model: what each term would lower the squares by, no refit.
    let residual = from.fit.stacked();
    let gains: Vec<f64> = signatures.iter().map(|a| a.gain(&residual)).collect();
    let mut best_of: BTreeMap<TermKey, f64> = BTreeMap::new();
    for (signature, gain) in signatures.iter().zip(&gains) {
        let best = best_of
            .entry(signature.term.key(system.catalogue()))
            .or_insert(0.0);
        *best = best.max(*gain);
    }
    let mut ranked: Vec<(TermKey, f64)> = best_of
        .into_iter()
        // Two standard deviations of one parameter: less is not worth a refit.
        .filter(|b| b.1 > 4.0 * from.fit.variance().min(1.0e300))
        .collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
    ranked.truncate(REFITS);
    let of = |(key, top): (TermKey, f64)| {
        let laws = &system.catalogue()[key.effect].laws;
        // Laws are rivals of their own; within a law the best point of the grid starts the refit.
        let start = |l: usize| {
            let best = (0..gains.len())
                .filter(|&i| signatures[i].term.law == l)
                .filter(|&i| signatures[i].term.key(system.catalogue()) == key)
                .max_by(|&a, &b| gains[a].total_cmp(&gains[b]))?;
            // A law with less than half the gain of the best one is not expected to overtake it.
            (gains[best] > 0.5 * top).then(|| {
                let mut terms = from.fit.terms.clone();
                terms.push(signatures[best].start(&residual, &laws[l]));
                terms
            })
        };
        Candidate {
            from: k,
            starts: (0..laws.len()).filter_map(start).collect(),
        }
    };
    ranked.into_iter().map(of).collect()
}

/// Sets of effects that all subsets of the projected linear model put before everything in `next`,
/// refitted.
fn subset_candidates(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    signatures: &[Signature],
    next: &[Hypothesis],
    size: usize,
) -> Vec<Hypothesis> {
    const KEPT: usize = 2;
    let fitting = || next.iter().filter(|h| h.is_admissible(system));
    let Some(scale) = fitting().map(|h| h.fit.variance()).min_by(f64::total_cmp) else {
        return Vec::new();
    };
    let top = fitting()
        .map(|h| h.aic(&base.fit, scale))
        .fold(f64::INFINITY, f64::min);
    let residual = base.fit.stacked();
    // The laws of a set that is there already may be those of the first step, which saw the other
    // effects as noise.
    let known: Vec<(Vec<TermKey>, f64)> = next
        .iter()
        .map(|h| (h.key(system, None), h.aic(&base.fit, scale)))
        .collect();
    best_subsets(
        system.catalogue(),
        signatures,
        &residual,
        size,
        scale,
        KEPT + known.len(),
    )
    .into_iter()
    // The criterion of the linear set: squares left over the variance, and the price.
    .filter(|s| base.fit.ssr / scale - s.merit < top)
    .filter_map(|s| {
        let key = s.key(system.catalogue(), signatures);
        if known
            .iter()
            .any(|(own, aic)| *own == key && *aic <= base.fit.ssr / scale - s.merit)
        {
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
    .filter_map(|terms| refit_starts(system, &[terms], base))
    .collect()
}

/// Adds the explanations of `more` that are not there yet; of two with the same key the better
/// stays.
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
            Some(old) if old.aic(base, variance) <= h.aic(base, variance) => {}
            Some(old) => *old = h,
            None => all.push(h),
        }
    }
}

/// p-value of the step from `from` to `to`, adjusted by the family that was searched; 1 where
/// nothing remains to test it by.
fn f_to_enter(from: &Hypothesis, to: &Hypothesis, base: &Fit, test: &OmnibusTest) -> f64 {
    if to.flagged.len() > from.flagged.len() {
        // Single readings have a test of their own (`tails`), which knows how many were looked at.
        return to.flag_p;
    }
    let extra = to.parameters(base) - from.parameters(base);
    // F to enter on the fall of the squares.
    let gain = from.fit.ssr - to.fit.ssr;
    let single = f_test(gain, from.fit.ssr, from.fit.dof, extra.max(1.0) as usize);
    single.map_or(1.0, |p| test.family.family_wise_p(p))
}

/// How many things terms stand for: columns of one effect are one.
fn count(system: &dyn MeasurementModel, key: &[TermKey]) -> usize {
    let by_column = |e: usize| system.catalogue().get(e).is_some_and(|c| c.by_column);
    (0..key.len())
        .filter(|&k| {
            !by_column(key[k].effect) || key[..k].iter().all(|o| o.effect != key[k].effect)
        })
        .count()
}

/// Names of the laws of an explanation's terms.
fn laws(system: &dyn MeasurementModel, h: &Hypothesis) -> Vec<String> {
    h.fit
        .terms
        .iter()
        .map(|t| system.catalogue()[t.effect].law(t.law).name.to_owned())
        .collect()
}

/// Identifiers of what terms stand for.
fn names(system: &dyn MeasurementModel, key: &[TermKey]) -> Vec<String> {
    key.iter()
        .map(|k| system.catalogue()[k.effect].id.to_owned())
        .collect()
}

/// An explanation that the design does not identify, and why.
type Refused = (Hypothesis, NotIdentified);

/// Explanations whose every effect the design identifies, and the others.
fn split_by_identifiability(
    system: &dyn MeasurementModel,
    all: Vec<Hypothesis>,
) -> (Vec<Hypothesis>, Vec<Refused>) {
    let (mut kept, mut refused) = (Vec::new(), Vec::new());
    for h in all {
        match system.not_identified(&h) {
            None => kept.push(h),
            Some(why) => refused.push((h, why)),
        }
    }
    (kept, refused)
}

/// Those of `refused` that would have stood in place of `taken`, the best first.
fn unidentified_rivals(refused: &[Refused], taken: &Hypothesis, base: &Fit) -> Vec<Refused> {
    let lead = |h: &Hypothesis| {
        let scale = h.fit.variance().min(taken.fit.variance());
        taken.aic(base, scale) - h.aic(base, scale)
    };
    let mut rivals: Vec<Refused> = refused
        .iter()
        .filter(|r| lead(&r.0) > 0.0)
        .cloned()
        .collect();
    rivals.sort_by(|a, b| lead(&b.0).total_cmp(&lead(&a.0)));
    rivals
}

/// Readings stand out singly although nothing smooth remains.
fn single_readings(system: &dyn MeasurementModel, h: &Hypothesis) -> bool {
    h.flagged.is_empty()
        && outlier_index(system).is_some()
        && reject_outliers(system, &h.fit.terms, &h.fit, &h.weights).is_some()
}

/// The declared model, fitted without readings that stand far out of any smooth curve.
pub(crate) fn fit_declared_model(
    system: &dyn MeasurementModel,
    weights: &Weights,
) -> Option<Hypothesis> {
    let declared = Hypothesis::fitted(system, &[], weights, 15)?;
    Some(if outlier_index(system).is_some() {
        without_gross_readings(system, declared)
    } else {
        declared
    })
}

/// Flags of a model that has changed: a reading that it explains is readmitted.
fn reflag_outliers(system: &dyn MeasurementModel, h: Hypothesis) -> Hypothesis {
    if h.flagged.is_empty() {
        h
    } else {
        flag_outliers(system, h)
    }
}

/// Single readings that stand out of an explanation, whatever was flagged before.
pub(crate) fn flag_outliers(system: &dyn MeasurementModel, h: Hypothesis) -> Hypothesis {
    if outlier_index(system).is_none() {
        return h;
    }
    let (terms, every) = (&h.fit.terms, h.weights.unmasked());
    let anew = || {
        (every != h.weights)
            .then(|| Hypothesis::fitted(system, terms, &every, 15))
            .flatten()
    };
    reject_outliers(system, terms, &h.fit, &h.weights)
        .or_else(anew)
        .unwrap_or(h)
}
