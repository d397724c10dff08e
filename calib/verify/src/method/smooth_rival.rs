//! A rival without physics: does anything smooth predict what the accepted model leaves of readings
//! that were left out? What it predicts is no noise.
//!
//! ```text
//! e_i = r_i / sqrt(1 - h_ii)                                  r: what the model leaves of readings taken for independent, h: its leverages
//! g_f = B_f (B'B - B_f'B_f + L / q)^-1 (B'e - B_f'e_f)        prediction of fold f from the others, B: cos(pi k u), L = diag k^2
//! D = sum over folds of (2 e_f.g_f - |g_f|^2) / s^2           fall of the squares left out, beyond that of what a course is no news to
//! ```
//!
//! u is a driver from 0 to 1: a setting, a clock, a direction, a further column. Its cosines stand
//! by themselves, and as factors of the signal and of the setting's cosines (a characteristic that
//! follows the driver). q is the size of the course in the noise's variance. Draws of the noise
//! give every D its tail, and the smallest of their p values its own: with the values of the
//! residuals themselves, and what neighbours share estimated beside the course of the largest D, so
//! that it does not hold the course. A part of the noise that would be a course over the session is
//! cut to a quarter of that.
//!
//! A course of the clock by itself is such noise and is not asked. What else changes with the clock
//! (a trajectory, a temperature) has to predict more than the clock does, a factor more than its
//! driver by itself. The setting is asked as it is: noise does not know it.
//!
//! Wahba, "Spline Models for Observational Data" (1990), ch. 1: cosines with variances 1 / k^2 are
//! a Brownian course. Besag & Clifford, Biometrika 78 (1991): draws end where ten are larger.

use super::admissible::REFIT_STEPS;
use super::fit::Weights;
use super::hypothesis::Hypothesis;
use super::noise::{CORRELATED_PRICE, COURSE, Noise};
use super::noise_estimator::NoiseEstimator;
use super::settings::settings;
use super::signature::nuisance_basis;
use crate::levels::SMOOTH_RIVAL;
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{ContinuousCDF, Gamma};
use std::f64::consts::PI;

/// Cosines of a driver, of one that is a factor, and of the setting beside it, at most: what is
/// finer is left to the waves of the omnibus test.
const COSINES: usize = 12;
const FACTORS: usize = 3;
const SETTINGS: usize = 8;
/// Sizes of a course in the noise's variance: what is found is within a factor of three of one of
/// them.
const SIZES: [f64; 2] = [0.3, 3.0];
/// Draws from which each D has its tail, draws at most, and smaller p that end them.
const PILOT: usize = 200;
const DRAWS: usize = 1500;
const ENOUGH: usize = 10;
/// A D that is no more skewed than this is as good as normal.
const LEAST_SKEWNESS: f64 = 0.1;
/// Fewer folds predict little of each other.
const MIN_FOLDS: usize = 3;
/// A value that its own coefficient takes up is not scaled to the others.
const LEAST_LEFT: f64 = 0.1;

/// What predicts what remains.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothRival {
    /// Covariate by its name.
    pub driver: String,
    /// It is the characteristic that follows the driver.
    pub factor: bool,
}

/// A course over one driver: whitened columns, the same in every channel, and
/// `(B'B - B_f'B_f + L / q)^-1` by size and fold, those of `beyond` among them.
struct Course {
    of: SmoothRival,
    /// The course that this one has to be better than.
    beyond: Option<usize>,
    /// Its own columns as they are.
    raw: Vec<Vec<f64>>,
    /// B_f' of every fold, then that of the readings that no fold leaves out.
    parts: Vec<DMatrix<f64>>,
    /// B_f'B_f.
    grams: Vec<DMatrix<f64>>,
    inverse: Vec<Vec<DMatrix<f64>>>,
}

