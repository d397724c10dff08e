//! Bends compete for one shape by the error of readings that are left out in turn, each with its
//! parameters refitted.
//!
//! ```text
//! D = sum e'^2 - e^2,   sd(D) = 2 sqrt(d' C d),  d = e' - e         e, e': left-out errors of the best bend and of another one; C: covariance of the noise
//! ```
//!
//! Were the other one true, it would fall behind by D > z sd(D) in one session of a hundred; in one
//! of a thousand beside correlated noise, whose time constant comes from the same readings. There a
//! smooth difference d is as uncertain as the noise's slow part, and where the stimulus only rises
//! such noise is a bend by another name: a verdict does not choose between them.

use super::effects::POLYNOMIAL;
use super::frame::Declared;
use super::system::ScalarSystem;
use crate::effect::EffectModel;
use crate::levels::{RETAIN_BESIDE_CORRELATED, RIVAL, z};
use crate::method::{
    Fit, Hypothesis, Noise, Options, REFIT_STEPS, Signature, Status, Weights, fit,
    noise_for_predictions, nuisance_basis, omnibus_test, signatures_of_effect,
};
use crate::models::range;
use crate::verify::{Explained, Folds, SessionModel};
use crate::{EffectTerm, MeasurementModel};
use nalgebra::{DMatrix, DVector};

/// A bend that leaves this much more of the fitted readings is no rival.
const MUCH_MORE: f64 = 4.0;
/// Share of the squares left out that another description may leave.
const MATTERS: f64 = 0.5;

/// The readings speak against the model of errors `left_out` beside the `best`, at the level `z`;
/// `noise`: covariance of the errors.
fn is_behind(left_out: &LeftOut, best: &LeftOut, noise: &DMatrix<f64>, z: f64) -> bool {
    // sum e'^2 - e^2 = d' (e' + e), d = e' - e: its variance is 4 d' C d where e is noise.
    let difference = left_out - best;
    let sd = 2.0 * difference.dot(&(noise * &difference)).sqrt();
    left_out.norm_squared() - best.norm_squared() > z * sd
}

/// Errors of readings that are left out in turn, in units of their noise.
type LeftOut = DVector<f64>;

/// Lets the bends compete, in place of what was found.
pub(super) fn compete(system: &ScalarSystem, explained: &mut Explained, options: &Options) {
    let found = &explained.found;
    if explained.exact || system.frame.cyclic() {
        return;
    }
    let terms = &found.accepted().fit.terms;
    let bends = terms
        .iter()
        .filter(|t| system.effects[t.effect].bend)
        .count();
    // A smooth curve is a bend, and a wave or another bend for what remains of it: pieces of a law
    // that the catalogue does not have.
    let of_stimulus = |t: &&EffectTerm| {
        let of = &system.effects[t.effect];
        of.bend || of.waves_of_stimulus.contains(&of.effect.law(t.law).name)
    };
    let in_pieces = bends > 0
        && terms.iter().filter(of_stimulus).count() > 1
        && !is_polynomial(system, found.accepted());
    // The errors of an axis have a table of their own.
    let may_be_smooth = system.frame.declared != Declared::Axis;
    if may_be_smooth && (in_pieces || smooth_rest(system, explained)) {
        prefer_polynomial(system, explained, in_pieces, options);
    } else if bends == 1 && !found.covariate_beats_catalogue {
        let outcome = Contest::of(system, &found.best, &explained.noise, true).outcome();
        take(system, explained, outcome, options);
    }
}

/// Takes the bends that stand in place of every bend that was found.
fn take(
    system: &ScalarSystem,
    explained: &mut Explained,
    (mut remaining, all): (Vec<Hypothesis>, Vec<Hypothesis>),
    options: &Options,
) {
    let found = &mut explained.found;
    let competed: Vec<Vec<usize>> = all.iter().map(keys).collect();
    let Some(first) = remaining.first().cloned() else {
        return;
    };
    if !competed.contains(&keys(&found.best)) {
        return;
    }
    if keys(&first) != keys(&found.best) {
        found.last_test = omnibus_test(system, &first.fit, &first.weights, options);
        found.best = first;
    }
    // Each fold holds the contest again.
    found.refitted.retain(|h| !competed.contains(&keys(h)));
    found.refitted.splice(0..0, all);
    found.survivors.retain(|h| !competed.contains(&keys(h)));
    remaining.append(&mut found.survivors);
    found.survivors = remaining;
}

fn keys(h: &Hypothesis) -> Vec<usize> {
    let mut effects: Vec<usize> = h.fit.terms.iter().map(|t| t.effect).collect();
    effects.sort_unstable();
    effects
}

/// Only powers of the stimulus.
fn is_polynomial(system: &ScalarSystem, h: &Hypothesis) -> bool {
    let mut effects = h.fit.terms.iter().map(|t| &system.effects[t.effect]);
    effects.all(|e| !e.bend || e.degree.is_some())
}

