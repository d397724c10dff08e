//! The error on readings that no fit saw, before and after.

use super::conclusion::Conclusion;
use super::error_summary::{coverage95, summarise};
use super::session_model::{Folds, HeldOut, Quantity, SessionModel};
use crate::method::fit::{Weights, fit};
use crate::method::hypothesis::{Hypothesis, SearchResult};
use crate::method::linear::{Basis, stack_with};
use crate::method::noise::Noise;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use wcal_core::median::median;
use wcal_core::verify_document::HeldOutError;

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
    fn shows(&self, key: &str) -> bool {
        self.after.as_ref().is_some_and(|e| e.rmse.contains_key(key))
    }
}

/// What the unsealed readings are under both models.
pub struct Unsealed<P> {
    /// Noise of the accepted model.
    pub noise: Noise,
    /// Declared model.
    pub before: P,
    /// Accepted model.
    pub after: P,
    /// Single unsealed readings that do not belong.
    pub left_out: Vec<usize>,
}

/// Errors of the readings that count.
pub fn scored<M: SessionModel>(whole: &M, predictions: &M::Predictions, left_out: &[usize]) -> Vec<HeldOut> {
    let counts = |i: &usize| whole.scored()[*i] && !left_out.contains(i);
    (0..whole.scored().len()).filter(counts).map(|i| whole.errors(predictions, i)).collect()
}

/// Errors on the unsealed readings of `whole`.
pub fn holdout_errors<M: SessionModel>(whole: &M, unsealed: &Unsealed<M::Predictions>, seed: u64) -> Errors {
    // Every sealed reading counts: which ones belong is no choice of the model that they judge.
    let of = |p: &M::Predictions| scored(whole, p, &[]);
    let sum = |rows: &[HeldOut]| summarise(rows, whole.quantities(), "holdout", seed);
    let rows = of(&unsealed.after);
    let without = |p: &M::Predictions| sum(&scored(whole, p, &unsealed.left_out));
    let trimmed =
        (!unsealed.left_out.is_empty()).then(|| [without(&unsealed.before), without(&unsealed.after)]);
    let counted: Vec<usize> = (0..whole.scored().len()).filter(|&i| whole.scored()[i]).collect();
    Errors {
        before: sum(&of(&unsealed.before)),
        after: sum(&rows),
        trimmed,
        noise_ratio: noise_ratio(whole, &unsealed.noise, &counted),
        coverage95: coverage95(&rows),
        ..Errors::default()
    }
}

/// `sealed` with the quantities that no sealed reading shows (contacts, where no sealed pose has a picture), left out in turn.
pub fn fill_from_cross_validation<M: SessionModel>(
    model: &M,
    mut sealed: Errors,
    in_turn: impl FnOnce() -> Errors,
) -> Errors {
    let missing: Vec<&Quantity> = model.quantities().iter().filter(|q| !sealed.shows(q.key)).collect();
    if missing.is_empty() {
        return sealed;
    }
    let in_turn = in_turn();
    for (to, from) in [(&mut sealed.before, &in_turn.before), (&mut sealed.after, &in_turn.after)] {
        let (Some(to), Some(from)) = (to, from) else { continue };
        for key in missing.iter().map(|q| q.key) {
            to.rmse.extend(from.rmse.get(key).map(|v| (key.to_owned(), *v)));
            to.interval95.extend(from.interval95.get(key).map(|v| (key.to_owned(), *v)));
        }
    }
    let keys: Vec<&str> = missing.iter().map(|q| q.key).filter(|k| in_turn.shows(k)).collect();
    if !keys.is_empty() {
        sealed.remark = format!(
            "{} No sealed reading shows {}: it is {}.",
            sealed.remark,
            keys.join(", "),
            in_turn.words
        );
    }
    sealed
}

