//! The error on open readings that are left out in turn, before and after.

use super::error_summary::{coverage95, rmse, summarise};
use super::fold::Fold;
use super::prediction_residual::{PairedTest, PredictionResidual};
use super::session_model::{Folds, HeldOut, SessionModel};
use crate::method::hypothesis::Hypothesis;
use crate::method::noise::Noise;
use crate::method::search_result::SearchResult;
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
        self.after
            .as_ref()
            .is_some_and(|e| e.rmse.contains_key(key))
    }
}

/// The declared model as a calibration, under the noise of the chosen one as many times as large as
/// it leaves more: what acts and is not in it is noise to it.
pub(super) fn declared_calibration<M: SessionModel>(
    model: &M,
    [declared, chosen]: [&Hypothesis; 2],
    noise: &Noise,
    floor_sd: f64,
) -> M::Calibration {
    // Ratio of what both leave of the same readings.
    let more = (declared.fit.variance() / chosen.fit.variance()).sqrt();
    let times = if more.is_finite() { more } else { 1.0 };
    model.calibration(declared, declared, &noise.scaled(times), times * floor_sd)
}

/// The models of a fold as calibrations would keep them: nothing in them is known from the readings
/// that it leaves out.
pub struct FoldCalibrations<'a, M: SessionModel> {
    /// The instrument.
    pub model: &'a M,
    /// Whether the fold leaves a reading out.
    pub left_out: Vec<bool>,
    /// The declared model.
    pub declared: M::Calibration,
    /// The explanation that the fold's readings choose.
    pub chosen: M::Calibration,
}

/// Errors of open readings that were left out in turn, and how they were.
pub struct LeftOut<M> {
    /// Declared and accepted model.
    pub errors: Errors,
    pub(super) split: Folds,
    folds: Vec<Option<Fold<M>>>,
}

impl<M: SessionModel> LeftOut<M> {
    /// Chance that what each fold chose predicts the readings which it left out so much better than
    /// the declared model; none without noise.
    pub(crate) fn gain_p(&self, model: &M, accepted: &Hypothesis) -> Option<f64> {
        // Each fold judges what it left out, under the noise that it estimated.
        let of_fold = |(f, fold): (usize, &Option<Fold<M>>)| {
            let fold = fold.as_ref()?;
            let model = fold.model.as_ref().unwrap_or(model);
            let judged = |i: usize| self.split.fold[i] == Some(f) && accepted.weights.counts(i);
            let of = |h: &Hypothesis| PredictionResidual::of(model, h, &h.fit, &fold.noise, judged);
            let declared = fold.declared(model, self.split.refit_steps)?;
            Some(of(&declared)?.beside(&of(&fold.chosen)?, |_| f as u32))
        };
        let folds: Vec<_> = self
            .folds
            .par_iter()
            .enumerate()
            .filter_map(of_fold)
            .collect();
        PairedTest::of_folds(folds)?.p()
    }

    /// Error before and after in the first quantity.
    pub fn change(&self, model: &M) -> Option<[f64; 2]> {
        let key = model.quantities()[0].key;
        let of = |e: &Option<HeldOutError>| e.as_ref()?.rmse.get(key).copied();
        Some([of(&self.errors.before)?, of(&self.errors.after)?])
    }

    /// Both models of every fold that has them, each under its own noise; `left`: something
    /// remains, so that only replicates tell the floor.
    pub(super) fn calibrations<'a>(
        &'a self,
        model: &'a M,
        left: bool,
    ) -> Vec<FoldCalibrations<'a, M>>
    where
        M::Calibration: Send,
    {
        let of_fold = |(f, fold): (usize, &'a Option<Fold<M>>)| {
            let fold = fold.as_ref()?;
            let model = fold.model.as_ref().unwrap_or(model);
            let base = fold.declared(model, self.split.refit_steps)?;
            let (chosen, noise) = (&fold.chosen, &fold.noise);
            let floor = model.floor(chosen, noise, left);
            Some(FoldCalibrations {
                model,
                left_out: self.split.fold.iter().map(|own| *own == Some(f)).collect(),
                declared: declared_calibration(model, [&base, chosen], noise, floor.sd),
                chosen: model.calibration(&base, chosen, noise, floor.sd),
            })
        };
        self.folds
            .par_iter()
            .enumerate()
            .filter_map(of_fold)
            .collect()
    }

    /// What the fit and the left-out readings lose without each accepted effect, the others
    /// refitted.
    pub(crate) fn ablations(
        &self,
        model: &M,
        found: &SearchResult,
        accepted: &Hypothesis,
    ) -> Vec<EffectAblation> {
        let mut effects: Vec<usize> = accepted.fit.terms.iter().map(|t| t.effect).collect();
        effects.dedup();
        let steps = self.split.refit_steps;
        let error = |h: &Hypothesis| {
            let of = |m: &M, fold: &Fold<M>| {
                m.predict(&fold.refit(m, &h.fit.terms, steps)?, &fold.reading_sd)
            };
            let rows = self.rows(model, |i| accepted.weights.counts(i), of);
            Some(rmse(&rows, 0)).filter(|e| e.is_finite())
        };
        let with = if effects.is_empty() {
            None
        } else {
            error(accepted)
        };
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

    /// Errors of the left-out readings that are `scored`, as `predicted` in their fold.
    fn rows(
        &self,
        model: &M,
        scored: impl Fn(usize) -> bool + Sync,
        predicted: impl Fn(&M, &Fold<M>) -> Option<M::Predictions> + Sync,
    ) -> Vec<HeldOut> {
        let of_fold = |(f, fold): (usize, &Option<Fold<M>>)| {
            let Some(fold) = fold else { return Vec::new() };
            let model = fold.model.as_ref().unwrap_or(model);
            let rows =
                (0..self.split.fold.len()).filter(|&i| self.split.fold[i] == Some(f) && scored(i));
            predicted(model, fold).map_or(Vec::new(), |p| {
                rows.map(|i| HeldOut {
                    group: f as u32,
                    ..model.errors(&p, i)
                })
                .collect()
            })
        };
        self.folds
            .par_iter()
            .enumerate()
            .flat_map_iter(of_fold)
            .collect()
    }
}

