//! Noise and explanation, each judged under the other.
//!
//! Noise that is correlated in time and an effect that is smooth in time take each other's place:
//! the term fitted first absorbs the signal. What a search under independent readings finds must
//! hold against the noise model that would take its place:
//!
//! ```text
//! S(M) = min over theta of  r' r |Sigma(theta)|^(1/N)          (concentrated likelihood, every coefficient of M refitted)
//! F = (S(without) / S(with) - 1) (N - p) / d                    judged within the family that was searched
//! ```
//!
//! with the noise theta estimated anew on both sides.

use super::admissible::REFIT_STEPS;
use super::fit::{Weights, fit};
use super::hypothesis::Hypothesis;
use super::min_p::{MinPDistribution, f_test};
use super::noise::{
    CORRELATED_PRICE, Components, MeanModel, Noise, NoiseInputs, RestrictedLikelihood, best_misfit,
    correlated_gain, estimate, estimate_components,
};
use super::omnibus::{CovariateScore, OmnibusTest};
use crate::levels::{GENERIC, LEAD, PRICE, RETAIN, RETAIN_BESIDE_CORRELATED};
use crate::measurement_model::MeasurementModel;

/// Generic drivers that are judged against correlated noise.
const COVARIATES_JUDGED: usize = 10;

/// Lead past which the p-value is 0 to any precision, and an exponential would be infinite.
const MAX_LEAD: f64 = 300.0;

/// Noise of an explanation's residuals for predictions of further readings: a correlated part is
/// taken up where it predicts better (Akaike), not only where a verdict could rest on it.
pub(crate) fn noise_for_predictions(
    system: &dyn MeasurementModel,
    h: &Hypothesis,
    seed: u64,
) -> Option<Noise> {
    let judge = NoiseEstimator::new(system, seed).with_correlated_gain(CORRELATED_PRICE);
    judge.noise(h, &[])
}

/// How well a model can do under any noise.
struct Misfit {
    noise: Components,
    best: RestrictedLikelihood,
    /// Where a part that is correlated in time gains what it costs: whether it is a course over the
    /// session.
    correlated: Option<bool>,
}

impl Misfit {
    /// Akaike's criterion.
    fn criterion(&self) -> f64 {
        let shared = if self.correlated.is_some() {
            CORRELATED_PRICE
        } else {
            0.0
        };
        // A law of the spread is one parameter.
        let law = if self.noise.law.is_some() { PRICE } else { 0.0 };
        // Of one number of values, fewer degrees of freedom are more parameters.
        self.best.plain - PRICE * self.best.dof + shared + law
    }

    /// Noise that neighbours share stands in the place of what the richer model `with` holds, which
    /// is the better description: a course in time in the place of no such noise, or by more than a
    /// term leads that is chosen among many.
    fn is_exchanged(&self, with: &Self) -> bool {
        let course = self.correlated == Some(true) && with.correlated.is_none();
        self.correlated.is_some()
            && self.criterion() - with.criterion() > if course { 0.0 } else { LEAD }
    }
}

/// A term that does not hold against the noise that would stand in its place.
struct Unsupported {
    p: f64,
    /// It is the better description all the same.
    exchanged: bool,
    dropped: (usize, Hypothesis),
}

/// Estimates the noise of an explanation's residuals.
pub struct NoiseEstimator<'a> {
    system: &'a dyn MeasurementModel,
    pub(crate) inputs: NoiseInputs,
    correlated_gain: f64,
    seed: u64,
}

impl<'a> NoiseEstimator<'a> {
    /// For a session.
    pub fn new(system: &'a dyn MeasurementModel, seed: u64) -> Self {
        Self {
            system,
            inputs: system.noise_inputs(),
            correlated_gain: correlated_gain(),
            seed,
        }
    }

    /// The same by the readings that are not `left_out`: these can never count.
    pub(crate) fn without(mut self, left_out: impl Fn(usize) -> bool) -> Self {
        let known = self.inputs.known.iter_mut().enumerate();
        known
            .filter(|(i, _)| left_out(*i))
            .for_each(|(_, known)| *known = 0.0);
        self
    }

    /// Readings that share nothing, each as good as it is known to be.
    pub(crate) fn independent(&self) -> Weights {
        Weights::independent(self.inputs.own(0.0))
    }

    /// The same where a part that is correlated in time is taken up from this gain on.
    pub(crate) fn with_correlated_gain(self, correlated_gain: f64) -> Self {
        Self {
            correlated_gain,
            ..self
        }
    }

    /// Noise of the residuals of `h`, with further columns where there are some.
    pub fn noise(&self, h: &Hypothesis, columns: &[Vec<f64>]) -> Option<Noise> {
        let model = MeanModel::of(&h.fit).with(columns);
        estimate(
            &model,
            &self.inputs,
            &h.weights,
            self.correlated_gain,
            self.seed,
        )
    }

    /// The parts of that, and how well the model can do under any noise.
    fn noise_and_misfit(&self, h: &Hypothesis, columns: &[Vec<f64>]) -> Option<Misfit> {
        let model = MeanModel::of(&h.fit).with(columns);
        let noise = estimate_components(
            &model,
            &self.inputs,
            &h.weights,
            self.correlated_gain,
            self.seed,
        )?;
        let (mut m, correlated) = best_misfit(&model, &self.inputs, &noise)?;
        // The second witness's covariance is known: its part of -2 log L is its sum of squares.
        let seen = h.fit.witness_count as f64;
        m.plain += h.fit.auxiliary_residual.norm_squared() / self.system.auxiliary_variance();
        (m.values, m.dof) = (m.values + seen, m.dof + seen);
        Some(Misfit {
            noise,
            best: m,
            correlated,
        })
    }

