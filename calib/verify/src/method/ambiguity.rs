//! Competing explanations: which of them the likelihood ratio to the best one does not reject, by
//! parametric bootstrap on the tangent models.
//!
//! Cox's test of separate families (Cox 1962; Davidson & MacKinnon 1981): were the rival true, how
//! often would it fall this far behind the best? In tangent models the answer depends on the noise
//! only through the span of both models and of what separates them, so a draw costs a few dozen
//! products instead of a refit.

use super::hypothesis::Hypothesis;
use super::linear::Basis;
use super::options::Options;
use super::refine::refit;
use super::signature::nuisance_basis;
use crate::effect::EffectTerm;
use crate::levels::RIVAL;
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};

/// Tangent space of an explanation; a flagged reading is free in every channel.
fn tangent_space(h: &Hypothesis) -> Basis {
    let mut basis = nuisance_basis(&h.fit);
    for direction in h.flagged.iter().flat_map(|&i| h.fit.directions_of(i)) {
        basis.push(&direction);
    }
    basis
}

/// Coordinates of the vectors of `part` in `whole`, one row each.
fn project_onto(part: &Basis, whole: &Basis) -> DMatrix<f64> {
    let rows: Vec<_> = part
        .vectors()
        .iter()
        .map(|v| whole.coordinates(v).transpose())
        .collect();
    if rows.is_empty() {
        DMatrix::zeros(0, whole.rank())
    } else {
        DMatrix::from_rows(&rows)
    }
}

/// Chance, were `rival` true, that it falls at least as far behind `best` as it does; `variance` is
/// the best one's.
pub(crate) fn cox_test(
    best: &Hypothesis,
    rival: &Hypothesis,
    variance: f64,
    draws: usize,
    seed: u64,
) -> f64 {
    if !(variance > 0.0) || draws == 0 {
        return 1.0;
    }
    let (of_best, of_rival) = (tangent_space(best), tangent_space(rival));
    // Prediction of the rival less that of the best, in noises: what the best would still see were
    // the rival true.
    let gap = (best.fit.stacked() - rival.fit.stacked()) / variance.sqrt();
    let seen = of_best.project_off(&gap);
    let mut whole = of_best.clone();
    for v in of_rival.vectors() {
        whole.push(v);
    }
    whole.push(&seen);
    let (best_rows, rival_rows) = (
        project_onto(&of_best, &whole),
        project_onto(&of_rival, &whole),
    );
    // Noise along the difference of both predictions decides which of them is nearer.
    let direction = whole.coordinates(&seen);
    let lambda = seen.norm_squared();
    let behind = (rival.fit.ssr - best.fit.ssr) / variance;
    let dof = best.fit.dof.max(1.0);
    let Ok(spread) = ChiSquared::new(dof) else {
        return 1.0;
    };
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut noise = DVector::zeros(whole.rank());
    let mut reached = 0usize;
    for _ in 0..draws {
        noise
            .iter_mut()
            .for_each(|z| *z = StandardNormal.sample(&mut rng));
        let taken = (&rival_rows * &noise).norm_squared() - (&best_rows * &noise).norm_squared();
        // Squares of the rival less those of the best, were the rival true, over an estimated
        // variance.
        let fall = -(lambda + 2.0 * direction.dot(&noise) + taken) * dof / spread.sample(&mut rng);
        reached += usize::from(fall >= behind);
    }
    // Never 0: the draws cannot show less than one in their number.
    (reached + 1) as f64 / (draws + 1) as f64
}

/// Rivals that were rejected and are refitted once more, the best first.
const REFITTED: usize = 7;

/// Chance of each explanation of `level`, the first being `best`, to fall as far behind were it
/// true; what fits better from the best one's values takes its own place.
pub(crate) fn cox_p_values(
    system: &dyn MeasurementModel,
    best: &Hypothesis,
    level: &mut [Hypothesis],
    options: &Options,
) -> Vec<f64> {
    let (variance, count) = (best.fit.variance(), level.len() as f64);
    let one = |(k, h): (usize, &mut Hypothesis)| {
        options
            .progress
            .at("comparing explanations", k as f64 / count);
        let p =
            |h: &Hypothesis| cox_test(best, h, variance, options.draws, options.seed + k as u64);
        match p(h) {
            _ if k == 0 => 1.0,
            rejected if rejected < RIVAL && k <= REFITTED => {
                let Some(nearer) = from_shared_values(system, h, best) else {
                    return rejected;
                };
                *h = nearer;
                p(h)
            }
            p => p,
        }
    };
    level.iter_mut().enumerate().map(one).collect()
}

/// A rival refitted from the best explanation's values of the terms that both have, where it then
/// fits better: a period has many minima, and a rival that stays in another one is rejected for
/// that alone.
fn from_shared_values(
    system: &dyn MeasurementModel,
    h: &Hypothesis,
    best: &Hypothesis,
) -> Option<Hypothesis> {
    let shared = |t: &EffectTerm| {
        best.fit
            .terms
            .iter()
            .find(|b| (b.effect, b.law) == (t.effect, t.law))
    };
    let terms: Vec<EffectTerm> = h
        .fit
        .terms
        .iter()
        .map(|t| shared(t).unwrap_or(t).clone())
        .collect();
    let start = (terms != h.fit.terms).then_some(terms)?;
    refit(system, &[start], h)
        .filter(|nearer| nearer.is_admissible(system) && nearer.fit.ssr < h.fit.ssr)
}

