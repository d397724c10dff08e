//! Tails of the noise, and readings that no tails explain.
//!
//! Standardised residuals z are taken as Student's t with `nu` degrees of freedom and scale `sigma` (nu = infinity: Gaussian). To judge the
//! k largest, the fit must not see how large they are and must not forget that they are there: they enter as censored at the largest of
//! the others, c (type II censoring; Lawless, "Statistical Models and Methods for Lifetime Data", 2nd ed., ch. 3):
//!
//! ```text
//! log L(nu, sigma) = sum over the others of log f(z / sigma) / sigma  +  k log P(|t_nu| > c / sigma)
//! p_k = P(at least k of N values exceed the k-th largest) = binomial tail with P(|t_nu| > z_k / sigma)
//! ```
//!
//! `nu` is not known: p_k is averaged over it with the likelihood of the others as weight (equal odds before). Heavy tails flag little where the
//! others show them; where the others are Gaussian, a single reading far outside does not make the noise heavy-tailed by itself.

use crate::levels::{gain, gain_at_bound};
use statrs::distribution::{Binomial, ContinuousCDF, DiscreteCDF, Normal, StudentsT};
use statrs::function::gamma::ln_gamma;

/// Degrees of freedom that are tried, heaviest tails first.
const NU: [f64; 9] = [3.0, 4.0, 5.0, 6.5, 8.5, 12.0, 20.0, 40.0, f64::INFINITY];
/// Fitted tails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tails {
    /// Degrees of freedom; infinite for a Gaussian.
    pub dof: f64,
    /// Heaviest tails within the one-sided 95 % bound.
    pub heaviest: f64,
    /// Lightest tails within it.
    pub lightest: f64,
    /// Scale of the residuals at `dof`.
    pub scale: f64,
    /// Scale at `heaviest`.
    pub heaviest_scale: f64,
    /// Heavier than a Gaussian beyond doubt.
    pub heavy: bool,
    /// Heavy by the largest value alone: the others are not.
    pub by_one: bool,
}

impl Tails {
    /// Chance of a value beyond `x` standard deviations on either side, by the heaviest tails.
    pub fn two_sided(&self, x: f64) -> f64 {
        two_sided_tail(self.heaviest, x / self.heaviest_scale.max(1e-3))
    }
}

/// P(|t_nu| > x).
fn two_sided_tail(nu: f64, x: f64) -> f64 {
    if nu.is_infinite() {
        2.0 * Normal::standard().sf(x)
    } else {
        StudentsT::new(0.0, 1.0, nu).map_or(1.0, |t| 2.0 * t.sf(x))
    }
}

/// Log density of t_nu without the terms of x.
fn log_norm(nu: f64) -> f64 {
    if nu.is_infinite() {
        -0.5 * std::f64::consts::TAU.ln()
    } else {
        ln_gamma(0.5 * (nu + 1.0)) - ln_gamma(0.5 * nu) - 0.5 * (nu * std::f64::consts::PI).ln()
    }
}

/// Log likelihood of sorted sizes `z` (rising) with `censored` values beyond the last, and the scale that maximises it.
fn likelihood(nu: f64, z: &[f64], censored: usize) -> (f64, f64) {
    let last = z.last().copied().unwrap_or(0.0);
    let at = |sigma: f64| -> f64 {
        let body: f64 = if nu.is_infinite() {
            -0.5 * z.iter().map(|v| v * v).sum::<f64>() / (sigma * sigma)
        } else {
            // ln(1 + z^2 / (nu sigma^2)) by ln_1p: at large nu the sum would lose the small term.
            let inverse = 1.0 / (nu * sigma * sigma);
            -0.5 * (nu + 1.0) * z.iter().map(|v| (v * v * inverse).ln_1p()).sum::<f64>()
        };
        // Type II censoring: of the k largest only that they exceed c is used.
        let tail = if censored == 0 {
            0.0
        } else {
            censored as f64 * two_sided_tail(nu, last / sigma).max(1e-300).ln()
        };
        body + tail + z.len() as f64 * (log_norm(nu) - sigma.ln())
    };
    // One maximum in the logarithm of the scale: golden section about the median's scale.
    let median = z[z.len() / 2].max(1e-300);
    let (mut a, mut b) = ((0.6 * median).ln(), (4.0 * median).ln());
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut x, mut y) = (b - golden * (b - a), a + golden * (b - a));
    let (mut fx, mut fy) = (at(x.exp()), at(y.exp()));
    for _ in 0..18 {
        if fx > fy {
            (b, y, fy) = (y, x, fx);
            x = b - golden * (b - a);
            fx = at(x.exp());
        } else {
            (a, x, fx) = (x, y, fy);
            y = a + golden * (b - a);
            fy = at(y.exp());
        }
    }
    let sigma = (0.5 * (a + b)).exp();
    (at(sigma), sigma)
}

