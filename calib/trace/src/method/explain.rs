//! Noise and explanation, each judged under the other: from the baseline fit to adequacy (docs/src/method.md).
//!
//! Noise that is correlated in time and an effect that is smooth in time take each other's place: the term fitted first absorbs the signal. So the
//! search starts with independent readings; what it finds must then hold against the noise model that would take its place:
//!
//! ```text
//! S(M) = min over theta of  r' r |Sigma(theta)|^(1/N)          (concentrated likelihood, every coefficient of M refitted)
//! F = (S(without) / S(with) - 1) (N - p) / d                    judged within the family that was searched
//! ```
//!
//! with the noise theta estimated anew on both sides. What does not hold is dropped, and the search is made again under the noise that
//! stands in its place.

use super::earned::earned;
use super::fit::Weights;
use super::hypothesis::{Hypothesis, SearchResult};
use super::min_p::{MinPDistribution, f_test};
use super::noise::{
    CORRELATED_GAIN, CORRELATED_PRICE, MeanModel, Misfit, Noise, NoiseInputs, best_misfit, estimate,
};
use super::omnibus::{COVARIATE_LEVEL, CovariateScore, OmnibusTest, omnibus_test};
use super::options::Options;
use super::search::{declared, search};
use crate::measurement_model::MeasurementModel;

/// What the search found and the noise under which it holds.
pub struct Explained {
    /// Search under the final noise.
    pub found: SearchResult,
    /// Noise of the accepted model's residuals.
    pub noise: Noise,
    /// Noise of the declared model's residuals.
    pub declared_noise: Noise,
    /// Nothing but rounding is left by the declared model: structure in it means nothing.
    pub exact: bool,
}

/// Searches under a noise that is not known beforehand.
const MAX_SEARCHES: usize = 3;
/// Level at which an effect holds against the noise that would stand in its place. It has passed the level of the search already.
const CONFIRM_LEVEL: f64 = 0.02;
/// The same beside correlated noise: its time constant comes from a few stretches of the very readings, and a slow effect looks like it.
const CONFIRM_BESIDE_CORRELATED: f64 = 1e-3;
/// Generic drivers that are judged against correlated noise.
const COVARIATES_JUDGED: usize = 10;
/// Price of a law of the spread, in -2 log likelihood (Akaike).
const LAW_PRICE: f64 = 2.0;

/// Lead past which the p-value is 0 to any precision, and an exponential would be infinite.
const MAX_LEAD: f64 = 300.0;

/// Noise of an explanation's residuals for predictions of further readings: a correlated part is taken up where it predicts better (Akaike), not
/// only where a verdict could rest on it.
pub fn noise_for_predictions(system: &dyn MeasurementModel, h: &Hypothesis, seed: u64) -> Option<Noise> {
    let judge = NoiseEstimator { correlated_gain: CORRELATED_PRICE, ..NoiseEstimator::new(system, seed) };
    Some(judge.noise(h, &[])?.0)
}

/// Estimates the noise of an explanation's residuals.
pub struct NoiseEstimator<'a> {
    system: &'a dyn MeasurementModel,
    inputs: NoiseInputs,
    correlated_gain: f64,
    seed: u64,
}

impl<'a> NoiseEstimator<'a> {
    /// For a session.
    pub fn new(system: &'a dyn MeasurementModel, seed: u64) -> Self {
        Self { system, inputs: system.noise_inputs(), correlated_gain: CORRELATED_GAIN, seed }
    }

    /// Noise of the residuals of `h`, with further columns where there are some, and how well the model can do under any noise.
    pub fn noise(&self, h: &Hypothesis, columns: &[Vec<f64>]) -> Option<(Noise, Misfit)> {
        let model = MeanModel::of(&h.fit).with(columns);
        let noise = estimate(&model, &self.inputs, &h.weights, self.correlated_gain, self.seed)?;
        let mut m = best_misfit(&model, &self.inputs, &noise)?;
        // The second witness's covariance is known: its part of -2 log L is its sum of squares.
        let seen = h.fit.witness_count as f64;
        m.plain += h.fit.auxiliary_residual.norm_squared() / self.system.witness_variance();
        (m.values, m.dof) = (m.values + seen, m.dof + seen);
        Some((noise, m))
    }

