//! What the readings that a fold keeps show by themselves: noise, flags, and the explanation that
//! they choose. None of it is known from the readings that the fold leaves out, whose weight is
//! zero throughout.
//!
//! ```text
//! S_h = |P_h W r_h|^2,     cost = S_h / s^2 + 2 k_h              W: noise of the kept readings, P_h: off design and tangents of h (tangent model)
//! ```
//!
//! The nearest by that are refitted, and the one with the least criterion is chosen; noise and
//! choice are each made under the other, twice.

use super::session_model::SessionModel;
use crate::effect::EffectTerm;
use crate::measurement_model::MeasurementModel;
use crate::method::fit::{Weights, linear};
use crate::method::hypothesis::Hypothesis;
use crate::method::linear::{Basis, stack_with};
use crate::method::noise::Noise;
use crate::method::noise_estimator::NoiseEstimator;
use crate::method::search::{fit_declared_model, flag_outliers};
use nalgebra::{DMatrix, DVector};

/// Explanations that are refitted in a fold: what tangents promise far from their point a refit
/// need not keep.
const REFITTED: usize = 2;

/// Difference of the criterion within which two fits are one to the iteration's end: two laws that
/// the kept readings do not distinguish, as where they have two loads only. The first candidate
/// stands, which is the one that all readings accept.
const TIED: f64 = 0.05;

/// A fold of the cross-validation.
pub(crate) struct Fold<M> {
    /// The instrument, where the kept readings show another one than all readings do.
    pub model: Option<M>,
    /// The explanation that they choose.
    pub chosen: Hypothesis,
    /// Noise of the kept readings.
    pub noise: Noise,
    /// Noise of every reading.
    pub reading_sd: Vec<f64>,
    declared: Weights,
}

impl<M: SessionModel> Fold<M> {
    /// By the readings that are not `left_out`; none where these have no declared model.
    pub(crate) fn of(
        model: &M,
        candidates: &[&Hypothesis],
        left_out: &dyn Fn(usize) -> bool,
        steps: usize,
        seed: u64,
    ) -> Option<Self> {
        let of = |m: &M, candidates: &[&Hypothesis]| {
            let (declared, chosen, noise) = explain_kept(m, candidates, left_out, steps, seed)?;
            let reading_sd = noise.reading_sd(&m.noise_inputs());
            Some(Self {
                model: None,
                chosen,
                noise,
                reading_sd,
                declared: declared.weights,
            })
        };
        // A law of the noise that all readings gave is estimated again by those that are kept.
        let plain = model.before_noise();
        let start = plain.as_ref().unwrap_or(model);
        let first = of(start, candidates)?;
        let Some(renewed) = start.renewed(&first.chosen, true, seed) else {
            return Some(Self {
                model: plain,
                ..first
            });
        };
        let again = of(&renewed, &[&first.chosen])?;
        Some(Self {
            model: Some(renewed),
            ..again
        })
    }

    /// `terms` on the kept readings, under the noise and flags of the chosen explanation.
    pub(crate) fn refit(
        &self,
        model: &M,
        terms: &[EffectTerm],
        steps: usize,
    ) -> Option<Hypothesis> {
        Hypothesis::fitted(model, terms, &self.chosen.weights, steps)
    }

    /// The declared model on the same readings, without those that stand out of it.
    pub(crate) fn declared(&self, model: &M, steps: usize) -> Option<Hypothesis> {
        let weights = self
            .chosen
            .weights
            .masked(|i| self.chosen.weights.counts(i) && self.declared.counts(i));
        Hypothesis::fitted(model, &[], &weights, steps)
    }
}

