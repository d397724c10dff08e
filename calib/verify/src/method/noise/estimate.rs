//! The parts of the noise, estimated from the residuals of a model.
//!
//! For given ratios theta (correlated part, its time constant, pose scatter) the readings are
//! whitened and the model refitted; the ratios with the highest restricted likelihood
//! (`likelihood`) are taken.
//!
//! A part is taken up where it gains more than chance would; what the design cannot tell is "not
//! known", not zero.

use super::inputs::NoiseInputs;
use super::likelihood::{
    MeanModel, RestrictedLikelihood, best_of, pattern_search, restricted_likelihood,
    studentised_residuals,
};
use super::parts::Noise;
use super::spread_model::{SpreadModel, fit_variance_function};
use super::tails::tails;
use super::whitening::Weights;
use crate::levels::{NOISE_PART, PRICE, gain, gain_at_bound};
use crate::method::distributions::sd_interval95;
use wcal_core::order_statistics::median;
use wcal_core::verify_document::NoisePart;

/// Gain in -2 log restricted likelihood from which the correlated part (its size and its time
/// constant) is taken up.
pub(crate) fn correlated_gain() -> f64 {
    gain(NOISE_PART, 2)
}

/// The same where a test rejects independent readings: whether something is shared is decided, only
/// what it is is open. What its two parameters cost (Akaike).
pub(crate) const CORRELATED_PRICE: f64 = 2.0 * PRICE;
/// Fewer repeats of held poses do not tell pose scatter from repeat noise.
pub(crate) const MIN_HELD_REPEATS: usize = 6;
/// Fewer readings do not tell a correlation.
const MIN_CORRELATED: usize = 20;

/// Logarithms of time constants that the readings can show: a typical spacing to half the whole
/// time.
fn time_constants(clock: &[f64]) -> Option<[f64; 2]> {
    let typical = median(clock.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0))?;
    let whole = clock.last()? - clock.first()?;
    let range = [typical.ln(), (0.5 * whole).ln()];
    (range[1] > range[0]).then_some(range)
}

/// Ratios of a shared part to the repeat noise that are searched.
const RATIOS: [f64; 2] = [0.05, 30.0];

/// The parts of the noise that suit a model best.
pub(crate) struct Components {
    pub(crate) weights: Weights,
    pub(crate) law: Option<SpreadModel>,
    common: f64,
    /// Precision of single readings that the shared parts stand on.
    relative: Vec<f64>,
    shared: Shared,
}

/// What readings share, in units of the repeat noise.
#[derive(Clone, Copy)]
struct Shared {
    /// -2 log restricted likelihood.
    cost: f64,
    /// Size and time constant of a part that is correlated in time.
    correlated: Option<[f64; 2]>,
    /// Pose scatter.
    pose: f64,
}

impl Components {
    /// A part is correlated in time.
    pub(crate) fn is_correlated(&self) -> bool {
        self.shared.correlated.is_some()
    }
}

/// Estimates the parts of the noise in the residuals of `model` with their intervals; `counted` are
/// the readings that count. A part that is correlated in time is taken up where it gains more than
/// `correlated_gain`.
pub fn estimate(
    model: &MeanModel,
    inputs: &NoiseInputs,
    counted: &Weights,
    correlated_gain: f64,
    seed: u64,
) -> Option<Noise> {
    let found = estimate_components(model, inputs, counted, correlated_gain, seed)?;
    let (pose, correlated) = found.stated(model, inputs);
    let Components {
        weights,
        law,
        common,
        ..
    } = found;
    // s^2 = r'r / (N - p) is the restricted estimate: unbiased, whatever p is.
    let m = restricted_likelihood(model, &weights)?;
    let s = (m.ssr / m.dof).sqrt();
    let whitened = studentised_residuals(model, &weights, s);
    Some(Noise {
        repeat: NoisePart {
            value: s,
            interval95: sd_interval95(s, m.dof / (1.0 + 0.5 * excess_kurtosis(&whitened)))?,
        },
        pose,
        correlated,
        law,
        common,
        tails: tails(&whitened),
        step: inputs.step.clone(),
        weights,
    })
}