    /// p-value of `with` against `without` (both with their own noise), judged in `family`.
    fn p_value(&self, without: &(Noise, Misfit), with: &(Noise, Misfit), family: &MinPDistribution) -> f64 {
        let (a, b) = (&without.1, &with.1);
        // Both sides have had every shared part; a law of the spread is one parameter.
        let law = |n: &Noise| if n.law.is_some() { LAW_PRICE } else { 0.0 };
        let lead = (a.plain + law(&without.0) - b.plain - law(&with.0)) / a.values;
        let extra = (a.dof - b.dof).max(1.0);
        // Sums of squares in units of the better model's.
        let worse = lead.min(MAX_LEAD).exp();
        family.adjusted(f_test(worse - 1.0, worse, a.dof, extra as usize))
    }

    /// The effects of `found.best` that hold against the noise which would stand in their place.
    fn confirmed(&self, found: &SearchResult) -> Option<Hypothesis> {
        let mut best = found.best.clone();
        while !best.fit.terms.is_empty() {
            let with = self.noise(&best, &[])?;
            let mut weakest: Option<(f64, Hypothesis)> = None;
            for k in 0..best.fit.terms.len() {
                let Some(without) = best.without(self.system, |j, _| j == k, 10) else { continue };
                let p = self.p_value(&self.noise(&without, &[])?, &with, &found.first_test.family);
                if weakest.as_ref().is_none_or(|w| p > w.0) {
                    weakest = Some((p, without));
                }
            }
            let level = if with.0.correlated.is_some() { CONFIRM_BESIDE_CORRELATED } else { CONFIRM_LEVEL };
            match weakest {
                Some((p, without)) if p > level => best = without,
                _ => break,
            }
        }
        Some(best)
    }

    /// Generic drivers of what `h` leaves, by their likelihood with a noise of their own; none where none holds against the noise without.
    fn driven(&self, h: &Hypothesis, test: &OmnibusTest) -> Option<Vec<CovariateScore>> {
        let without = self.noise(h, &[])?;
        let mut judged: Vec<(f64, CovariateScore)> = Vec::new();
        for score in test.covariates.iter().take(COVARIATES_JUDGED) {
            let Some(with) = self.noise(h, &score.columns) else { continue };
            judged.push((self.p_value(&without, &with, &test.covariate_family), score.clone()));
        }
        judged.sort_by(|a, b| a.0.total_cmp(&b.0));
        let holds = judged.first().is_some_and(|d| d.0 < COVARIATE_LEVEL);
        holds.then(|| judged.into_iter().map(|d| d.1).collect())
    }
}

/// A residual below this share of the measured values is rounding.
const ROUNDING: f64 = 1e-13;