/// Something remains that follows the stimulus alone: repeats say so, or the strongest driver.
fn smooth_rest(system: &ScalarSystem, explained: &Explained) -> bool {
    let found = &explained.found;
    let lack = system
        .pure_error(found.accepted())
        .is_some_and(|l| l.is_significant());
    let left = found.failed_adequacy_test();
    let driver = left.and_then(|t| t.covariates.first());
    lack || driver.is_some_and(|d| d.covariate == "stimulus")
}

/// Bends in one place: what stands beside them, readings taken for independent, and how they are
/// left out.
struct Contest<'a> {
    system: &'a ScalarSystem,
    of: &'a Hypothesis,
    others: Vec<EffectTerm>,
    independent: Weights,
    folds: Folds,
    /// Covariance of the errors' noise.
    noise: DMatrix<f64>,
    /// Standard deviations of D beyond which a bend falls.
    z: f64,
    /// Readings beyond the stimuli that are kept do not count: there a straight piece goes on, and
    /// a polynomial swings.
    inside: bool,
}

impl<'a> Contest<'a> {
    /// The place of the bends of `h`; `waves`: its waves over the stimulus stay beside them.
    fn of(system: &'a ScalarSystem, h: &'a Hypothesis, noise: &Noise, waves: bool) -> Self {
        let rows: Vec<usize> = (0..system.frame.rows.len()).collect();
        let covariance = noise.weights_of(&system.noise_inputs()).covariance(&rows);
        // Left-out errors are weighed, so their noise is, too: C becomes W C W s^2.
        let scale = DVector::from_column_slice(h.weights.relative()) * noise.repeat.value;
        let covariance = covariance.component_mul(&(&scale * scale.transpose()));
        let effects = &system.effects;
        let beside = |t: &&EffectTerm| {
            let of = &effects[t.effect];
            !of.bend && (waves || !of.of_stimulus(of.effect.law(t.law)))
        };
        Self {
            system,
            of: h,
            others: h.fit.terms.iter().filter(beside).cloned().collect(),
            independent: Weights::independent(h.weights.relative().to_vec()),
            folds: system.folds(h),
            noise: covariance,
            z: z(if noise.correlated.is_some() {
                RETAIN_BESIDE_CORRELATED
            } else {
                RIVAL
            }),
            inside: false,
        }
    }

    /// With a model of `terms` that starts from their values; none where a fold has no fit.
    fn left_out(&self, terms: &[EffectTerm]) -> Option<LeftOut> {
        let (fold, weights, u) = (&self.folds.fold, &self.independent, &self.system.frame.u);
        let mut errors = DVector::zeros(fold.len());
        for f in 0..fold.iter().flatten().max().map_or(0, |m| m + 1) {
            let kept = weights.masked(|i| fold[i] != Some(f));
            let left = fit(self.system, terms, &kept, REFIT_STEPS)?.raw_residual;
            let [low, high] = range((0..u.len()).filter(|&i| kept.counts(i)).map(|i| u[i]));
            let asked = |i: usize| !self.inside || (low..=high).contains(&u[i]);
            let own = |i: &usize| fold[*i] == Some(f) && weights.counts(*i) && asked(*i);
            for i in (0..u.len()).filter(own) {
                errors[i] = left[(i, 0)] * weights.of(i);
            }
        }
        Some(errors)
    }

    /// Every bend that may stand in this place, refitted, with what it leaves of readings left out.
    fn bends(&self) -> Vec<(Fit, LeftOut)> {
        let system = self.system;
        let Some(plain) = fit(system, &self.others, &self.independent, REFIT_STEPS) else {
            return Vec::new();
        };
        let (basis, residual) = (nuisance_basis(&plain), plain.stacked());
        let observable = |e: &usize| system.effects[*e].bend && system.not_observable(*e).is_none();
        let mut fits: Vec<Fit> = Vec::new();
        for effect in (0..system.catalogue().len()).filter(observable) {
            let signatures =
                signatures_of_effect(system, effect, &plain, &self.independent, &basis);
            for (law, form) in system.catalogue()[effect].laws.iter().enumerate() {
                let own = signatures.iter().filter(|s| s.term.law == law);
                let best =
                    own.max_by(|a: &&Signature, b| a.gain(&residual).total_cmp(&b.gain(&residual)));
                let Some(start) = best.map(|s| s.start(&residual, form)) else {
                    continue;
                };
                let terms: Vec<EffectTerm> = self.others.iter().cloned().chain([start]).collect();
                let fitted = fit(system, &terms, &self.independent, 3 * REFIT_STEPS);
                fits.extend(fitted.filter(|f| self.hypothesis(f.clone()).is_admissible(system)));
            }
        }
        let least = fits.iter().map(|f| f.ssr).fold(f64::INFINITY, f64::min);
        let unidentified = |f: &Fit| system.unidentified_term(&self.hypothesis(f.clone()));
        // Left-out errors cost a fit a fold: bends that lose at once are spared them.
        fits.retain(|f| f.ssr <= MUCH_MORE * least && unidentified(f).is_none());
        let with_errors = |f: Fit| self.left_out(&f.terms).map(|errors| (f, errors));
        fits.into_iter().filter_map(with_errors).collect()
    }