/// The same without intervals and tails.
pub(crate) fn estimate_components(
    model: &MeanModel,
    inputs: &NoiseInputs,
    counted: &Weights,
    correlated_gain: f64,
    seed: u64,
) -> Option<Components> {
    let n = inputs.settings.len();
    let common = estimate_averaging_floor(model, inputs, counted);
    let known = inputs.own(common);
    let mask: Vec<f64> = (0..n)
        .map(|i| if counted.counts(i) { known[i] } else { 0.0 })
        .collect();
    // The spread first: weights that are wrong by it would look like a shared part.
    let mut law = fit_variance_function(model, inputs, &Weights::independent(mask.clone()), seed);
    let mut relative: Vec<f64> = match &law {
        Some(l) => mask
            .iter()
            .zip(l.relative_sd(inputs))
            .map(|(m, sd)| m / sd)
            .collect(),
        None => mask.clone(),
    };
    let mut shared = estimate_variance_components(model, inputs, &relative, correlated_gain)?;
    if law.is_some() && (shared.correlated.is_some() || shared.pose > 0.0) {
        // What readings share can look like a law of the spread: it must hold among whitened
        // readings, too.
        let plain = estimate_variance_components(model, inputs, &mask, correlated_gain)?;
        // Whitened by what is shared, a spread that only looked like one is gone.
        let whitened = Weights::sharing(mask.clone(), inputs.shared(plain.correlated, plain.pose));
        if whitened.shared().is_some()
            && fit_variance_function(model, inputs, &whitened, seed).is_none()
        {
            (relative, shared, law) = (mask, plain, None);
        }
    }
    // The readings that do not count keep their spread, so that they can be readmitted.
    let own = law
        .as_ref()
        .map_or_else(|| vec![1.0; n], |l| l.relative_sd(inputs));
    let every = own
        .iter()
        .zip(&known)
        .map(|(sd, known)| known / sd)
        .collect();
    let weights = Weights::sharing(every, inputs.shared(shared.correlated, shared.pose))
        .masked(|i| counted.counts(i));
    Some(Components {
        weights,
        law,
        common,
        relative,
        shared,
    })
}

/// Excess kurtosis of values about zero, at least 0: a variance by f degrees of freedom is known as
/// if by f / (1 + kurtosis / 2) of a Gaussian (O'Neill, Am. Stat. 68 (2014), 282).
fn excess_kurtosis(values: &[f64]) -> f64 {
    let mean = |power: i32| values.iter().map(|z| z.powi(power)).sum::<f64>() / values.len() as f64;
    (mean(4) / mean(2).powi(2) - 3.0).max(0.0)
}

/// Variances beside a typical average's that are searched for what averaging does not lower.
const COMMON: [f64; 2] = [1e-2, 1e3];

/// The part of the variance that averaging does not lower (restricted likelihood); 0 where all
/// readings are averaged alike, or it is too small to be determined.
fn estimate_averaging_floor(model: &MeanModel, inputs: &NoiseInputs, counted: &Weights) -> f64 {
    if inputs.averaged.is_empty() {
        return 0.0;
    }
    let cost = |common: f64| {
        let mut own = inputs.own(common);
        own.iter_mut()
            .enumerate()
            .filter(|(i, _)| !counted.counts(*i))
            .for_each(|(_, w)| *w = 0.0);
        restricted_likelihood(model, &Weights::independent(own))
            .map_or(f64::INFINITY, |m| m.restricted)
    };
    let range = COMMON.map(f64::ln);
    // A cost with more than one hollow: the nearest of a few places starts the descent.
    let starts = [0.1, 0.35, 0.6, 0.85].map(|k| range[0] + (range[1] - range[0]) * k);
    let nearest = starts
        .into_iter()
        .map(|x| (cost(x.exp()), x))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, start)) = nearest else {
        return 0.0;
    };
    let (x, least) = pattern_search([start], [1.0], [range[0]], [range[1]], &|v: &[f64; 1]| {
        cost(v[0].exp())
    });
    if cost(0.0) <= least { 0.0 } else { x[0].exp() }
}