/// Degrees of freedom, log likelihood and scale of each of [`NU`].
type Fits = [(f64, (f64, f64)); NU.len()];

/// All tails, and the largest log likelihood.
fn fits(z: &[f64], censored: usize) -> (Fits, f64) {
    let fits = NU.map(|nu| (nu, likelihood(nu, z, censored)));
    (
        fits,
        fits.iter().map(|f| f.1.0).fold(f64::NEG_INFINITY, f64::max),
    )
}

/// Tails of sorted standardised residuals.
fn fit_sorted(sorted: &[f64]) -> Tails {
    let (fits, best) = fits(sorted, 0);
    // One-sided 95 % bound of a likelihood.
    let bound = gain_at_bound(0.05);
    let within = |f: &&(f64, (f64, f64))| 2.0 * (best - f.1.0) <= bound;
    let gaussian = fits[NU.len() - 1].1.0;
    let top = fits
        .iter()
        .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
        .unwrap_or(&fits[NU.len() - 1]);
    let heaviest = fits.iter().find(within).unwrap_or(top);
    let lightest = fits.iter().rev().find(within).unwrap_or(top);
    Tails {
        dof: top.0,
        scale: top.1.1,
        heaviest: heaviest.0,
        heaviest_scale: heaviest.1.1,
        lightest: lightest.0,
        heavy: 2.0 * (best - gaussian) > gain(0.01, 1),
        by_one: false,
    }
}

/// Tails of standardised residuals (of readings that count); none of too few.
pub fn tails(residuals: &[f64]) -> Option<Tails> {
    let mut sorted: Vec<f64> = residuals.iter().map(|z| z.abs()).collect();
    if sorted.len() < 20 {
        return None;
    }
    sorted.sort_by(f64::total_cmp);
    (sorted[sorted.len() / 2] > 0.0).then(|| {
        let all = fit_sorted(&sorted);
        Tails {
            by_one: all.heavy && !fit_sorted(&sorted[..sorted.len() - 1]).heavy,
            ..all
        }
    })
}

/// The largest values that no tails explain, and their p-value.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtremeValues {
    /// Values above this size.
    pub beyond: f64,
    /// How many.
    pub count: usize,
    /// Chance that so many values of N lie so far out.
    pub p_value: f64,
}

/// Fewer values say nothing of their tails.
const MIN_VALUES: usize = 12;