/// Chance that readings of noncentrality `lambda` (in variances) between two explanations reject
/// the wrong one, the other true.
pub fn power(lambda: f64) -> f64 {
    use statrs::distribution::{ContinuousCDF, Normal};
    if lambda <= 0.0 {
        return 0.0;
    }
    let normal = Normal::standard();
    // The lag of the wrong one is about N(lambda, 4 lambda); it is rejected beyond the level's
    // quantile of N(-lambda, 4 lambda).
    let limit = (2.0 * lambda.sqrt() * normal.inverse_cdf(1.0 - RIVAL) - lambda).max(0.0);
    normal.cdf((lambda - limit) / (2.0 * lambda.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::fit::{Fit, Status, Weights};
    use std::sync::Arc;

    /// The model `y = columns b` with every b fitted.
    fn hypothesis(columns: &DMatrix<f64>, y: &DVector<f64>) -> Hypothesis {
        let (n, p) = columns.shape();
        let b = columns
            .clone()
            .svd(true, true)
            .solve(y, 1e-12)
            .expect("full rank");
        let residual = y - columns * &b;
        let fit = Fit {
            terms: Vec::new(),
            coefficients: DMatrix::from_column_slice(p, 1, b.as_slice()),
            residual: DMatrix::from_column_slice(n, 1, residual.as_slice()),
            design: columns.clone(),
            raw_design: columns.clone(),
            raw_residual: DMatrix::from_column_slice(n, 1, residual.as_slice()),
            raw_tangents: Vec::new(),
            auxiliary_residual: DVector::zeros(0),
            auxiliary_readings: Arc::default(),
            witness_count: 0,
            ssr: residual.norm_squared(),
            dof: (n - p) as f64,
            tangents: Vec::new(),
            at_bound: Vec::new(),
            status: Status::Converged,
        };
        Hypothesis {
            fit,
            weights: Weights::equal(n),
            flagged: Vec::new(),
            flag_p: 1.0,
        }
    }

    const TRIALS: usize = 1500;

    /// Sinusoids of rising frequency: `phase` sets two families apart.
    fn columns(count: usize, phase: f64) -> DMatrix<f64> {
        DMatrix::from_fn(60, count, |i, k| {
            (i as f64 * 0.37 * (1.0 + 0.31 * k as f64) + phase).sin()
        })
    }

    /// Share of draws in which a true rival with `of_rival` parameters, at `distance` noises from
    /// the other model with `of_best`, loses and is rejected; `true_is_rival` false: the share in
    /// which the false one is.
    fn rejected(distance: f64, [of_best, of_rival]: [usize; 2], true_is_rival: bool) -> f64 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7 + distance as u64);
        let (wrong, right) = (columns(of_best, 0.0), columns(of_rival, 0.6));
        let of_wrong = wrong.clone().svd(true, false).u.expect("asked for");
        let course = right.column_sum();
        let off = &course - &of_wrong * (of_wrong.transpose() * &course);
        let truth = &course * (distance / off.norm());
        let mut count = 0;
        for k in 0..TRIALS as u64 {
            let y = truth.map(|t| {
                let z: f64 = StandardNormal.sample(&mut rng);
                t + z
            });
            let (wrong, right) = (hypothesis(&wrong, &y), hypothesis(&right, &y));
            let (best, rival) = if true_is_rival {
                (&wrong, &right)
            } else {
                (&right, &wrong)
            };
            if best.fit.ssr > rival.fit.ssr {
                continue;
            }
            count += u32::from(cox_test(best, rival, best.fit.variance(), 400, k) < RIVAL);
        }
        f64::from(count) / TRIALS as f64
    }

    #[test]
    fn a_true_explanation_is_rejected_no_more_often_than_the_level() {
        // A model with more parameters follows more of the noise: the rate must hold whichever of
        // the two has them.
        for parameters in [[1, 1], [1, 8], [2, 4], [4, 2], [8, 1], [8, 8]] {
            for distance in [0.5, 2.0, 4.0] {
                let rate = rejected(distance, parameters, true);
                // Three standard deviations above the level.
                let limit = RIVAL + 3.0 * (RIVAL / TRIALS as f64).sqrt();
                assert!(
                    rate <= limit,
                    "{parameters:?} at {distance}: {rate} > {limit}"
                );
            }
        }
    }

    #[test]
    fn a_false_explanation_is_rejected_as_often_as_the_power_says() {
        for distance in [3.0_f64, 4.0, 5.0] {
            let (rate, expected) = (
                rejected(distance, [1, 1], false),
                power(distance * distance),
            );
            assert!(
                (rate - expected).abs() < 0.05,
                "{distance}: {rate} against {expected}"
            );
        }
    }
}