/// The smooth course that predicts what `accepted` leaves of readings left out in `fold`; none
/// where nothing does beyond chance.
pub(crate) fn smooth_rival(
    system: &dyn MeasurementModel,
    accepted: &Hypothesis,
    noise: &Noise,
    fold: &[Option<usize>],
    seed: u64,
) -> Option<SmoothRival> {
    // Readings taken for independent: no noise model takes anything up.
    let own = noise.weights_of(&system.noise_inputs());
    let alone =
        Weights::independent(own.relative().to_vec()).masked(|i| accepted.weights.counts(i));
    let h = Hypothesis::fitted(system, &accepted.fit.terms, &alone, REFIT_STEPS)?;
    let (n, channels) = h.fit.residual.shape();
    let rows = |f: usize| {
        (0..n)
            .filter(|&i| fold[i] == Some(f) && alone.counts(i))
            .collect::<Vec<usize>>()
    };
    let folds: Vec<Vec<usize>> = (0..=*fold.iter().flatten().max()?)
        .map(rows)
        .filter(|rows| !rows.is_empty())
        .collect();
    // Readings that no fold leaves out are the last part.
    let rest = (0..n).filter(|&i| fold[i].is_none() || !alone.counts(i));
    let parts: Vec<Vec<usize>> = folds.iter().cloned().chain([rest.collect()]).collect();
    let courses = courses(system, &h, &parts);
    if folds.len() < MIN_FOLDS || courses.is_empty() {
        return None;
    }
    let basis = nuisance_basis(&h.fit);
    let left = DMatrix::from_fn(n, channels, |i, c| {
        basis.unexplained_sd(c * n + i).max(LEAST_LEFT)
    });
    let falls = |residual: &DVector<f64>| -> Vec<f64> {
        let variance = residual.norm_squared() / h.fit.dof;
        // e_i = r_i / sqrt(1 - h_ii): all values of one variance, as those of noise are.
        let e = DMatrix::from_fn(n, channels, |i, c| residual[c * n + i] / left[(i, c)]);
        let e: Vec<DMatrix<f64>> = parts.iter().map(|rows| e.select_rows(rows)).collect();
        let of_course = |course: &Course| course.falls(&e);
        let each: Vec<Vec<f64>> = courses.iter().map(of_course).collect();
        let fall = |(k, course): (usize, &Course)| {
            let beyond = course.beyond.map_or(&[0.0; SIZES.len()][..], |b| &each[b]);
            each[k]
                .iter()
                .zip(beyond)
                .map(|(d, b)| (d - b) / variance)
                .collect::<Vec<f64>>()
        };
        courses.iter().enumerate().flat_map(fall).collect()
    };
    let found = falls(&h.fit.stacked());
    // A course of the clock by itself is what noise that neighbours share is, too: it is not asked.
    let by_clock = |of: &SmoothRival| !of.factor && is_clock(&of.driver);
    let asked: Vec<usize> = (0..found.len())
        .filter(|k| !by_clock(&courses[k / SIZES.len()].of))
        .collect();
    // A prediction that leaves more than none does predicts nothing.
    if !asked.iter().any(|&k| found[k] > 0.0) {
        return None;
    }
    // Noise as it is: the values of the whitened residual in any order, and what readings share
    // beside the course that predicts best.
    let best = asked
        .iter()
        .copied()
        .max_by(|&a, &b| found[a].total_cmp(&found[b]));
    let judge = NoiseEstimator::new(system, seed).with_correlated_gain(CORRELATED_PRICE);
    let beside = best.and_then(|k| judge.noise(accepted, &courses[k / SIZES.len()].raw));
    let whitened: Vec<f64> = (0..n * channels)
        .filter(|at| alone.counts(at % n))
        .map(|at| {
            accepted.fit.residual[(at % n, at / n)] / accepted.fit.variance().sqrt().max(1e-300)
        })
        .collect();
    let shared = beside
        .as_ref()
        .unwrap_or(noise)
        .weights
        .shared()
        .cloned()
        .map(|mut shared| {
            let length = shared
                .clock
                .last()
                .zip(shared.clock.first())
                .map_or(0.0, |(last, first)| last - first);
            shared.correlated = shared
                .correlated
                .map(|[sd, tau]| [sd, tau.min(COURSE * length)]);
            Weights::sharing(alone.relative().to_vec(), shared)
        });
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x50fa);
    let mut null = || {
        let mut white = || whitened[rng.random_range(0..whitened.len())];
        let mut drawn = DVector::zeros(h.fit.stacked().len());
        for c in 0..channels {
            let mut column: Vec<f64> = (0..n)
                .map(|i| if alone.counts(i) { white() } else { 0.0 })
                .collect();
            if let Some(shared) = &shared {
                shared.colour(&mut column);
                column
                    .iter_mut()
                    .zip(alone.relative())
                    .for_each(|(v, w)| *v *= w);
            }
            drawn.rows_mut(c * n, n).copy_from_slice(&column);
        }
        drawn
            .rows_mut(n * channels, h.fit.auxiliary_residual.len())
            .apply(|v| *v = white());
        // A fit takes up of noise what it takes up of readings: the draw is tested by its residual.
        falls(&basis.project_off(&drawn))
    };
    // Each D has the tail of a gamma distribution with its first three moments: few columns are as
    // skewed as chi-squared.
    let pilot: Vec<Vec<f64>> = (0..PILOT).map(|_| null()).collect();
    let tails: Vec<Tail> = (0..found.len())
        .map(|k| Tail::of(pilot.iter().map(|d| d[k])))
        .collect();
    let least = |falls: &[f64]| {
        let p = asked.iter().map(|&k| (k, tails[k].p(falls[k])));
        p.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 1.0))
    };
    let (which, smallest) = least(&found);
    let (mut larger, mut drawn) = (0, 0);
    while drawn < DRAWS && larger < ENOUGH {
        larger += usize::from(least(&null()).1 <= smallest);
        drawn += 1;
    }
    let p = f64::from(1 + larger as u32) / f64::from(1 + drawn as u32);
    (p < SMOOTH_RIVAL).then(|| courses[which / SIZES.len()].of.clone())
}