/// Share of the session from which a time constant makes of the correlated part one course over it:
/// half of the longest that is searched.
pub(crate) const COURSE: f64 = 0.25;

/// Misfit of `model` at the shared parts that suit it best, whether or not chance would give them:
/// how well it can do at all; where a part that is correlated in time gains what it costs, whether
/// it is a course over the session. `noise` gives the spread and is where nothing suits better.
pub(crate) fn best_misfit(
    model: &MeanModel,
    inputs: &NoiseInputs,
    noise: &Components,
) -> Option<(RestrictedLikelihood, Option<bool>)> {
    let relative = noise.weights.relative().to_vec();
    let at = |v: &[f64; 3]| {
        let shared = inputs.shared(Some([v[0].exp(), v[1].exp()]), v[2].exp());
        restricted_likelihood(model, &Weights::sharing(relative.clone(), shared))
    };
    let plain = restricted_likelihood(model, &noise.weights)?;
    let independent = Weights::independent(relative.clone());
    let can_pose = inputs.held_repeats(&independent) >= MIN_HELD_REPEATS;
    let clock = inputs
        .clock
        .as_ref()
        .filter(|_| independent.active() >= MIN_CORRELATED);
    let Some(tau) = clock.and_then(|c| time_constants(c)) else {
        return Some((plain, None));
    };
    let ratio = RATIOS.map(f64::ln);
    let shared = noise.weights.shared();
    let pose = shared.map_or(0.0, |s| s.pose).max(RATIOS[0]).ln();
    let known = shared
        .and_then(|s| s.correlated)
        .map(|c| [c[0].max(RATIOS[0]).ln(), c[1].ln().clamp(tau[0], tau[1])]);
    let cost = |v: &[f64; 3]| at(v).map_or(f64::INFINITY, |m| m.plain);
    let place = |k: f64| tau[0] + (tau[1] - tau[0]) * k;
    let starts: Vec<[f64; 3]> = match known {
        Some([r, t]) => vec![[r, t, pose]],
        None => [0.15, 0.45, 0.8]
            .iter()
            .flat_map(|k| [-1.0, 0.5].map(|r| [r, place(*k), pose]))
            .collect(),
    };
    let start = starts
        .into_iter()
        .map(|v| (cost(&v), v))
        .min_by(|a, b| a.0.total_cmp(&b.0))?
        .1;
    let (low, high) = (
        [ratio[0], tau[0], if can_pose { ratio[0] } else { pose }],
        [ratio[1], tau[1], if can_pose { ratio[1] } else { pose }],
    );
    let (best, _) = pattern_search(
        start,
        [0.5, 0.5, if can_pose { 0.5 } else { 0.0 }],
        low,
        high,
        &cost,
    );
    let m = at(&best).filter(|m| m.plain < plain.plain).unwrap_or(plain);
    // The smallest ratio stands for no such part: the logarithm has no zero.
    let gains = cost(&[RATIOS[0].ln(), best[1], best[2]]) - m.plain > CORRELATED_PRICE;
    Some((m, gains.then(|| best[1] >= tau[1] + (2.0 * COURSE).ln())))
}

/// Ratios around the best one that its interval is looked for in, as powers of the step; time
/// constants beside the best.
const STEPS: std::ops::RangeInclusive<i32> = -16..=16;
const STEP: f64 = 1.15;
const TAUS: u8 = 6;

