//! Tails of the noise, and readings that no tails explain.
//!
//! Standardised residuals z are taken as Student's t with `nu` degrees of freedom and scale `sigma`
//! (nu = infinity: Gaussian). To judge the k largest, the fit must not see how large they are and
//! must not forget that they are there: they enter as censored at the largest of the others, c
//! (type II censoring; Lawless, "Statistical Models and Methods for Lifetime Data", 2nd ed., ch.
//! 3):
//!
//! ```text
//! log L(nu, sigma) = sum over the others of log f(z / sigma) / sigma  +  k log P(|t_nu| > c / sigma)
//! p_k = P(at least k of N values exceed the k-th largest) = binomial tail with P(|t_nu| > z_k / sigma)
//! ```
//!
//! `nu` is not known: p_k is averaged over it with the likelihood of the others as weight, a
//! Gaussian of large odds before. Heavy tails are earned by several values: a single one far
//! outside others that are Gaussian does not make the noise heavy-tailed. Of the Gaussian the scale
//! is not known either: its largest values are those of an externally studentised t.

use crate::levels::{GAUSSIAN_ODDS, USUAL, gain, gain_at_bound};
use statrs::distribution::{Binomial, Continuous, ContinuousCDF, DiscreteCDF, Normal, StudentsT};
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
    /// 95 % interval of the degrees of freedom.
    pub interval95: [f64; 2],
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

/// Density of |t_nu| at `x`.
fn two_sided_density(nu: f64, x: f64) -> f64 {
    if nu.is_infinite() {
        2.0 * Normal::standard().pdf(x)
    } else {
        StudentsT::new(0.0, 1.0, nu).map_or(0.0, |t| 2.0 * t.pdf(x))
    }
}

/// Log likelihood of sorted sizes `z` (rising) with `censored` values beyond the last, and the
/// scale that maximises it.
fn likelihood(nu: f64, z: &[f64], censored: usize) -> (f64, f64) {
    let (n, k) = (z.len() as f64, censored as f64);
    let last = z.last().copied().unwrap_or(0.0);
    // Type II censoring: of the k largest only that they exceed c is used.
    let beyond = |sigma: f64| two_sided_tail(nu, last / sigma).max(1e-300);
    // d log L / d log sigma falls with sigma: each weight and the hazard do.
    let score = |log_sigma: f64| {
        let sigma = log_sigma.exp();
        let body: f64 = if nu.is_infinite() {
            z.iter().map(|v| v * v).sum::<f64>() / (sigma * sigma)
        } else {
            let scale = nu * sigma * sigma;
            (nu + 1.0) * z.iter().map(|v| v * v / (scale + v * v)).sum::<f64>()
        };
        let x = last / sigma;
        let hazard = x * two_sided_density(nu, x) / beyond(sigma);
        body - n + if censored == 0 { 0.0 } else { k * hazard }
    };
    // Within the scales that the median allows.
    let median = z[z.len() / 2].max(1e-300);
    let sigma = root_of_falling(score, [0.6, 4.0].map(|share| (share * median).ln())).exp();
    let body: f64 = if nu.is_infinite() {
        -0.5 * z.iter().map(|v| v * v).sum::<f64>() / (sigma * sigma)
    } else {
        // ln(1 + z^2 / (nu sigma^2)) by ln_1p: at large nu the sum would lose the small term.
        let inverse = 1.0 / (nu * sigma * sigma);
        -0.5 * (nu + 1.0) * z.iter().map(|v| (v * v * inverse).ln_1p()).sum::<f64>()
    };
    let tail = if censored == 0 {
        0.0
    } else {
        k * beyond(sigma).ln()
    };
    (body + tail + n * (log_norm(nu) - sigma.ln()), sigma)
}

/// Logarithms of a scale that are one.
const RESOLVED: f64 = 1e-9;

