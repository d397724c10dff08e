//! The error on open readings that are left out in turn, before and after.

use super::error_summary::{coverage95, rmse, summarise};
use super::session_model::{Folds, HeldOut, SessionModel};
use crate::levels::PRICE;
use crate::method::fit::{Fit, Weights, fit};
use crate::method::hypothesis::Hypothesis;
use crate::method::linear::{Basis, stack_with};
use crate::method::noise::Noise;
use crate::method::search_result::SearchResult;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use wcal_core::order_statistics::median;
use wcal_core::verify_document::{EffectAblation, HeldOutError};

/// Held-out errors of the declared and the accepted model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Errors {
    /// Declared model.
    pub before: Option<HeldOutError>,
    /// Accepted model.
    pub after: Option<HeldOutError>,
    /// Both without single readings that do not belong, where there are some.
    pub trimmed: Option<[Option<HeldOutError>; 2]>,
    /// Noise of the readings that count over that of a typical reading, root mean square.
    pub noise_ratio: f64,
    /// What the unsealed readings share; none where none was unsealed.
    pub shared: Option<SharedNoise>,
    /// Share of values inside their stated intervals.
    pub coverage95: Option<f64>,
    /// Further models by name.
    pub further: Vec<(String, HeldOutError)>,
    /// What the verdict's reason must add.
    pub remark: String,
    /// How readings were left out, where they were.
    pub words: String,
}

/// What unsealed readings share by the noise, at the upper ends of its parts' intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedNoise {
    /// Independent readings that they are worth, `(tr C)^2 / tr C^2` (Satterthwaite).
    pub independent: f64,
    /// Standard deviation of a reading over that of the estimates.
    pub widening: f64,
}

impl Errors {
    /// The accepted model has an error of that quantity.
    pub(super) fn shows(&self, key: &str) -> bool {
        self.after.as_ref().is_some_and(|e| e.rmse.contains_key(key))
    }
}

/// Part of the error, root mean square, that effects may leave: a hundredth of the squares is within the model's error.
const EARNED: f64 = 0.995;

/// Errors of open readings that were left out in turn, and how they were.
pub struct LeftOut {
    /// Declared and accepted model.
    pub errors: Errors,
    folds: Folds,
}

impl LeftOut {
    /// Error before and after in the first quantity, where the accepted effects do not earn their names: it rises with them, or falls by less than matters.
    pub fn not_earned<M: SessionModel>(&self, model: &M) -> Option<[f64; 2]> {
        let key = model.quantities()[0].key;
        let of = |e: &Option<HeldOutError>| e.as_ref()?.rmse.get(key).copied();
        let (before, after) = (of(&self.errors.before)?, of(&self.errors.after)?);
        (after > EARNED * before).then_some([before, after])
    }

    /// What the fit and the left-out readings lose without each accepted effect, the others refitted.
    pub fn ablations<M: SessionModel>(
        &self,
        model: &M,
        found: &SearchResult,
        accepted: &Hypothesis,
        noise: &Noise,
    ) -> Vec<EffectAblation> {
        let mut effects: Vec<usize> = accepted.fit.terms.iter().map(|t| t.effect).collect();
        effects.dedup();
        let leave = LeaveOut { model, found, accepted, noise, folds: &self.folds, every: false };
        let error = |h: &Hypothesis| Some(rmse(&leave.errors(h, &[], false), 0)).filter(|e| e.is_finite());
        let with = if effects.is_empty() { None } else { error(accepted) };
        let of = |effect: usize| {
            let without = accepted.without(model, |_, t| t.effect == effect)?;
            Some(EffectAblation {
                id: model.catalogue()[effect].id.to_owned(),
                misfit_ratio: (without.fit.ssr / accepted.fit.ssr).sqrt(),
                p_value: without.removal_p(&accepted.fit, &found.first_test.family),
                left_out: with,
                left_out_without: error(&without),
            })
        };
        effects.into_iter().filter_map(of).collect()
    }
}