/// The declared model, the chosen explanation and its noise, by the readings that are not
/// `left_out`.
fn explain_kept(
    system: &dyn MeasurementModel,
    candidates: &[&Hypothesis],
    left_out: &dyn Fn(usize) -> bool,
    steps: usize,
    seed: u64,
) -> Option<(Hypothesis, Hypothesis, Noise)> {
    let judge = NoiseEstimator::new(system, seed).without(left_out);
    let every = judge.independent();
    let declared = fit_declared_model(system, &every)?;
    let chosen = |weights: &Weights| {
        Some(flag_outliers(
            system,
            choose(system, candidates, &declared, weights, steps)?,
        ))
    };
    let noise = |h: &Hypothesis| {
        judge
            .noise(h, &[])
            .unwrap_or_else(|| Noise::none(every.len()))
    };
    // Readings that stand out of the declared model may be what an effect does: with and without
    // them, flags at their price.
    let without = (declared.weights != every)
        .then(|| chosen(&declared.weights))
        .flatten();
    let start = least_aic(
        chosen(&every).into_iter().chain(without).collect(),
        &declared,
    )?;
    let chosen = chosen(&noise(&start).weights.masked(|i| start.weights.counts(i)))?;
    let noise = noise(&chosen);
    Some((declared, chosen, noise))
}

/// The one with the least criterion, the first of those that are tied.
fn least_aic(all: Vec<Hypothesis>, declared: &Hypothesis) -> Option<Hypothesis> {
    let scale = all
        .iter()
        .map(|h| h.fit.variance())
        .fold(f64::INFINITY, f64::min)
        .max(f64::MIN_POSITIVE);
    let cost = |h: &Hypothesis| h.aic(&declared.fit, scale);
    let least = all.iter().map(cost).fold(f64::INFINITY, f64::min);
    all.into_iter().find(|h| cost(h) <= least + TIED)
}

/// The explanation that the readings of `weights` choose among `candidates`.
fn choose(
    system: &dyn MeasurementModel,
    candidates: &[&Hypothesis],
    declared: &Hypothesis,
    weights: &Weights,
    steps: usize,
) -> Option<Hypothesis> {
    let refit = |h: &Hypothesis| Hypothesis::fitted(system, &h.fit.terms, weights, steps);
    if let [only] = candidates {
        return refit(only);
    }
    let values = (weights.active() * declared.fit.residual.ncols()) as f64;
    let tangents: Vec<(f64, f64)> = candidates
        .iter()
        .map(|h| (tangent_squares(h, weights), h.parameters(&declared.fit)))
        .collect();
    let variance = |(squares, k): &(f64, f64)| squares / (values - k).max(1.0);
    // One variance for all, that of the candidate with the least: their criteria can be compared.
    let scale = tangents.iter().map(variance).fold(f64::INFINITY, f64::min);
    let mut nearest: Vec<usize> = (0..candidates.len()).collect();
    let cost = |k: &usize| tangents[*k].0 / scale + 2.0 * tangents[*k].1;
    nearest.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
    nearest.dedup_by_key(|k| &candidates[*k].fit.terms);
    // As in the search: what the kept readings do not determine, or what physics does not allow, is
    // no explanation.
    let refitted = nearest
        .into_iter()
        .filter_map(|k| Some((k, refit(candidates[k])?)));
    let mut admissible: Vec<_> = refitted
        .filter(|(_, h)| h.is_physical(system))
        .take(REFITTED)
        .collect();
    admissible.sort_by_key(|(k, _)| *k);
    let mut refitted: Vec<Hypothesis> = admissible.into_iter().map(|(_, h)| h).collect();
    if refitted.is_empty() {
        refitted.extend(Hypothesis::fitted(system, &[], weights, steps));
    }
    least_aic(refitted, declared)
}