/// Beside the upper quartile of the values: one that is huge says nothing of the digits of the others.
fn fits_exactly(system: &dyn MeasurementModel, base: &Hypothesis) -> bool {
    let mut sizes: Vec<f64> = system.measured().iter().map(|v| v.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let size = sizes.get(3 * sizes.len() / 4).copied().unwrap_or(0.0);
    base.fit.residual.iter().all(|r| r.abs() <= ROUNDING * size)
}

/// Whether two noise models whiten alike, within a quarter.
fn alike(a: &Weights, b: &Weights) -> bool {
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
    shared && a.relative().iter().zip(b.relative()).all(|(x, y)| near(*x, *y))
}

/// Chance below which something is there, even where the name that was found for it is taken back.
const NO_CHANCE: f64 = 1e-3;

/// Takes back what does not earn its name on readings that are left out, and calls what is then left by its size.
fn within_model_error(system: &dyn MeasurementModel, found: &mut SearchResult, options: &Options) {
    let (best, within) = earned(system, &found.best);
    let mut small = found.last_test.is_small(&found.best.fit);
    if !within.is_empty() {
        // Where nothing was left beside it, what is left is what was taken back: a finding of chance, or more than that.
        let nothing_beside = small || !found.last_test.generic();
        found.last_test = omnibus_test(system, &best.fit, &best.weights, options);
        found.last_test.leave_out(&best.fit, &within);
        let by_chance = found.last_test.p_covariates.min(found.last_test.p_serial) >= NO_CHANCE;
        small = (nothing_beside && by_chance) || found.last_test.is_small(&best.fit);
        let lacks = |h: &Hypothesis| h.fit.terms.iter().all(|t| !within.contains(&t.effect));
        found.survivors = vec![best.clone()];
        found.refitted.retain(lacks);
        found.refitted.insert(0, best.clone());
        found.best = best;
        found.within_model_error = within;
    }
    found.last_test.within_model_error = small;
}

/// Runs the search under the noise that the readings themselves show.
pub fn explain(system: &dyn MeasurementModel, options: &Options) -> Option<Explained> {
    let mut judge = NoiseEstimator::new(system, options.seed);
    let mut weights = Weights::independent(judge.inputs.own(0.0));
    let base = declared(system, &weights, options.seed)?;
    let declared_noise = judge.noise(&base, &[])?.0;
    let mut options = options.clone();
    let mut found = search(system, &weights, &options)?;
    if fits_exactly(system, &base) {
        found.best = base;
        let noise = Noise::none(&declared_noise);
        return Some(Explained { found, declared_noise: noise.clone(), noise, exact: true });
    }
    // What independent readings would follow, for the comparison at the end.
    let plain_test = found.first_test.clone();
    for _ in 1..MAX_SEARCHES {
        // Neighbours share something: whether it is noise or an effect is the question, not whether it is there.
        if found.last_test.generic() {
            judge.correlated_gain = CORRELATED_PRICE;
        }
        // A model that is degenerate under another noise is judged under the one that it was found with.
        let kept = judge.confirmed(&found).unwrap_or_else(|| found.best.clone());
        let Some((noise, _)) = judge.noise(&kept, &[]) else { break };
        let dropped = kept.fit.terms.len() < found.best.fit.terms.len();
        let tails_dof = noise.tails.filter(|t| t.heavy).map(|t| t.dof);
        let retail = tails_dof.is_some() && options.tails_dof.is_none() && found.is_inadequate();
        if !dropped && !retail && alike(&noise.weights, &weights) {
            break;
        }
        // What correlated noise would swallow may be an effect that no catalogue has: the better description stands.
        if !dropped
            && found.last_test.generic()
            && let Some(scores) = judge.driven(&kept, &found.last_test)
        {
            found.last_test.covariates = scores;
            break;
        }
        weights = noise.weights.unmasked();
        options.tails_dof = tails_dof;
        found = search(system, &weights, &options)?;
    }
    // Correlated noise that takes up everything is one description; a smooth course that no catalogue has may be the better one.
    let nothing = found.best.fit.terms.is_empty() && found.left().is_none();
    let correlated = |h: &Hypothesis| judge.noise(h, &[]).is_some_and(|n| n.0.correlated.is_some());
    if nothing
        && correlated(&found.best)
        && let Some(scores) = judge.driven(&found.best, &plain_test)
    {
        found.first_test.covariates = scores;
        found.covariate_beats_catalogue = true;
    }
    if system.judged_left_out() {
        within_model_error(system, &mut found, &options);
    }
    let columns = found.left().and_then(|g| g.covariates.first()).map_or(Vec::new(), |d| d.columns.clone());
    let noise = judge.noise(&found.best, &columns).or_else(|| judge.noise(&found.best, &[]));
    let noise = noise.map_or_else(|| declared_noise.clone(), |n| n.0);
    Some(Explained { found, noise, declared_noise, exact: false })
}