/// Where `f`, which falls, is zero between two places; the nearer end where it is not. False
/// position by Illinois (Dowell & Jarratt, BIT 11 (1971), 168).
fn root_of_falling(f: impl Fn(f64) -> f64, [low, high]: [f64; 2]) -> f64 {
    let (mut a, mut b) = ((low, f(low)), (high, f(high)));
    if a.1 <= 0.0 || b.1 >= 0.0 {
        return if a.1 <= 0.0 { low } else { high };
    }
    let mut rose = None;
    while b.0 - a.0 > RESOLVED {
        let x = (a.0 * b.1 - b.0 * a.1) / (b.1 - a.1);
        let at = (x, f(x));
        if (x - a.0).min(b.0 - x) < RESOLVED {
            return x;
        }
        // An end that stays twice counts half: both come near.
        let stays = if rose == Some(at.1 > 0.0) { 0.5 } else { 1.0 };
        rose = Some(at.1 > 0.0);
        if at.1 > 0.0 {
            (a, b.1) = (at, stays * b.1);
        } else {
            (b, a.1) = (at, stays * a.1);
        }
    }
    0.5 * (a.0 + b.0)
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
    let bound = gain_at_bound(USUAL);
    let within = |f: &&(f64, (f64, f64))| 2.0 * (best - f.1.0) <= bound;
    let gaussian = fits[NU.len() - 1].1.0;
    let top = fits
        .iter()
        .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
        .unwrap_or(&fits[NU.len() - 1]);
    let heaviest = fits.iter().find(within).unwrap_or(top);
    // Of the few tails that are tried, those next to the interval's end may still lie in it.
    let inside = fits.map(|f| 2.0 * (best - f.1.0) <= gain(USUAL, 1));
    let first = inside
        .iter()
        .position(|i| *i)
        .unwrap_or(0)
        .saturating_sub(1);
    let last = inside
        .iter()
        .rposition(|i| *i)
        .map_or(NU.len() - 1, |k| (k + 1).min(NU.len() - 1));
    Tails {
        dof: top.0,
        scale: top.1.1,
        heaviest: heaviest.0,
        heaviest_scale: heaviest.1.1,
        interval95: [NU[first], NU[last]],
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

/// Degrees of freedom from which others say how large the noise is.
const MIN_DOF: usize = 3;

/// Looks for outlying values among `residuals` of a fit with `dof` degrees of freedom, at most
/// `most` of them: from the most downwards, the first number whose p-value is below its share of
/// `level`.
pub(crate) fn extreme_values(
    residuals: &[f64],
    most: usize,
    dof: usize,
    level: f64,
) -> Option<ExtremeValues> {
    let mut sorted: Vec<f64> = residuals.iter().map(|z| z.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n == 0 || !(sorted[n / 2] > 0.0) {
        return None;
    }
    let most = most.min(n / 4).min(dof.saturating_sub(MIN_DOF));
    // Values that a Gaussian gives without any effort need no fit.
    let effortless = 3.0 * sorted[n / 2] / 0.674;
    let looks = sorted
        .iter()
        .rev()
        .take(most)
        .take_while(|z| **z >= effortless)
        .count();
    for k in (1..=looks).rev() {
        let largest = sorted[n - k];
        let (fits, best) = fits(&sorted[..n - k], k);
        // p_k of each tail, averaged with the likelihood of the others as weight.
        let (mut sum, mut whole) = (0.0, 0.0);
        for (nu, (log_likelihood, scale)) in fits {
            let gaussian = nu.is_infinite();
            let of = if gaussian { (dof - k) as f64 } else { nu };
            let single = two_sided_tail(of, largest / scale).clamp(0.0, 1.0);
            // Relative to the best: the exponentials cannot all underflow.
            let weight = (log_likelihood - best).exp() * if gaussian { GAUSSIAN_ODDS } else { 1.0 };
            sum += weight * Binomial::new(single, n as u64).map_or(1.0, |b| b.sf(k as u64 - 1));
            whole += weight;
        }
        let p_value = sum / whole;
        // Each number of values is one more look (Bonferroni).
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

    /// Share of `samples` in which something is flagged although nothing was added; degrees of
    /// freedom in turn.
    fn flagged(nus: &[Option<f64>], n: usize, level: f64, samples: u64) -> f64 {
        let nu = |s: u64| nus[s as usize % nus.len()];
        let hits = (0..samples)
            .filter(|s| extreme_values(&draws(nu(*s), n, *s), 8, n, level).is_some())
            .count();
        hits as f64 / samples as f64
    }

    #[test]
    fn heavy_tails_are_not_flagged_and_a_gross_reading_is_alone() {
        // Of 300 tables: the level where the noise is Gaussian, and what tails cost that few values
        // do not show.
        for (nu, n, most) in [
            (None, 22, 0.017),
            (None, 60, 0.017),
            (Some(3.0), 60, 0.08),
            (Some(3.0), 600, 0.017),
        ] {
            let rate = flagged(&[nu], n, 2e-3, 300);
            assert!(rate <= most, "{nu:?} {n}: {rate}");
        }
        // Of tails by their odds, for which p is exact, all looks together spend the level: 78 of
        // 1200 are beyond chance at 0.01.
        let mut nus = NU.map(|nu| Some(nu).filter(|nu| nu.is_finite())).to_vec();
        nus.resize(NU.len() + GAUSSIAN_ODDS as usize, None);
        for n in [22, 60] {
            let rate = flagged(&nus, n, 0.05, 1200);
            println!("{n}: {rate}");
            assert!(rate < 0.065, "{n}: {rate}");
        }
        for (seed, size) in [(1, 40.0), (2, 100.0), (3, 2000.0)] {
            let mut z = draws(None, 72, seed);
            z[17] += size;
            let found = extreme_values(&z, 8, 72, 2e-3).unwrap();
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
                extreme_values(&z, 2, n, 2e-3).is_some_and(|f| f.count == 1)
            };
            (0..100).filter(|s| one(*s)).count()
        };
        let (few, more) = (found(10, 12.0), found(60, 8.0));
        assert!(few >= 90 && more >= 65, "{few} {more}");
        // Control: what noise gives now and then is none.
        assert!(found(22, 3.0) <= 5, "{}", found(22, 3.0));
    }

    #[test]
    fn the_interval_of_the_degrees_of_freedom_holds_them() {
        let (mut held, mut nearest) = (0, 0);
        for seed in 0..200 {
            let nu = (3f64.ln() + (seed as f64 / 200.0) * 4f64.ln()).exp();
            let found = tails(&draws(Some(nu), 400, seed)).unwrap();
            held += usize::from((found.interval95[0]..=found.interval95[1]).contains(&nu));
            // Control: a tenth on either side of the best.
            nearest += usize::from((0.9 * found.dof..1.1 * found.dof).contains(&nu));
        }
        assert!(held >= 184 && nearest < 150, "{held} {nearest}");
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