/// 95 % interval of a shared part by profile likelihood: every ratio, time constant and repeat
/// noise s that -2 log L calls as good as what one parameter gains by chance,
/// `f (ln s^2 - ln s^2_best)^2 / 2` of it for s itself (f: degrees of freedom).
fn profile_interval(
    points: impl Iterator<Item = (f64, RestrictedLikelihood)>,
    best: f64,
) -> [f64; 2] {
    let rise = gain(0.05, 1);
    let ends = points.filter_map(|(ratio, m)| {
        // What the ratio leaves of the allowed rise, the repeat noise may take: f (ln s^2)^2 / 2.
        let slack = rise - (m.restricted - best);
        let spread = (slack >= 0.0).then(|| (slack / (2.0 * m.dof)).sqrt().exp())?;
        let sd = ratio * (m.ssr / m.dof).sqrt();
        Some([sd / spread, sd * spread])
    });
    ends.fold([f64::INFINITY, 0.0], |all: [f64; 2], end| {
        [all[0].min(end[0]), all[1].max(end[1])]
    })
}

/// What readings share, by restricted likelihood, one part after the other.
fn estimate_variance_components(
    model: &MeanModel,
    inputs: &NoiseInputs,
    relative: &[f64],
    correlated_gain: f64,
) -> Option<Shared> {
    let at = |correlated: Option<[f64; 2]>, pose: f64| {
        Weights::sharing(relative.to_vec(), inputs.shared(correlated, pose))
    };
    let cost = |correlated: Option<[f64; 2]>, pose: f64| {
        restricted_likelihood(model, &at(correlated, pose)).map_or(f64::INFINITY, |m| m.restricted)
    };
    let plain = cost(None, 0.0);
    if !plain.is_finite() {
        return None;
    }
    let independent = Weights::independent(relative.to_vec());
    let repeats = inputs.held_repeats(&independent);
    let ratio = RATIOS.map(f64::ln);
    let tau = inputs
        .clock
        .as_ref()
        .filter(|_| independent.active() >= MIN_CORRELATED)
        .and_then(|c| time_constants(c));
    let can_pose = repeats >= MIN_HELD_REPEATS;
    // Pose scatter alone, correlation alone, both.
    let pose_alone = can_pose.then(|| {
        best_of(&[-1.0, 0.0, 1.0, 2.0], |r| {
            pattern_search([*r], [0.7], [ratio[0]], [ratio[1]], &|v| {
                cost(None, v[0].exp())
            })
        })
    });
    let correlated_alone = tau.map(|tau| {
        // Long and short time constants are hollows of their own: each has a start.
        let starts: Vec<[f64; 2]> = (0..4)
            .flat_map(|k| {
                [-0.7, 0.7, 2.0]
                    .map(|r| [r, tau[0] + (tau[1] - tau[0]) * (0.5 + f64::from(k)) / 4.0])
            })
            .collect();
        let coarse = starts
            .iter()
            .map(|v| (cost(Some([v[0].exp(), v[1].exp()]), 0.0), *v));
        let start = coarse
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or([0.0, tau[0]], |c| c.1);
        pattern_search(
            start,
            [0.5, 0.5],
            [ratio[0], tau[0]],
            [ratio[1], tau[1]],
            &|v| cost(Some([v[0].exp(), v[1].exp()]), 0.0),
        )
    });
    let mut found: (f64, Option<[f64; 2]>, f64) = (plain, None, 0.0);
    if let Some((v, c)) = pose_alone.filter(|(_, c)| plain - c > gain_at_bound(NOISE_PART)) {
        found = (c, None, v[0].exp());
    }
    if let Some((v, c)) =
        correlated_alone.filter(|(_, c)| plain - c > correlated_gain && *c < found.0 - 2.0)
    {
        found = (c, Some(v.map(f64::exp)), 0.0);
    }
    // Both parts can hold what one alone takes up: they are searched together once more.
    if let (Some(tau), true, true) = (tau, can_pose, found.0 < plain) {
        let start = [
            found.1.map_or(-0.7, |c| c[0].ln()),
            found.1.map_or(0.5 * (tau[0] + tau[1]), |c| c[1].ln()),
            if found.2 > 0.0 { found.2.ln() } else { -0.7 },
        ];
        let (low, high) = ([ratio[0], tau[0], ratio[0]], [ratio[1], tau[1], ratio[1]]);
        let both = pattern_search(start, [0.5; 3], low, high, &|v| {
            cost(Some([v[0].exp(), v[1].exp()]), v[2].exp())
        });
        let needed = if found.1.is_some() {
            gain_at_bound(NOISE_PART)
        } else {
            correlated_gain
        };
        if found.0 - both.1 > needed {
            found = (
                both.1,
                Some([both.0[0].exp(), both.0[1].exp()]),
                both.0[2].exp(),
            );
        }
    }
    let (cost, correlated, pose) = found;
    Some(Shared {
        cost,
        correlated,
        pose,
    })
}