/// Right tail of D under the noise: a shifted gamma distribution.
struct Tail {
    mean: f64,
    sd: f64,
    shape: f64,
}

impl Tail {
    fn of(draws: impl Iterator<Item = f64> + Clone) -> Self {
        let n = PILOT as f64;
        let mean = draws.clone().sum::<f64>() / n;
        let moment = |k: i32| draws.clone().map(|d| (d - mean).powi(k)).sum::<f64>() / n;
        let sd = moment(2).sqrt().max(1e-12);
        let skewness = (moment(3) / sd.powi(3)).max(LEAST_SKEWNESS);
        Self {
            mean,
            sd,
            // A gamma distribution of shape k has the skewness 2 / sqrt(k).
            shape: 4.0 / (skewness * skewness),
        }
    }

    fn p(&self, fall: f64) -> f64 {
        // Mean k and variance k of the unit gamma, moved to those of D.
        let at = self.shape + self.shape.sqrt() * (fall - self.mean) / self.sd;
        Gamma::new(self.shape, 1.0).map_or(1.0, |g| g.sf(at.max(0.0)))
    }
}

/// Every course that a driver of the session allows.
fn courses(system: &dyn MeasurementModel, h: &Hypothesis, folds: &[Vec<usize>]) -> Vec<Course> {
    let covariates = system.covariates();
    let times = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    let cosine = |u: &[f64], k: usize| {
        u.iter()
            .map(|u| (PI * k as f64 * u).cos())
            .collect::<Vec<f64>>()
    };
    let cosines = |values: &[f64], most: usize| -> Vec<(usize, Vec<f64>)> {
        let (u, places) = (
            unit(values),
            settings(values).into_iter().max().unwrap_or(0),
        );
        (1..=most.min(places)).map(|k| (k, cosine(&u, k))).collect()
    };
    // What carries a factor: columns after the constant, which are the signal, or the first
    // covariate, which is the setting.
    let signals = (1..h.fit.raw_design.ncols().min(3)).map(|j| {
        let u = unit(h.fit.raw_design.column(j).as_slice());
        (1, u.iter().map(|u| 2.0 * u - 1.0).collect())
    });
    let signals: Vec<(usize, Vec<f64>)> = signals.collect();
    let setting = covariates
        .first()
        .map_or(Vec::new(), |(_, values)| cosines(values, SETTINGS));
    let clock = ["t_s", "order"]
        .into_iter()
        .find_map(|clock| covariates.iter().find(|(name, _)| name == clock));
    // The clock first: what changes with it is asked beyond it.
    let others = covariates.iter().filter(|(name, _)| !is_clock(name));
    let mut out: Vec<Course> = Vec::new();
    for (k, (name, values)) in clock.into_iter().chain(others).enumerate() {
        let products = |carriers: &[(usize, Vec<f64>)]| {
            let of = |(j, a): &(usize, Vec<f64>)| {
                cosines(values, FACTORS)
                    .into_iter()
                    .map(|(k, c)| (j * k, times(&c, a)))
                    .collect::<Vec<_>>()
            };
            carriers.iter().flat_map(of).collect::<Vec<_>>()
        };
        let own = cosines(values, COSINES);
        if own.is_empty() {
            continue;
        }
        let is_setting = covariates.first().is_some_and(|(first, _)| first == name);
        let by_clock = clock.filter(|_| {
            k > 0 && !is_setting && out.first().is_some_and(|c| is_clock(&c.of.driver))
        });
        let before = by_clock.map_or(Vec::new(), |(_, t)| cosines(t, COSINES));
        let course = |factor, new: Vec<_>, before: &[(usize, Vec<f64>)], beyond| {
            let of = SmoothRival {
                driver: name.clone(),
                factor,
            };
            Course::of(of, new, before, beyond, &h.weights, folds)
        };
        let plain = course(false, own.clone(), &before, by_clock.map(|_| 0));
        let at = out.len();
        out.extend(plain);
        if out.len() == at {
            continue;
        }
        let before = [before, own].concat();
        for factors in [products(&signals), products(&setting)] {
            if !factors.is_empty() {
                out.extend(course(true, factors, &before, Some(at)));
            }
        }
    }
    out
}