    fn hypothesis(&self, fit: Fit) -> Hypothesis {
        Hypothesis {
            fit,
            weights: self.independent.clone(),
            ..self.of.clone()
        }
    }

    /// The bends that the readings do not speak against, one law of each, the plainest first, and all
    /// that competed. The plainest stands alone where none predicts better.
    fn outcome(&self) -> (Vec<Hypothesis>, Vec<Hypothesis>) {
        let mut all = self.bends();
        all.sort_by(|(_, a), (_, b)| a.norm_squared().total_cmp(&b.norm_squared()));
        let mut set: Vec<Hypothesis> = Vec::new();
        let mut competed = Vec::new();
        for (f, errors) in &all {
            let Some(fit) = fit(self.system, &f.terms, &self.of.weights, REFIT_STEPS) else {
                continue;
            };
            let own = Hypothesis {
                fit,
                ..self.of.clone()
            };
            let remains = !is_behind(errors, &all[0].1, &self.noise, self.z);
            if remains && set.iter().all(|s| keys(s) != keys(&own)) {
                set.push(own.clone());
            }
            competed.push(own);
        }
        let best = set.first().map(keys);
        // The plainest first: fewest parameters, then the catalogue's order.
        set.sort_by_key(|h| (h.fit.design.ncols() + h.fit.tangents.len(), keys(h)));
        if set.first().map(keys) == best {
            set.truncate(1);
        }
        (set, competed)
    }
}

/// A polynomial of the least degree that no higher one beats on readings left out, where it takes
/// most of what the laws of the stimulus leave of them, or any of what laws `in_pieces` leave.
fn prefer_polynomial(
    system: &ScalarSystem,
    explained: &mut Explained,
    in_pieces: bool,
    options: &Options,
) {
    let found = &explained.found;
    let contest = Contest {
        inside: true,
        ..Contest::of(system, found.accepted(), &explained.noise, false)
    };
    let effects = &system.effects;
    let Some(effect) = effects.iter().position(|e| e.effect.id == POLYNOMIAL) else {
        return;
    };
    let of_degree = |(law, form): (usize, &EffectModel)| {
        // Half of the places are left to say whether it holds between them.
        let enough = !form.linear.is_empty() && 2 * form.linear.len() + 4 <= system.frame.levels();
        let term = EffectTerm {
            effect,
            law,
            values: Vec::new(),
        };
        let terms: Vec<EffectTerm> = contest.others.iter().cloned().chain([term]).collect();
        enough.then(|| Some((contest.left_out(&terms)?, terms)))?
    };
    let all: Vec<_> = effects[effect]
        .effect
        .refinements
        .iter()
        .enumerate()
        .filter_map(of_degree)
        .collect();
    let Some((best, _)) = all
        .iter()
        .min_by(|a, b| a.0.norm_squared().total_cmp(&b.0.norm_squared()))
    else {
        return;
    };
    // What the best one leaves is the noise: what the laws leave is none.
    let count = best.len();
    let noise = DMatrix::identity(count, count) * (best.norm_squared() / count as f64);
    let Some((errors, terms)) = all
        .iter()
        .find(|(e, _)| !is_behind(e, best, &noise, z(RIVAL)))
    else {
        return;
    };
    let laws = contest.left_out(&found.accepted().fit.terms);
    let most = if in_pieces { 1.0 } else { MATTERS };
    if laws.is_none_or(|laws| errors.norm_squared() >= most * laws.norm_squared()) {
        return;
    }
    let fitted = |terms: &Vec<EffectTerm>| {
        let fit = fit(system, terms, &contest.independent, REFIT_STEPS)?;
        (fit.status != Status::RankDeficient).then(|| contest.hypothesis(fit))
    };
    let Some(smooth) = fitted(terms) else {
        return;
    };
    // What it lacks is no reason for laws that lack more: something remains then, and is said.
    if system.unidentified_term(&smooth).is_some() {
        return;
    }
    let last_test = omnibus_test(system, &smooth.fit, &smooth.weights, options);
    // Each fold chooses its degree.
    let degrees = all.iter().filter_map(|(_, terms)| fitted(terms)).collect();
    if let Some(noise) = noise_for_predictions(system, &smooth, options.seed) {
        explained.noise = noise;
    }
    let found = &mut explained.found;
    found.covariate_beats_catalogue = false;
    found.survivors = vec![smooth.clone()];
    found.refitted = degrees;
    (found.best, found.last_test) = (smooth, last_test);
}