/// Errors on what each fold leaves out, where nothing was sealed. Every fold chooses anew among the refitted explanations, unless one was
/// accepted on request.
pub fn cross_validate<M: SessionModel>(
    model: &M,
    found: &SearchResult,
    conclusion: &Conclusion,
    unsealed: &Unsealed<M::Predictions>,
    on_request: bool,
    seed: u64,
) -> Errors {
    let rivals: Vec<&Hypothesis> = if conclusion.accepted.fit.terms.is_empty() || on_request {
        Vec::new()
    } else {
        std::iter::once(&found.base).chain(&found.refitted).collect()
    };
    let folds = model.folds(&conclusion.accepted);
    let leave = LeaveOut {
        model,
        found,
        accepted: &conclusion.accepted,
        noise: &unsealed.noise,
        folds: &folds,
        every: false,
    };
    let sum = |rows: &[HeldOut]| summarise(rows, model.quantities(), folds.split, seed);
    let after = leave.errors(&conclusion.accepted, &rivals, false);
    let repaired = leave.errors(&found.base, &[], false);
    let by_twin = leave.errors(&found.base, &[], true);
    let mut further = Vec::new();
    if !by_twin.is_empty()
        && let Some(e) = sum(&repaired)
    {
        further.push(("declared model, labels repaired by the rod".to_owned(), e));
    }
    let declared = if by_twin.is_empty() { &repaired } else { &by_twin };
    let counted: Vec<usize> = (0..folds.fold.len())
        .filter(|&i| folds.fold[i].is_some() && conclusion.accepted.weights.counts(i))
        .collect();
    // A model that ignores readings is judged on them, too: as a second number beside the error of those that count.
    let ignored =
        (0..folds.fold.len()).any(|i| folds.fold[i].is_some() && !conclusion.accepted.weights.counts(i));
    if ignored
        && let Some(e) = sum(&LeaveOut { every: true, ..leave }.errors(&conclusion.accepted, &rivals, false))
    {
        further.push((format!("accepted model on all {} readings, flagged ones among them", e.points), e));
    }
    Errors {
        before: sum(declared),
        after: sum(&after),
        coverage95: coverage95(&after),
        further,
        trimmed: None,
        shared: None,
        noise_ratio: noise_ratio(model, &unsealed.noise, &counted),
        words: folds.words.clone(),
        remark: format!(
            " Cross-validation {}: selection and fit used only the remaining readings.",
            folds.words
        ),
    }
}

/// Noise of `readings` over that of a typical one of them: root mean square over median. Where it differs from reading to reading, an error
/// over all of them lies above a typical reading's by this.
fn noise_ratio<M: SessionModel>(model: &M, noise: &Noise, readings: &[usize]) -> f64 {
    let all = noise.reading_sd(&model.noise_inputs());
    let typical = median(readings.iter().map(|&i| all[i])).unwrap_or(1.0);
    let square = readings.iter().map(|&i| all[i].powi(2)).sum::<f64>() / readings.len().max(1) as f64;
    if typical > 0.0 { square.sqrt() / typical } else { 1.0 }
}

/// The explanation that the readings of `weights` alone would choose among `rivals` (tangent models, Akaike's price).
fn choice<'a>(rivals: &[&'a Hypothesis], found: &SearchResult, weights: &Weights) -> Option<&'a Hypothesis> {
    let variance = found.best.fit.variance();
    let cost = |h: &Hypothesis| {
        let (n, channels) = (h.fit.residual.nrows(), h.fit.residual.ncols());
        let kept = |v: &DMatrix<f64>, seen: &DVector<f64>| {
            let readings = DMatrix::from_fn(n, channels, |i, c| v[(i, c)] * weights.of(i));
            let seen = DVector::from_fn(seen.len(), |k, _| seen[k] * weights.of(h.fit.witness_readings[k]));
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
        left / variance + (h.criterion(&found.base.fit, variance) - h.fit.ssr / variance)
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
            let h = choice(rivals, self.found, &Weights::independent(outside)).unwrap_or(start);
            // Readings that the accepted model flags are in no fit: before and after stand on the same rows.
            let weights = h.weights.masked(|i| !inside(i) && counts(i));
            let predictions = if by_twin {
                model.by_outside_twin(&weights)
            } else {
                fit(model, &h.fit.terms, &weights, self.folds.refit_steps).and_then(|refit| {
                    model.predict(&Hypothesis { fit: refit, weights: weights.clone(), ..h.clone() }, &sd)
                })
            };
            let rows = (0..fold.len()).filter(|&i| inside(i) && (self.every || counts(i)));
            predictions.map_or(Vec::new(), |p| {
                rows.map(|i| HeldOut { group: f as u32, ..model.errors(&p, i) }).collect()
            })
        };
        (0..count).into_par_iter().flat_map_iter(of_fold).collect()
    }
}