/// The clock, or what stands for it.
fn is_clock(driver: &str) -> bool {
    matches!(driver, "t_s" | "order")
}

impl Course {
    /// Of `new` columns with the number of their cosine, in addition to those `before`; none where a
    /// prior leaves them undetermined.
    fn of(
        of: SmoothRival,
        new: Vec<(usize, Vec<f64>)>,
        before: &[(usize, Vec<f64>)],
        beyond: Option<usize>,
        weights: &Weights,
        folds: &[Vec<usize>],
    ) -> Option<Self> {
        let raw: Vec<Vec<f64>> = new.iter().map(|(_, c)| c.clone()).collect();
        let columns: Vec<(usize, Vec<f64>)> = before.iter().cloned().chain(new).collect();
        let whitened = columns
            .iter()
            .map(|(_, c)| DVector::from_vec(weights.apply_to(c)));
        let b = DMatrix::from_columns(&whitened.collect::<Vec<_>>());
        // Variances 1 / k^2, as a Brownian course has: finer cosines need more evidence.
        let prior =
            DVector::from_iterator(columns.len(), columns.iter().map(|(k, _)| (k * k) as f64));
        let part = |rows: &Vec<usize>| b.select_rows(rows).transpose();
        let parts: Vec<DMatrix<f64>> = folds.iter().map(part).collect();
        let mut grams: Vec<DMatrix<f64>> = parts.iter().map(|b| b * b.transpose()).collect();
        let whole: DMatrix<f64> = grams.iter().sum();
        grams.pop();
        let of_fold = |size: f64, own: &DMatrix<f64>| {
            (&whole - own + DMatrix::from_diagonal(&(&prior / size))).try_inverse()
        };
        let of_size = |size: f64| {
            grams
                .iter()
                .map(|own| of_fold(size, own))
                .collect::<Option<Vec<_>>>()
        };
        let inverse = SIZES.into_iter().map(of_size).collect::<Option<Vec<_>>>()?;
        Some(Self {
            of,
            beyond,
            raw,
            parts,
            grams,
            inverse,
        })
    }