impl Components {
    /// Pose scatter, and what is correlated in time with its time constant, each with its interval;
    /// none where the design does not tell.
    fn stated(
        &self,
        model: &MeanModel,
        inputs: &NoiseInputs,
    ) -> (Option<NoisePart>, Option<(NoisePart, f64)>) {
        let Shared {
            cost,
            correlated,
            pose,
        } = self.shared;
        let likelihood = |correlated: Option<[f64; 2]>, pose: f64| {
            let shared = inputs.shared(correlated, pose);
            restricted_likelihood(model, &Weights::sharing(self.relative.clone(), shared))
        };
        let s = likelihood(correlated, pose).map_or(f64::NAN, |m| (m.ssr / m.dof).sqrt());
        let around = |value: f64| STEPS.map(move |k| value.max(RATIOS[0]) * STEP.powi(k));
        let independent = Weights::independent(self.relative.clone());
        let pose_part = (inputs.held_repeats(&independent) >= MIN_HELD_REPEATS).then(|| {
            let points = around(pose).filter_map(|x| Some((x, likelihood(correlated, x)?)));
            let [low, high] = profile_interval(points, cost);
            NoisePart {
                value: pose * s,
                interval95: [if pose > 0.0 { low } else { 0.0 }, high],
            }
        });
        let range = inputs.clock.as_ref().and_then(|c| time_constants(c));
        let correlated_part = correlated.zip(range).map(|([r, t], range)| {
            let taus = (0..=TAUS)
                .map(|k| range[0] + (range[1] - range[0]) * f64::from(k) / f64::from(TAUS));
            // Profile: at every ratio the time constant that suits it best.
            let points = taus
                .map(f64::exp)
                .chain([t])
                .flat_map(|tau| around(r).map(move |x| [x, tau]));
            let points = points.filter_map(|c| Some((c[0], likelihood(Some(c), pose)?)));
            (
                NoisePart {
                    value: r * s,
                    interval95: profile_interval(points, cost),
                },
                t,
            )
        });
        (pose_part, correlated_part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::sync::Arc;

    /// SIMULATED readings of a straight line in two channels: repeat noise 1, and what is asked
    /// for.
    struct Simulated {
        inputs: NoiseInputs,
        design: DMatrix<f64>,
        residual: DMatrix<f64>,
    }

    fn simulated(pose: f64, correlated: Option<[f64; 2]>, deep: f64, seed: u64) -> Simulated {
        let n = 120;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        // Every pose is read twice without moving.
        let settings: Vec<usize> = (0..n).map(|i| i / 2).collect();
        let depth: Vec<f64> = (0..n).map(|i| ((i / 2) % 7) as f64 / 6.0).collect();
        let mut residual = DMatrix::zeros(n, 2);
        for c in 0..2 {
            let (mut slow, mut set) = (normal() * correlated.map_or(0.0, |x| x[0]), 0.0);
            for i in 0..n {
                if let Some([sd, tau]) = correlated {
                    let decay = (-10.0 / tau).exp();
                    slow = decay * slow + (1.0 - decay * decay).sqrt() * sd * normal();
                }
                if i % 2 == 0 {
                    set = pose * normal();
                }
                residual[(i, c)] = normal() * deep.powf(depth[i]) + slow + set;
            }
        }
        let inputs = NoiseInputs {
            counts_readings: false,
            clock: Some(Arc::new((0..n).map(|i| 10.0 * i as f64).collect())),
            settings: Arc::new(settings),
            posed: Arc::new(vec![true; n]),
            spread: vec![("depth".into(), depth.clone())],
            known: vec![1.0; n],
            averaged: Vec::new(),
            step: Vec::new(),
        };
        Simulated {
            inputs,
            design: DMatrix::from_fn(n, 2, |i, j| if j == 0 { 1.0 } else { depth[i] }),
            residual,
        }
    }

    fn estimated(s: &Simulated) -> Noise {
        let model = MeanModel {
            design: &s.design,
            tangents: &[],
            residual: &s.residual,
            extra: Vec::new(),
        };
        estimate(
            &model,
            &s.inputs,
            &Weights::equal(120),
            correlated_gain(),
            1,
        )
        .unwrap()
    }

    #[test]
    fn every_part_is_found_with_its_size_and_white_noise_has_none() {
        let (mut poses, mut slow, mut laws, mut clean) = (0, 0, 0, 0);
        for seed in 0..20 {
            let n = estimated(&simulated(3.0, None, 1.0, seed));
            let pose = n.pose.unwrap();
            poses += usize::from((2.3..3.9).contains(&pose.value) && n.correlated.is_none());
            let n = estimated(&simulated(0.0, Some([2.0, 400.0]), 1.0, seed));
            slow += usize::from(
                n.correlated
                    .is_some_and(|(sd, _)| (0.8..5.0).contains(&sd.value)),
            );
            let n = estimated(&simulated(0.0, None, 4.0, seed));
            laws += usize::from(
                n.law
                    .is_some_and(|l| (0.9..1.9).contains(&l.spread.exponent)),
            );
            let n = estimated(&simulated(0.0, None, 1.0, seed));
            clean += usize::from(n.weights.shared().is_none() && n.law.is_none());
        }
        assert!(
            poses >= 18 && slow >= 18 && laws >= 18 && clean >= 19,
            "{poses} {slow} {laws} {clean}"
        );
    }

    #[test]
    fn the_interval_of_the_repeat_noise_of_few_readings_holds_it() {
        for n in [5, 6, 8] {
            let design = DMatrix::from_fn(n, 2, |i, j| (i as f64).powi(j as i32));
            let held = (0..400).filter(|seed| {
                let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(*seed);
                let residual = DMatrix::from_fn(n, 1, |_, _| StandardNormal.sample(&mut rng));
                let model = MeanModel {
                    design: &design,
                    tangents: &[],
                    residual: &residual,
                    extra: Vec::new(),
                };
                let inputs = NoiseInputs::none(n);
                let noise =
                    estimate(&model, &inputs, &Weights::equal(n), correlated_gain(), 1).unwrap();
                let [low, high] = noise.repeat.interval95;
                (low..high).contains(&1.0)
            });
            // 380 +- 4.4 expected of Gaussian noise; the Gaussian's interval held 344 to 364.
            let held = held.count();
            assert!((367..=393).contains(&held), "{n}: {held}");
        }
    }

    #[test]
    fn the_interval_of_heavy_tailed_repeat_noise_holds_it() {
        let n = 200;
        let design = DMatrix::from_fn(n, 2, |i, j| (i as f64).powi(j as i32));
        let t = rand_distr::StudentT::new(6.0).unwrap();
        let (mut held, mut gaussian) = (0, 0);
        for seed in 0..300 {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let residual = DMatrix::from_fn(n, 1, |_, _| t.sample(&mut rng));
            let model = MeanModel {
                design: &design,
                tangents: &[],
                residual: &residual,
                extra: Vec::new(),
            };
            let inputs = NoiseInputs::none(n);
            let noise =
                estimate(&model, &inputs, &Weights::equal(n), correlated_gain(), 1).unwrap();
            let inside = |[low, high]: [f64; 2]| usize::from((low..high).contains(&1.5f64.sqrt()));
            held += inside(noise.repeat.interval95);
            gaussian += inside(sd_interval95(noise.repeat.value, (n - 2) as f64).unwrap());
        }
        // 285 +- 3.8 expected; the control takes the noise for Gaussian.
        assert!(held >= 273 && gaussian < 262, "{held} {gaussian}");
    }
}