/// Errors on what each fold leaves out, where nothing was sealed. Every fold chooses anew among the refitted explanations, unless one was
/// accepted on request.
pub fn leave_out<M: SessionModel>(
    model: &M,
    found: &SearchResult,
    accepted: &Hypothesis,
    noise: &Noise,
    on_request: bool,
    seed: u64,
) -> LeftOut {
    let rivals: Vec<&Hypothesis> = if accepted.fit.terms.is_empty() || on_request {
        Vec::new()
    } else {
        std::iter::once(&found.base).chain(&found.refitted).collect()
    };
    let folds = model.folds(accepted);
    let leave = LeaveOut { model, found, accepted, noise, folds: &folds, every: false };
    let sum = |rows: &[HeldOut]| summarise(rows, model.quantities(), folds.split, seed);
    let after = leave.errors(accepted, &rivals, false);
    let repaired = leave.errors(&found.base, &[], false);
    let by_twin = leave.errors(&found.base, &[], true);
    let mut further = Vec::new();
    if !by_twin.is_empty()
        && let Some(e) = sum(&repaired)
    {
        further.push(("declared model, labels repaired by the rod".to_owned(), e));
    }
    let declared = if by_twin.is_empty() { &repaired } else { &by_twin };
    let counted: Vec<usize> =
        (0..folds.fold.len()).filter(|&i| folds.fold[i].is_some() && accepted.weights.counts(i)).collect();
    // A model that ignores readings is judged on them, too: as a second number beside the error of those that count.
    let ignored = (0..folds.fold.len()).any(|i| folds.fold[i].is_some() && !accepted.weights.counts(i));
    if ignored && let Some(e) = sum(&LeaveOut { every: true, ..leave }.errors(accepted, &rivals, false)) {
        further.push((format!("accepted model on all {} readings, flagged ones among them", e.points), e));
    }
    let errors = Errors {
        before: sum(declared),
        after: sum(&after),
        coverage95: coverage95(&after),
        further,
        trimmed: None,
        shared: None,
        noise_ratio: noise_ratio(model, noise, &counted),
        words: folds.words.clone(),
        remark: format!(
            " Cross-validation {}: each fold chose among the refitted explanations and fitted on the remaining readings alone; noise and flags are those of all open readings.",
            folds.words
        ),
    };
    LeftOut { errors, folds }
}

/// Noise of `readings` over that of a typical one of them: root mean square over median. Where it differs from reading to reading, an error
/// over all of them lies above a typical reading's by this.
pub(super) fn noise_ratio<M: SessionModel>(model: &M, noise: &Noise, readings: &[usize]) -> f64 {
    let all = noise.reading_sd(&model.noise_inputs());
    let typical = median(readings.iter().map(|&i| all[i])).unwrap_or(1.0);
    let square = readings.iter().map(|&i| all[i].powi(2)).sum::<f64>() / readings.len().max(1) as f64;
    if typical > 0.0 { square.sqrt() / typical } else { 1.0 }
}

/// The explanation that the readings of `weights` alone would choose among `rivals` (tangent models, Akaike's price).
fn select_in_fold<'a>(
    rivals: &[&'a Hypothesis],
    (base, variance): (&Fit, f64),
    weights: &Weights,
) -> Option<&'a Hypothesis> {
    let cost = |h: &Hypothesis| {
        let (n, channels) = (h.fit.residual.nrows(), h.fit.residual.ncols());
        let kept = |v: &DMatrix<f64>, seen: &DVector<f64>| {
            let readings = DMatrix::from_fn(n, channels, |i, c| v[(i, c)] * weights.of(i));
            let seen = DVector::from_fn(seen.len(), |k, _| seen[k] * weights.of(h.fit.auxiliary_readings[k]));
            stack_with(&readings, &seen)
        };
        let mut basis = Basis::default();
        for column in h.fit.design.column_iter() {
            let column: Vec<f64> = column.iter().zip(weights.relative()).map(|(v, w)| v * w).collect();
            for c in 0..channels {
                basis.push(&h.fit.in_channel(&column, c));
            }
        }
        for (t, w) in h.fit.tangents.iter().zip(&h.fit.witness_tangents) {
            basis.push(&kept(t, w));
        }
        let left = basis.project_off(&kept(&h.fit.residual, &h.fit.auxiliary_residual)).norm_squared();
        left / variance + (h.aic(base, variance) - h.fit.ssr / variance)
    };
    rivals.iter().map(|h| (cost(h), *h)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, h)| h)
}