    /// p-value of `with` against `without` (both with their own noise), judged in `family`; 1 where
    /// nothing remains to test it by.
    fn p_value(&self, without: &Misfit, with: &Misfit, family: &MinPDistribution) -> f64 {
        let (a, b) = (&without.best, &with.best);
        // Both sides have had every shared part; a law of the spread is one parameter.
        let law = |n: &Components| if n.law.is_some() { PRICE } else { 0.0 };
        let lead = (a.plain + law(&without.noise) - b.plain - law(&with.noise)) / a.values;
        // A lead in -2 log L per value is the logarithm of a ratio of variances.
        let extra = (a.dof - b.dof).max(1.0);
        // Sums of squares in units of the better model's.
        let worse = lead.min(MAX_LEAD).exp();
        f_test(worse - 1.0, worse, a.dof, extra as usize).map_or(1.0, |p| family.family_wise_p(p))
    }

    /// The terms of `kept` that do not hold against the noise which would stand in their place,
    /// judged in `family`.
    fn unsupported(
        &self,
        kept: &Hypothesis,
        dropped: Vec<(usize, Hypothesis)>,
        family: &MinPDistribution,
    ) -> Option<Vec<Unsupported>> {
        let with = self.noise_and_misfit(kept, &[])?;
        let level = if with.noise.is_correlated() {
            RETAIN_BESIDE_CORRELATED
        } else {
            RETAIN
        };
        // A model without a term has the noise that suits it: that is what would stand in its
        // place.
        let judged = dropped.into_iter().filter_map(|dropped| {
            let without = self.noise_and_misfit(&dropped.1, &[])?;
            let p = self.p_value(&without, &with, family);
            Some(Unsupported {
                p,
                exchanged: without.is_exchanged(&with),
                dropped,
            })
        });
        Some(judged.filter(|u| u.p > level).collect())
    }

    /// The effects of `best` that hold against the noise which would stand in their place, and
    /// those that are not distinguished from it. A model that is degenerate under another noise is
    /// judged under the one that it was found with.
    pub(crate) fn backward_eliminate(
        &self,
        best: &Hypothesis,
        family: &MinPDistribution,
    ) -> Hypothesis {
        let weakest = |kept: &Hypothesis, dropped: Vec<(usize, Hypothesis)>| {
            let noise = self
                .unsupported(kept, dropped, family)?
                .into_iter()
                .filter(|u| !u.exchanged);
            noise.max_by(|a, b| a.p.total_cmp(&b.p)).map(|u| u.dropped)
        };
        best.eliminate(self.system, weakest).0
    }

    /// `best` without a term that is not distinguished from noise that neighbours share.
    pub(crate) fn noise_rivals(
        &self,
        best: &Hypothesis,
        family: &MinPDistribution,
    ) -> Vec<Hypothesis> {
        let judged = self
            .unsupported(best, best.drop1(self.system), family)
            .unwrap_or_default();
        let refit = |u: Unsupported| {
            let (_, h) = u.dropped;
            let weights = self.noise(&h, &[])?.weights.masked(|i| h.weights.counts(i));
            let fit = fit(self.system, &h.fit.terms, &weights, REFIT_STEPS)?;
            Some(Hypothesis { fit, weights, ..h })
        };
        judged
            .into_iter()
            .filter(|u| u.exchanged)
            .filter_map(refit)
            .collect()
    }

    /// Generic drivers of what `h` leaves, by their likelihood with a noise of their own; none
    /// where none holds against the noise without.
    pub(crate) fn covariate_scores(
        &self,
        h: &Hypothesis,
        test: &OmnibusTest,
    ) -> Option<Vec<CovariateScore>> {
        let without = self.noise_and_misfit(h, &[])?;
        let mut judged: Vec<(f64, CovariateScore)> = Vec::new();
        for score in test.covariates.iter().take(COVARIATES_JUDGED) {
            let Some(with) = self.noise_and_misfit(h, &score.columns) else {
                continue;
            };
            judged.push((
                self.p_value(&without, &with, &test.covariate_family),
                score.clone(),
            ));
        }
        judged.sort_by(|a, b| a.0.total_cmp(&b.0));
        let holds = judged.first().is_some_and(|d| d.0 < GENERIC);
        holds.then(|| judged.into_iter().map(|d| d.1).collect())
    }
}

/// Whether two noise models whiten alike, within a quarter.
pub(crate) fn same_whitening(a: &Weights, b: &Weights) -> bool {
    let near = |x: f64, y: f64| (x - y).abs() <= 0.25 * x.max(y).max(0.2);
    let shared = match (a.shared(), b.shared()) {
        (None, None) => true,
        (Some(p), Some(q)) => {
            near(p.pose, q.pose)
                && match (p.correlated, q.correlated) {
                    (None, None) => true,
                    (Some(p), Some(q)) => near(p[0], q[0]) && near(p[1].ln(), q[1].ln()),
                    _ => false,
                }
        }
        _ => false,
    };
    let (a, b) = (a.unmasked(), b.unmasked());
    shared
        && a.relative()
            .iter()
            .zip(b.relative())
            .all(|(x, y)| near(*x, *y))
}