    /// D of every size, in the unit of the residual; `e` part by part. With c = (..)^-1 (B'e - B_f'e_f),
    /// e_f.g_f = B_f'e_f.c and |g_f|^2 = c'B_f'B_f c.
    fn falls(&self, e: &[DMatrix<f64>]) -> Vec<f64> {
        let seen: Vec<DMatrix<f64>> = self.parts.iter().zip(e).map(|(b, e)| b * e).collect();
        let whole: DMatrix<f64> = seen.iter().sum();
        let mut falls = vec![0.0; SIZES.len()];
        for (f, gram) in self.grams.iter().enumerate() {
            let others = &whole - &seen[f];
            for (fall, inverse) in falls.iter_mut().zip(&self.inverse) {
                let c = &inverse[f] * &others;
                *fall += 2.0 * seen[f].dot(&c) - c.dot(&(gram * &c));
            }
        }
        falls
    }
}

/// `values` from 0 to 1.
fn unit(values: &[f64]) -> Vec<f64> {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    values
        .iter()
        .map(|v| (v - low) / (high - low).max(1e-300))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::columns_system_test::ColumnsSystem;
    use super::*;

    /// Driver found in 120 readings of a column up and down, twelve folds by place, where `moved`
    /// acts on top of the slope.
    fn found(seed: u64, moved: impl Fn(usize, f64) -> f64) -> Option<SmoothRival> {
        let place = |i: usize| {
            if (i / 12).is_multiple_of(2) {
                i % 12
            } else {
                11 - i % 12
            }
        };
        let x: Vec<f64> = (0..120).map(|i| place(i) as f64 / 5.5 - 1.0).collect();
        let clean: Vec<f64> = x
            .iter()
            .enumerate()
            .map(|(i, x)| 5.0 * x + moved(i, *x))
            .collect();
        let clock: Vec<f64> = (0..120).map(f64::from).collect();
        let system = ColumnsSystem::new(seed, vec![x.clone()], &clean)
            .with_covariates(vec![("stimulus".to_owned(), x), ("t_s".to_owned(), clock)]);
        let h = Hypothesis::fitted(&system, &[ColumnsSystem::term(0)], &Weights::equal(120), 5)
            .unwrap();
        let noise = NoiseEstimator::new(&system, 1).noise(&h, &[]).unwrap();
        smooth_rival(
            &system,
            &h,
            &noise,
            &(0..120).map(|i| Some(place(i))).collect::<Vec<_>>(),
            seed,
        )
    }

    #[test]
    fn what_a_course_predicts_is_no_noise_and_noise_is_predicted_by_none() {
        let nothing = (0..20)
            .filter(|&seed| found(seed, |_, _| 0.0).is_some())
            .count();
        assert_eq!(nothing, 0);
        for seed in 0..5 {
            let bend = found(seed, |_, x| 2.0 * (4.0 * x).sin());
            assert_eq!(bend.unwrap().driver, "stimulus", "{seed}");
            let fades = found(seed, |i, x| 0.03 * i as f64 * x);
            assert_eq!(
                fades,
                Some(SmoothRival {
                    driver: "t_s".to_owned(),
                    factor: true
                }),
                "{seed}"
            );
        }
    }
}