/// Squares that `h` leaves of the readings of `weights`, in its tangent model.
fn tangent_squares(h: &Hypothesis, weights: &Weights) -> f64 {
    let design = weights.apply(&h.fit.raw_design);
    // What the coefficients cannot take up; of the second witness what belongs to readings that
    // count.
    let size = h.fit.residual.len();
    let off = |readings: &DMatrix<f64>, whole: &DVector<f64>| {
        let counts = |k: usize| f64::from(u8::from(weights.counts(h.fit.auxiliary_readings[k])));
        let seen = DVector::from_fn(whole.len() - size, |k, _| whole[size + k] * counts(k));
        stack_with(&linear(&design, &weights.apply(readings)).1, &seen)
    };
    let tangents = h.fit.raw_tangents.iter().zip(&h.fit.tangents);
    let basis = Basis::of(tangents.map(|(readings, whole)| off(readings, whole)));
    basis
        .project_off(&off(&h.fit.raw_residual, &h.fit.stacked()))
        .norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::columns_system_test::ColumnsSystem;

    /// Ten groups of ten readings of a column from -1 to 1, in which `moved` acts, and both
    /// explanations fitted to all of them.
    fn session(seed: u64, moved: impl Fn(usize, f64) -> f64) -> (ColumnsSystem, [Hypothesis; 2]) {
        let x: Vec<f64> = (0..100).map(|i| (i % 10) as f64 / 4.5 - 1.0).collect();
        let clean: Vec<f64> = x.iter().enumerate().map(|(i, x)| moved(i, *x)).collect();
        let system = ColumnsSystem::new(seed, vec![x], &clean);
        let of = |terms: &[EffectTerm]| {
            Hypothesis::fitted(&system, terms, &Weights::equal(100), 5).unwrap()
        };
        let all = [of(&[]), of(&[ColumnsSystem::term(0)])];
        (system, all)
    }

    fn without(
        group: usize,
        (system, all): &(ColumnsSystem, [Hypothesis; 2]),
    ) -> (Hypothesis, Noise) {
        let candidates: Vec<&Hypothesis> = all.iter().collect();
        let (_, chosen, noise) =
            explain_kept(system, &candidates, &|i| i / 10 == group, 5, 1).unwrap();
        (chosen, noise)
    }

    /// What a fold makes of the readings that it keeps: its terms, its flags among them, its noise.
    fn kept(group: usize, session: &(ColumnsSystem, [Hypothesis; 2])) -> (usize, Vec<bool>, f64) {
        let (chosen, noise) = without(group, session);
        let counts = (0..100)
            .filter(|i| i / 10 != group)
            .map(|i| chosen.weights.counts(i));
        (chosen.fit.terms.len(), counts.collect(), noise.repeat.value)
    }

    /// Whatever a fold's own readings show, it chooses the same from the others.
    fn is_blind(seed: u64, moved: &dyn Fn(usize, f64) -> f64) -> bool {
        let still = |i: usize, x: f64| if i / 10 == 3 { 0.0 } else { moved(i, x) };
        let [(a, of_a, sd_a), (b, of_b, sd_b)] = [
            kept(3, &session(seed, moved)),
            kept(3, &session(seed, still)),
        ];
        a == b && of_a == of_b && (sd_a / sd_b - 1.0).abs() < 1e-9
    }

    /// A slope that one group alone shows is chosen by all readings, and has no part in what the
    /// others choose.
    #[test]
    fn a_fold_s_own_readings_have_no_part_in_what_it_chooses() {
        let slope = |i: usize, x: f64| if i / 10 == 3 { 12.0 * x } else { 0.0 };
        for seed in 0..10 {
            assert!(is_blind(seed, &slope), "{seed}");
            // Control: without another group the slope is chosen.
            assert_eq!(kept(5, &session(seed, slope)).0, 1, "{seed}");
        }
    }

    /// One group scatters by eight standard deviations: with it the noise is half as large again
    /// and more.
    #[test]
    fn nor_in_its_noise_and_flags() {
        let sign = |i: usize| if i.is_multiple_of(3) { -1.0 } else { 1.0 };
        let wild = |i: usize, _: f64| match i {
            30..40 => 8.0 * sign(i),
            77 => 20.0,
            _ => 0.0,
        };
        let mut flagged = 0;
        for seed in 0..10 {
            assert!(is_blind(seed, &wild), "{seed}");
            let [own, control] = [3, 5].map(|group| kept(group, &session(seed, wild)));
            flagged += usize::from(own.1.contains(&false));
            // Control: with that group the noise is another one.
            assert!(control.2 > 1.3 * own.2, "{seed}: {own:?} {control:?}");
        }
        assert!(flagged >= 5, "{flagged}: flags are among what is compared");
    }
}