/// Leaves folds out in turn.
#[derive(Clone, Copy)]
struct LeaveOut<'a, M> {
    model: &'a M,
    found: &'a SearchResult,
    accepted: &'a Hypothesis,
    noise: &'a Noise,
    folds: &'a Folds,
    /// Errors of readings that the accepted model flags count, too; they are in no fit all the same.
    every: bool,
}

impl<M: SessionModel> LeaveOut<'_, M> {
    /// Errors of `start`, or of what each fold chooses among `rivals`, on the readings that count in the accepted model; by the labels of
    /// an outside twin on request, none where there are none.
    fn errors(&self, start: &Hypothesis, rivals: &[&Hypothesis], by_twin: bool) -> Vec<HeldOut> {
        let (model, fold) = (self.model, &self.folds.fold);
        let count = fold.iter().flatten().max().map_or(0, |m| m + 1);
        let sd = self.noise.reading_sd(&model.noise_inputs());
        let counts = |i: usize| self.accepted.weights.counts(i);
        let of_fold = |f: usize| {
            let inside = |i: usize| fold[i] == Some(f);
            let outside: Vec<f64> = (0..fold.len()).map(|i| f64::from(u8::from(!inside(i)))).collect();
            let scale = (&self.found.base.fit, self.found.best.fit.variance());
            let h = select_in_fold(rivals, scale, &Weights::independent(outside)).unwrap_or(start);
            // Readings that the accepted model flags are in no fit: before and after stand on the same rows.
            let kept = |h: &Hypothesis| h.weights.masked(|i| !inside(i) && counts(i));
            let refit = |h: &Hypothesis| {
                let weights = kept(h);
                let fit = fit(model, &h.fit.terms, &weights, self.folds.refit_steps)?;
                Some(Hypothesis { fit, weights, ..h.clone() })
            };
            let cost = |h: &Hypothesis| h.aic(scale.0, scale.1);
            let predictions = if by_twin {
                model.predict_by_labels(&kept(h))
            } else {
                // What tangents promise far from their point a refit need not keep; of two that fit alike the accepted one stands. Where each term was judged over
                // groups by its tangents already, they choose here, too.
                let by_refit = h.fit.terms != start.fit.terms && !model.cross_validates_terms();
                let accepted = by_refit.then(|| refit(start)).flatten();
                let chosen = refit(h).filter(|h| accepted.as_ref().is_none_or(|a| cost(h) + PRICE < cost(a)));
                chosen.or(accepted).and_then(|refitted| model.predict(&refitted, &sd))
            };
            let rows = (0..fold.len()).filter(|&i| inside(i) && (self.every || counts(i)));
            predictions.map_or(Vec::new(), |p| {
                rows.map(|i| HeldOut { group: f as u32, ..model.errors(&p, i) }).collect()
            })
        };
        (0..count).into_par_iter().flat_map_iter(of_fold).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::columns_system_test::ColumnsSystem;

    /// A slope that one group alone shows is chosen by all readings, and not by those that are left when this group is out.
    #[test]
    fn a_fold_s_own_readings_have_no_part_in_what_it_chooses() {
        let x: Vec<f64> = (0..100).map(|i| (i % 10) as f64 / 4.5 - 1.0).collect();
        let clean: Vec<f64> =
            x.iter().enumerate().map(|(i, x)| if i / 10 == 3 { 12.0 * x } else { 0.0 }).collect();
        for seed in 0..10 {
            let system = ColumnsSystem::new(seed, vec![x.clone()], &clean);
            let of = |terms: &[crate::EffectTerm]| {
                let weights = Weights::equal(100);
                let fit = fit(&system, terms, &weights, 5).unwrap();
                Hypothesis { fit, weights, flagged: Vec::new(), flag_p: 1.0 }
            };
            let (plain, slope) = (of(&[]), of(&[ColumnsSystem::term(0)]));
            let chosen = |leave_out: Option<usize>| {
                let weights = (0..100).map(|i| f64::from(u8::from(leave_out != Some(i / 10)))).collect();
                let scale = (&plain.fit, slope.fit.variance());
                select_in_fold(&[&plain, &slope], scale, &Weights::independent(weights))
                    .unwrap()
                    .fit
                    .terms
                    .len()
            };
            assert_eq!((chosen(None), chosen(Some(3))), (1, 0), "{seed}");
            // Control: without another group the slope is chosen all the same.
            assert_eq!(chosen(Some(5)), 1, "{seed}");
        }
    }
}