/// Looks for outlying values among `residuals`, at most `most` of them: from the most downwards, the first number whose p-value is below its share
/// of `level`.
pub fn extreme_values(residuals: &[f64], most: usize, level: f64) -> Option<ExtremeValues> {
    let mut sorted: Vec<f64> = residuals.iter().map(|z| z.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n < MIN_VALUES || !(sorted[n / 2] > 0.0) {
        return None;
    }
    // Values that a Gaussian gives without any effort need no fit.
    let effortless = 3.0 * sorted[n / 2] / 0.674;
    let looks = sorted
        .iter()
        .rev()
        .take(most.min(n / 4))
        .take_while(|z| **z >= effortless)
        .count();
    for k in (1..=looks).rev() {
        let largest = sorted[n - k];
        let (fits, best) = fits(&sorted[..n - k], k);
        // p_k of each tail, averaged with the likelihood of the others as weight.
        let (mut sum, mut whole) = (0.0, 0.0);
        for (nu, (log_likelihood, scale)) in fits {
            let single = two_sided_tail(nu, largest / scale).clamp(0.0, 1.0);
            // Relative to the best: the exponentials cannot all underflow.
            let weight = (log_likelihood - best).exp();
            sum += weight * Binomial::new(single, n as u64).map_or(1.0, |b| b.sf(k as u64 - 1));
            whole += weight;
        }
        let p_value = sum / whole;
        // Each number of values is a look of its own (Bonferroni).
        if p_value < level / looks as f64 {
            return Some(ExtremeValues {
                beyond: largest,
                count: k,
                p_value: p_value.max(1e-300),
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal, StudentT};

    fn draws(nu: Option<f64>, n: usize, seed: u64) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        match nu {
            Some(nu) => StudentT::new(nu)
                .unwrap()
                .sample_iter(&mut rng)
                .take(n)
                .collect(),
            None => (0..n).map(|_| StandardNormal.sample(&mut rng)).collect(),
        }
    }

    /// Share of `samples` in which something is flagged although nothing was added; degrees of freedom in turn.
    fn flagged(nus: &[Option<f64>], n: usize, level: f64, samples: u64) -> f64 {
        let nu = |s: u64| nus[s as usize % nus.len()];
        let hits = (0..samples)
            .filter(|s| extreme_values(&draws(nu(*s), n, *s), 8, level).is_some())
            .count();
        hits as f64 / samples as f64
    }

    #[test]
    fn heavy_tails_are_not_flagged_and_a_gross_reading_is_alone() {
        for nu in [Some(3.0), Some(5.0), Some(8.0), None] {
            for n in [22, 60, 600] {
                let rate = flagged(&[nu], n, 2e-3, 300);
                // More than 8 hits at a level of 0.002 would be beyond chance at 0.01.
                assert!(rate <= 0.027, "{nu:?} {n}: {rate}");
            }
        }
        // Of tails with equal odds, for which p is exact, all looks together spend the level: 78 of 1200 are beyond chance at 0.01.
        let nus = NU.map(|nu| Some(nu).filter(|nu| nu.is_finite()));
        for n in [22, 60] {
            let rate = flagged(&nus, n, 0.05, 1200);
            println!("{n}: {rate}");
            assert!(rate < 0.065, "{n}: {rate}");
        }
        for (seed, size) in [(1, 40.0), (2, 100.0), (3, 2000.0)] {
            let mut z = draws(None, 72, seed);
            z[17] += size;
            let found = extreme_values(&z, 8, 2e-3).unwrap();
            assert_eq!(found.count, 1, "{found:?}");
        }
    }

    /// A single reading does not make the noise of few readings heavy-tailed.
    #[test]
    fn a_gross_reading_of_few_is_told_from_heavy_tails() {
        let found = |n: usize, size: f64| {
            let one = |seed: u64| {
                let mut z = draws(None, n, seed);
                z[n / 2] += size;
                extreme_values(&z, 2, 2e-3).is_some_and(|f| f.count == 1)
            };
            (0..100).filter(|s| one(*s)).count()
        };
        let (few, more) = (found(14, 20.0), found(22, 15.0));
        assert!(few >= 80 && more >= 70, "{few} {more}");
        // Control: five standard deviations are none, of heavy tails or not.
        assert!(found(22, 5.0) <= 5, "{}", found(22, 5.0));
    }

    #[test]
    fn tails_are_named_where_they_are_heavy() {
        let named = |nu, n| {
            (0..100)
                .filter(|s| tails(&draws(nu, n, *s)).unwrap().heavy)
                .count()
        };
        assert!(
            named(Some(4.0), 600) >= 90 && named(None, 600) <= 3,
            "{} {}",
            named(Some(4.0), 600),
            named(None, 600)
        );
        // One of them makes a Gaussian sample heavy; many are heavy without it.
        let mut z = draws(None, 30, 4);
        z[7] = 9.0;
        assert!(tails(&z).unwrap().by_one && !tails(&draws(Some(3.0), 600, 1)).unwrap().by_one);
    }
}
