//! The reference grating's own noise, separated from the temperature: a random walk seen through
//! white noise.
//!
//! Both sensing gratings are compensated with one reference reading, so its noise is in both
//! residuals and, with the opposite sign, in the temperature that they are compared with: an error
//! in variables, not an effect. Local level model and fixed-interval smoother: Harvey,
//! "Forecasting, Structural Time Series Models and the Kalman Filter" (1989), ch. 4; the ratio of
//! variances by maximum likelihood.

use wcal_core::order_statistics::median;

/// Fewest readings that tell a walk from noise.
const MIN_READINGS: usize = 12;

/// Growth of the walk's variance, 1/s, in units of the noise's, and the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RandomWalkModel {
    ratio_per_s: f64,
    /// Standard deviation of the noise.
    pub(super) noise_sd: f64,
    /// -2 log likelihood.
    pub(super) misfit: f64,
    /// Variance of a moving reading's noise, 1 for a settled one's, where this tells it and not the
    /// session.
    pub(super) moving_variance: Option<f64>,
}

/// The level at a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Given all readings.
    pub by_all: f64,
    /// Given all but its own: the reading's noise has no part in it.
    pub by_others: f64,
}

/// One pass of the filter.
struct Filtered {
    /// Level after each reading and its variance in units of the noise's.
    levels: Vec<(f64, f64)>,
    /// Variance of each level before its reading.
    before: Vec<f64>,
    /// -2 log likelihood with the noise's variance concentrated out; infinite where nothing
    /// scatters.
    misfit: f64,
    noise_sd: f64,
}

fn steps_s(t_s: &[f64]) -> Vec<f64> {
    t_s.windows(2).map(|w| (w[1] - w[0]).max(0.0)).collect()
}

/// Local level model along the readings.
fn filter(ratio_per_s: f64, t_s: &[f64], values: &[f64], variances: &[f64]) -> Filtered {
    // Diffuse start: the first reading sets the level and has no part in the likelihood.
    let mut level = values[0];
    let mut variance = variances[0];
    let (mut levels, mut before) = (vec![(level, variance)], vec![f64::INFINITY]);
    let (mut squares, mut logs) = (0.0, 0.0);
    for ((step_s, value), own) in steps_s(t_s).iter().zip(&values[1..]).zip(&variances[1..]) {
        // Prediction: a random walk stays where it is, and its variance grows with time.
        variance += ratio_per_s * step_s;
        before.push(variance);
        // Update by the Kalman gain, variance over variance of the innovation.
        let (surprise, spread) = (value - level, variance + own);
        squares += surprise * surprise / spread;
        logs += spread.ln();
        level += surprise * variance / spread;
        variance *= own / spread;
        levels.push((level, variance));
    }
    let count = levels.len() as f64 - 1.0;
    // The likelihood at the best variance of the noise: n ln(sum e^2 / s / n) + sum ln s.
    let misfit = if squares > 0.0 {
        count * (squares / count).ln() + logs
    } else {
        f64::INFINITY
    };
    Filtered {
        levels,
        before,
        misfit,
        noise_sd: (squares / count).sqrt(),
    }
}

impl RandomWalkModel {
    /// The walk of `values` at times `t_s` (s, rising), `variances` those of their noise, 1 for a
    /// typical one; none where they are too few or do not scatter.
    pub fn of(t_s: &[f64], values: &[f64], variances: &[f64]) -> Option<Self> {
        let typical = median(steps_s(t_s)).filter(|s| *s > 0.0)?;
        if values.len() < MIN_READINGS {
            return None;
        }
        // From a level that stays to readings without noise of their own, four places a decade.
        let ratios = (-16..=16).map(|k| 10f64.powf(f64::from(k) / 4.0) / typical);
        let tried = ratios.map(|ratio_per_s| {
            let Filtered {
                noise_sd, misfit, ..
            } = filter(ratio_per_s, t_s, values, variances);
            Self {
                ratio_per_s,
                noise_sd,
                misfit,
                moving_variance: None,
            }
        });
        tried
            .filter(|walk| walk.misfit.is_finite())
            .min_by(|a, b| a.misfit.total_cmp(&b.misfit))
    }

