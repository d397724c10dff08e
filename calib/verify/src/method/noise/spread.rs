//! Does the spread of the readings change with the stimulus? A score test with a permutation
//! p-value, and the variance model.
//!
//! Breusch & Pagan, Econometrica 47 (1979): the squared residuals are regressed on the stimulus.
//! Their cube root stands in for them (Wilson & Hilferty 1931), nearly normal where squares have
//! heavy tails. The variance model is Harvey's (Econometrica 44, 1976).

use crate::levels::NORMAL_95;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fewer readings say nothing about a trend of the spread.
pub(crate) const MIN_READINGS: usize = 20;

/// Permutations at least as far out at which the p-value is known well enough.
const ENOUGH: usize = 20;

/// Standard normal score that no permutation of a few thousand reaches.
const OUT_OF_REACH: f64 = 6.0;

/// How the standard deviation follows the stimulus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SpreadLaw {
    /// sd ~ stimulus^b; only where every stimulus is positive.
    Power,
    /// sd ~ exp(b u), u in half ranges.
    Exponential,
}

/// Result of the test and the fitted variance model.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Permutation p-value of the score.
    pub p_value: f64,
    /// Correlation of spread and stimulus: its sign says where the noise is larger.
    pub correlation: f64,
    /// Law of the better likelihood.
    pub law: SpreadLaw,
    /// Exponent b with its 95 % interval.
    pub exponent: f64,
    /// 95 % interval of the exponent.
    pub interval95: [f64; 2],
    /// Relative standard deviation of each reading, geometric mean 1.
    pub relative_sd: Vec<f64>,
}

/// Spreads beyond these factors of a typical one are not believed.
const SPREAD_RANGE: [f64; 2] = [0.02, 50.0];

/// Standard deviation over that at the centre, `distance` from it on the law's scale. A power law
/// has none at a stimulus of zero.
pub(crate) fn relative_sd(exponent: f64, distance: f64) -> f64 {
    let [least, most] = SPREAD_RANGE;
    (exponent * distance).exp().clamp(least, most)
}