/// Errors on what each fold leaves out, where nothing was sealed. Every fold chooses anew among the
/// refitted explanations, unless one was accepted on request; readings that the accepted model
/// flags are not scored, so that before and after stand on the same rows.
pub(crate) fn leave_out<M: SessionModel>(
    model: &M,
    found: &SearchResult,
    accepted: &Hypothesis,
    noise: &Noise,
    on_request: bool,
    seed: u64,
) -> LeftOut<M> {
    // A fold that could not choose would know the choice from the readings it leaves out.
    let mut candidates = vec![accepted];
    if !accepted.fit.terms.is_empty() && !on_request {
        candidates.extend(std::iter::once(&found.base).chain(&found.refitted));
    }
    let split = model.folds(accepted);
    let (fold, steps) = (&split.fold, split.refit_steps);
    let count = fold.iter().flatten().max().map_or(0, |m| m + 1);
    let of = |f: usize| Fold::of(model, &candidates, &|i| fold[i] == Some(f), steps, seed);
    let folds = (0..count).into_par_iter().map(of).collect();
    let left_out = LeftOut {
        errors: Errors::default(),
        split,
        folds,
    };
    let (fold, words) = (&left_out.split.fold, &left_out.split.words);
    let counts = |i: usize| accepted.weights.counts(i);
    let declared = |m: &M, fold: &Fold<M>| m.predict(&fold.declared(m, steps)?, &fold.reading_sd);
    let labels = |m: &M, fold: &Fold<M>| m.predict_by_labels(&fold.declared(m, steps)?.weights);
    let chosen = |m: &M, fold: &Fold<M>| m.predict(&fold.chosen, &fold.reading_sd);
    let sum = |rows: &[HeldOut]| summarise(rows, model.quantities(), left_out.split.split);
    let after = left_out.rows(model, counts, chosen);
    let repaired = sum(&left_out.rows(model, counts, declared));
    let by_twin = sum(&left_out.rows(model, counts, labels));
    let mut further = Vec::new();
    if let (Some(_), Some(e)) = (&by_twin, &repaired) {
        further.push((
            "declared model, labels repaired by the rod".to_owned(),
            e.clone(),
        ));
    }
    let counted: Vec<usize> = (0..fold.len())
        .filter(|&i| fold[i].is_some() && counts(i))
        .collect();
    // A model that ignores readings is judged on them, too: as a second number beside the error of
    // those that count.
    let ignored = (0..fold.len()).any(|i| fold[i].is_some() && !counts(i));
    if ignored && let Some(e) = sum(&left_out.rows(model, |_| true, chosen)) {
        further.push((
            format!(
                "accepted model on all {} readings, flagged ones among them",
                e.points
            ),
            e,
        ));
    }
    let errors = Errors {
        before: by_twin.or(repaired),
        after: sum(&after),
        coverage95: coverage95(&after),
        further,
        trimmed: None,
        shared: None,
        noise_ratio: noise_ratio(model, noise, &counted),
        words: words.clone(),
        remark: format!(
            " Cross-validation {words}: each fold estimated noise and flags, chose among the refitted explanations and fitted on the remaining readings alone.",
        ),
    };
    LeftOut { errors, ..left_out }
}

/// Noise of `readings` over that of a typical one of them: root mean square over median. Where it
/// differs from reading to reading, an error over all of them lies above a typical reading's by
/// this.
pub(super) fn noise_ratio(model: &impl SessionModel, noise: &Noise, readings: &[usize]) -> f64 {
    let all = noise.reading_sd(&model.noise_inputs());
    let typical = median(readings.iter().map(|&i| all[i])).unwrap_or(1.0);
    // An error over all readings adds their variances; a typical reading is the median.
    let square =
        readings.iter().map(|&i| all[i].powi(2)).sum::<f64>() / readings.len().max(1) as f64;
    if typical > 0.0 {
        square.sqrt() / typical
    } else {
        1.0
    }
}