    /// Levels at the readings.
    pub fn smooth(&self, t_s: &[f64], values: &[f64], variances: &[f64]) -> Vec<Level> {
        if values.is_empty() {
            return Vec::new();
        }
        let Filtered { levels, before, .. } = filter(self.ratio_per_s, t_s, values, variances);
        // Fixed-interval smoother (Rauch, Tung & Striebel 1965): back from the last reading.
        let mut smoothed = levels.clone();
        for k in (0..smoothed.len() - 1).rev() {
            let (level, variance) = levels[k];
            let share = variance / before[k + 1];
            let (next, next_variance) = smoothed[k + 1];
            smoothed[k] = (
                level + share * (next - level),
                variance + share * share * (next_variance - before[k + 1]),
            );
        }
        let of = |(k, (by_all, variance)): (usize, (f64, f64))| {
            // The level's variance over the reading's is the weight of the reading in its own level.
            let weight = variance / variances[k];
            // by_all = weight * reading + (1 - weight) * by_others, solved for the last.
            let by_others = if weight < 1.0 {
                (by_all - weight * values[k]) / (1.0 - weight)
            } else {
                by_all
            };
            Level { by_all, by_others }
        };
        smoothed.into_iter().enumerate().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A walk of `step_sd` a reading seen through noise of sd 1: times, truth, readings.
    fn seen(step_sd: f64, seed: u64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut level = 0.0;
        let truth: Vec<f64> = (0..300)
            .map(|_| {
                level += step_sd * normal();
                level
            })
            .collect();
        let readings = truth.iter().map(|x| x + normal()).collect();
        (
            (0..300).map(|k| 4.0 * f64::from(k)).collect(),
            truth,
            readings,
        )
    }

    fn alike(values: &[f64]) -> Vec<f64> {
        vec![1.0; values.len()]
    }

    /// Every third reading is averaged over a hundredth of the samples: the noise stated is that of
    /// the others, and the level leans on them.
    #[test]
    fn readings_of_few_samples_count_less() {
        let (mut sds, mut weighed, mut unweighed) = (Vec::new(), 0.0, 0.0);
        for seed in 0..20 {
            let (t, truth, mut readings) = seen(0.05, seed);
            let variances: Vec<f64> = (0..300)
                .map(|k| if k % 3 == 0 { 100.0 } else { 1.0 })
                .collect();
            for k in (0..300).step_by(3) {
                readings[k] = truth[k] + 10.0 * (readings[k] - truth[k]);
            }
            let walk = RandomWalkModel::of(&t, &readings, &variances).unwrap();
            sds.push(walk.noise_sd);
            let level = |v: &[f64]| -> Vec<f64> {
                RandomWalkModel::of(&t, &readings, v)
                    .unwrap()
                    .smooth(&t, &readings, v)
                    .iter()
                    .map(|l| l.by_all)
                    .collect()
            };
            weighed += rms(&level(&variances), &truth);
            unweighed += rms(&level(&alike(&readings)), &truth);
        }
        let mean = sds.iter().sum::<f64>() / 20.0;
        assert!((0.9..1.1).contains(&mean), "{mean}");
        assert!(1.5 * weighed < unweighed, "{weighed} {unweighed}");
    }

    fn rms(a: &[f64], b: &[f64]) -> f64 {
        (a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
    }

    fn smoothed(t_s: &[f64], readings: &[f64]) -> Vec<f64> {
        RandomWalkModel::of(t_s, readings, &alike(readings))
            .unwrap()
            .smooth(t_s, readings, &alike(readings))
            .iter()
            .map(|l| l.by_all)
            .collect()
    }

    #[test]
    fn a_level_by_others_is_that_without_the_reading() {
        let (t, _, readings) = seen(0.3, 1);
        let walk = RandomWalkModel::of(&t, &readings, &alike(&readings)).unwrap();
        for left_out in [0, 1, 150, 299] {
            let others = |v: &[f64]| -> Vec<f64> {
                v.iter()
                    .enumerate()
                    .filter(|(k, _)| *k != left_out)
                    .map(|(_, x)| *x)
                    .collect()
            };
            let rest = walk.smooth(&others(&t), &others(&readings), &alike(&others(&t)));
            // Between two readings the walk is expected on the line through their levels.
            let expected = match left_out {
                0 => rest[0].by_all,
                299 => rest[298].by_all,
                k => 0.5 * (rest[k - 1].by_all + rest[k].by_all),
            };
            let got = walk.smooth(&t, &readings, &alike(&readings))[left_out].by_others;
            assert!(
                (got - expected).abs() < 1e-9,
                "{left_out}: {got} {expected}"
            );
        }
    }

    #[test]
    fn a_slow_walk_is_freed_of_noise_and_a_fast_one_is_followed() {
        let mut slow_rms = Vec::new();
        for seed in 0..20 {
            let (t, truth, readings) = seen(0.05, seed);
            let slow = smoothed(&t, &readings);
            slow_rms.push(rms(&slow, &truth));
            let (t, truth, readings) = seen(20.0, seed);
            let fast = smoothed(&t, &readings);
            // Noise of a twentieth of a step is hardly distinguished from none: what is taken for
            // it stays a small part of a step.
            assert!(rms(&fast, &truth) < 3.0, "{}", rms(&fast, &truth));
        }
        // With the ratio known the smoother's steady state has variance step_sd / 2; its ends and
        // the ratio's own error add to it.
        let mean = slow_rms.iter().sum::<f64>() / 20.0;
        assert!(
            (0.025f64.sqrt()..1.3 * 0.025f64.sqrt()).contains(&mean),
            "{mean} {slow_rms:?}"
        );
    }

    #[test]
    fn readings_that_do_not_scatter_have_no_walk() {
        let t: Vec<f64> = (0..30).map(f64::from).collect();
        assert!(RandomWalkModel::of(&t, &[3.0; 30], &[1.0; 30]).is_none());
        assert!(RandomWalkModel::of(&t[..5], &[1.0, 2.0, 1.0, 3.0, 1.0], &[1.0; 5]).is_none());
    }
}