fn centred(v: &[f64]) -> Vec<f64> {
    let mean = v.iter().sum::<f64>() / v.len() as f64;
    v.iter().map(|x| x - mean).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Fits log sd = a + b z by Fisher scoring; returns b, its standard error and the negative log
/// likelihood.
fn fit_log_linear_variance(residual: &[f64], z: &[f64]) -> (f64, f64, f64) {
    let n = residual.len() as f64;
    let z = centred(z);
    let zz = dot(&z, &z);
    let mut b = 0.0;
    let mut a = 0.5
        * (residual.iter().map(|r| r * r).sum::<f64>() / n)
            .max(1e-300)
            .ln();
    for _ in 0..60 {
        let w: Vec<f64> = residual
            .iter()
            .zip(&z)
            .map(|(r, z)| r * r * (-2.0 * (a + b * z)).exp() - 1.0)
            .collect();
        // Fisher scoring: level and slope of log sigma are orthogonal where z is centred.
        let (da, db) = (0.5 * w.iter().sum::<f64>() / n, 0.5 * dot(&w, &z) / zz);
        // Short steps: the first ones overshoot where single residuals are large.
        a += da.clamp(-1.0, 1.0);
        b += db.clamp(-0.5 / zz.sqrt() * n.sqrt(), 0.5 / zz.sqrt() * n.sqrt());
        if da.abs() < 1e-10 && db.abs() * zz.sqrt() < 1e-10 {
            break;
        }
    }
    let nll = residual
        .iter()
        .zip(&z)
        .map(|(r, z)| a + b * z + 0.5 * r * r * (-2.0 * (a + b * z)).exp())
        .sum();
    // Fisher information of b is 2 sum z^2.
    (b, (0.5 / zz).sqrt(), nll)
}

/// Tests `residual` (of one mean model, equal weights) against the stimulus. `u` is the stimulus in
/// half ranges; `x` as measured, where a power of it may be the law; `draws` permutations. None
/// with too few readings or a constant stimulus.
pub(crate) fn heteroscedasticity_test(
    residual: &[f64],
    x: Option<&[f64]>,
    u: &[f64],
    draws: usize,
    seed: u64,
) -> Option<Spread> {
    if residual.len() < MIN_READINGS {
        return None;
    }
    let z = centred(u);
    // The cube root of a squared Gaussian is nearly Gaussian (Wilson & Hilferty): a correlation of
    // it is not ruled by single residuals.
    let mut size = centred(
        &residual
            .iter()
            .map(|r| (r * r).cbrt())
            .collect::<Vec<f64>>(),
    );
    let scale = (dot(&z, &z) * dot(&size, &size)).sqrt();
    if !(scale > 0.0) {
        return None;
    }
    let correlation = dot(&z, &size) / scale;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed ^ 0x0057_9ead);
    // Under the null every order of the residuals is as likely: no law of the noise is assumed.
    // Drawn until enough reach the score, or to the end (Besag & Clifford, Biometrika 78 (1991)
    // 301): either way p is valid, and a large one is soon known.
    let (mut reached, mut drawn) = (0, 0);
    // A score that its asymptotic law gives once in 10^9 is reached by none of them.
    let score = correlation.abs() * (size.len() as f64 - 1.0).sqrt();
    if score > OUT_OF_REACH {
        drawn = draws;
    }
    while drawn < draws && reached < ENOUGH {
        size.shuffle(&mut rng);
        drawn += 1;
        reached += usize::from((dot(&z, &size) / scale).abs() >= correlation.abs());
    }
    let p_value = if reached == ENOUGH {
        reached as f64 / drawn as f64
    } else {
        (reached as f64 + 1.0) / (drawn as f64 + 1.0)
    };
    let (b, se, nll) = fit_log_linear_variance(residual, u);
    let mut out = Spread {
        p_value,
        correlation,
        law: SpreadLaw::Exponential,
        exponent: b,
        interval95: [b - NORMAL_95 * se, b + NORMAL_95 * se],
        relative_sd: z.iter().map(|z| (b * z).exp()).collect(),
    };
    if let Some(x) = x.filter(|x| x.iter().all(|x| *x > 0.0)) {
        let logs: Vec<f64> = x.iter().map(|x| x.ln()).collect();
        let (b, se, power_nll) = fit_log_linear_variance(residual, &logs);
        if power_nll < nll {
            out.law = SpreadLaw::Power;
            out.exponent = b;
            out.interval95 = [b - NORMAL_95 * se, b + NORMAL_95 * se];
            out.relative_sd = centred(&logs).iter().map(|z| (b * z).exp()).collect();
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// Simulated residuals with sd ~ x^power at x = 1..4.
    fn simulated(n: usize, power: f64, seed: u64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let x: Vec<f64> = (0..n)
            .map(|k| 1.0 + 3.0 * k as f64 / (n - 1) as f64)
            .collect();
        let r = x
            .iter()
            .map(|x| {
                let z: f64 = StandardNormal.sample(&mut rng);
                z * x.powf(power)
            })
            .collect();
        let u = x.iter().map(|x| (x - 2.5) / 1.5).collect();
        (r, x, u)
    }

    #[test]
    fn growing_spread_is_found_and_its_exponent_covered() {
        let mut covered = 0;
        for seed in 0..60 {
            let (r, x, u) = simulated(100, 1.0, seed);
            let s = heteroscedasticity_test(&r, Some(&x), &u, 400, seed).unwrap();
            assert!(
                s.p_value < 0.05 && s.correlation > 0.0,
                "seed {seed}: {}",
                s.p_value
            );
            let (b, se, _) =
                fit_log_linear_variance(&r, &x.iter().map(|x| x.ln()).collect::<Vec<_>>());
            covered += u32::from((b - 1.0).abs() < NORMAL_95 * se);
        }
        assert!(covered >= 52, "claimed intervals covered {covered} of 60");
    }

    #[test]
    fn equal_spread_gives_uniform_p_values() {
        let p: Vec<f64> = (0..300)
            .map(|seed| {
                let (r, x, u) = simulated(40, 0.0, 1000 + seed);
                heteroscedasticity_test(&r, Some(&x), &u, 400, seed)
                    .unwrap()
                    .p_value
            })
            .collect();
        let low = p.iter().filter(|p| **p < 0.05).count();
        assert!((5..=27).contains(&low), "{low} of 300 below 0.05");
    }
}
