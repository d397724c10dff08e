//! How far the stated probability of several contacts can be trusted, and a map that calibrates it.
//!
//! With p the stated probability of several contacts where there is contact, y = 1 where there are several and 0 where there is one, and
//! l = ln(p / (1 - p)):
//!
//! ```text
//! map         q = 1 / (1 + exp(-(a l + b)))                       a = 1, b = 0: the identity; a < 1: p was overconfident
//! fit         (a, b) = argmin -sum [t ln q + (1 - t) ln(1 - q)],  t = (N1 + 1) / (N1 + 2) where y = 1, 1 / (N0 + 2) where y = 0
//! Brier       mean (q - y)^2;  of the constant base rate: ybar (1 - ybar)
//! ECE         sum_b (n_b / n) |mean_b q - mean_b y|               over ten bins b of equal width in q
//! ```
//!
//! Objects differ in how often they are touched at several places, and a map moves all of them alike. So it is kept only where it lowers the loss
//! on objects that were not in its fit: with d_o the sum over the samples of object o of the loss through the map of all other objects less that of
//! the network's own probability, where `mean d + se(mean d) < 0` (one standard error: L. Breiman et al., "Classification and Regression Trees", 1984).
//!
//! Sources: map and targets t: J. Platt, "Probabilistic outputs for support vector machines", 1999; Newton's method with backtracking: H.-T.
//! Lin, C.-J. Lin, R. C. Weng, Machine Learning 68 (2007) 267; G. W. Brier, Mon. Weather Rev. 78 (1950) 1; expected calibration error (ECE):
//! M. P. Naeini, G. F. Cooper, M. Hauskrecht, AAAI 2015.

use crate::sweep_series::{SweepSample, SweepSeries};
use crate::tracker::{Sample, Tracker};
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Platt scaling of a probability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlattMap {
    /// a of the module's head.
    pub slope: f64,
    /// b of the module's head.
    pub offset: f64,
}

impl Default for PlattMap {
    fn default() -> Self {
        Self { slope: 1.0, offset: 0.0 }
    }
}

/// Samples of each kind below which no map is fitted.
const MIN_SAMPLES: usize = 50;
/// Bins of the stated probability.
const BINS: usize = 10;
/// Probabilities nearer to 0 or 1 than this have no finite logit in 32 bits.
const MIN_PROBABILITY: f64 = 1e-7;

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// ln(p / (1 - p)).
fn logit(p: f64) -> f64 {
    let p = p.clamp(MIN_PROBABILITY, 1.0 - MIN_PROBABILITY);
    (p / (1.0 - p)).ln()
}

/// A stated probability of several contacts and whether there were several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeveralCall {
    /// Stated.
    pub probability: f64,
    /// True.
    pub several: bool,
}

impl PlattMap {
    /// The calibrated probability of a logit.
    #[must_use]
    pub fn of_logit(&self, logit: f64) -> f64 {
        sigmoid(self.slope * logit + self.offset)
    }

    /// The calibrated probability of a stated one.
    #[must_use]
    pub fn apply(&self, probability: f64) -> f64 {
        self.of_logit(logit(probability))
    }

    /// Fitted by maximum likelihood; none where either kind has fewer than 50 samples, or where no rising map is better than a constant.
    #[must_use]
    pub fn fitted(calls: &[SeveralCall]) -> Option<Self> {
        let several = calls.iter().filter(|c| c.several).count();
        let one = calls.len() - several;
        if several.min(one) < MIN_SAMPLES {
            return None;
        }
        // Targets that a finite sample allows, so that classes which are separated do not send the slope to infinity.
        let targets = [1.0 / (one as f64 + 2.0), (several as f64 + 1.0) / (several as f64 + 2.0)];
        let pairs: Vec<(f64, f64)> =
            calls.iter().map(|c| (logit(c.probability), targets[usize::from(c.several)])).collect();
        let map = newton(&pairs)?;
        (map.slope > 0.0).then_some(map)
    }
}

/// The map of all objects' calls where it holds on objects that were not in its fit (the module's head); none where the network's own
/// probability is as good, or there are too few samples or fewer than three objects.
#[must_use]
pub fn map_that_holds(by_object: &[Vec<SeveralCall>]) -> Option<PlattMap> {
    const MIN_OBJECTS: usize = 3;
    let n = by_object.len() as f64;
    if by_object.len() < MIN_OBJECTS {
        return None;
    }
    let sum = |map: &PlattMap, calls: &[SeveralCall]| {
        let pair = |c: &SeveralCall| (logit(c.probability), f64::from(u8::from(c.several)));
        let pairs: Vec<(f64, f64)> = calls.iter().map(pair).collect();
        if pairs.is_empty() { 0.0 } else { mean_loss(map, &pairs) * pairs.len() as f64 }
    };
    let change = |o: usize| {
        let others: Vec<SeveralCall> =
            (0..by_object.len()).filter(|k| *k != o).flat_map(|k| by_object[k].iter().copied()).collect();
        let map = PlattMap::fitted(&others)?;
        Some(sum(&map, &by_object[o]) - sum(&PlattMap::default(), &by_object[o]))
    };
    let changes: Vec<f64> = (0..by_object.len()).map(change).collect::<Option<_>>()?;
    let mean = changes.iter().sum::<f64>() / n;
    let variance = changes.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    if mean + (variance / n).sqrt() >= 0.0 {
        return None;
    }
    PlattMap::fitted(&by_object.concat())
}

/// Mean of `-(t ln q + (1 - t) ln(1 - q))` over logits and targets, in the form that does not overflow.
fn mean_loss(map: &PlattMap, pairs: &[(f64, f64)]) -> f64 {
    let one = |(l, t): &(f64, f64)| {
        let x = map.slope * l + map.offset;
        x.max(0.0) - t * x + (-x.abs()).exp().ln_1p()
    };
    pairs.iter().map(one).sum::<f64>() / pairs.len() as f64
}

/// Minimum of [`mean_loss`], which is convex in (a, b).
fn newton(pairs: &[(f64, f64)]) -> Option<PlattMap> {
    const STEPS: usize = 100;
    // A ridge keeps the Hessian invertible where all logits are alike.
    const RIDGE: f64 = 1e-10;
    let n = pairs.len() as f64;
    let mut map = PlattMap::default();
    let mut loss = mean_loss(&map, pairs);
    for _ in 0..STEPS {
        let (mut slope, mut hessian) = (Vector2::zeros(), Matrix2::identity() * RIDGE);
        for (l, t) in pairs {
            let q = map.of_logit(*l);
            let by = Vector2::new(*l, 1.0);
            slope += by * ((q - t) / n);
            hessian += by * by.transpose() * (q * (1.0 - q) / n);
        }
        let step = hessian.try_inverse()? * slope;
        // Halved until the loss falls by the share that its slope promises (Armijo).
        let mut length = 1.0;
        let next = loop {
            let tried =
                PlattMap { slope: map.slope - length * step[0], offset: map.offset - length * step[1] };
            let found = mean_loss(&tried, pairs);
            if found <= loss - 1e-4 * length * slope.dot(&step) {
                break Some((tried, found));
            }
            length *= 0.5;
            if length < 1e-10 {
                break None;
            }
        };
        let Some((tried, found)) = next else { break };
        (map, loss) = (tried, found);
        if step.norm() < 1e-9 {
            break;
        }
    }
    (map.slope.is_finite() && map.offset.is_finite()).then_some(map)
}

/// Stated probabilities in an interval and how often there were several contacts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReliabilityBin {
    /// Interval of the stated probability.
    pub from: f64,
    /// See `from`.
    pub to: f64,
    /// Samples.
    pub samples: usize,
    /// Mean stated probability.
    pub stated: f64,
    /// Share with several contacts.
    pub observed: f64,
}

/// How far stated probabilities can be trusted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reliability {
    /// Samples with contact.
    pub samples: usize,
    /// Share of those with several contacts.
    pub share: f64,
    /// Brier score.
    pub brier: f64,
    /// That of stating `share` at every sample.
    pub brier_base_rate: f64,
    /// Expected calibration error.
    pub expected_calibration_error: f64,
    /// Bins that have samples.
    pub bins: Vec<ReliabilityBin>,
}

impl Reliability {
    /// Of calls through a map; none without calls.
    #[must_use]
    pub fn of(calls: &[SeveralCall], map: &PlattMap) -> Option<Self> {
        if calls.is_empty() {
            return None;
        }
        let n = calls.len() as f64;
        let stated: Vec<(f64, f64)> =
            calls.iter().map(|c| (map.apply(c.probability), f64::from(u8::from(c.several)))).collect();
        let share = stated.iter().map(|s| s.1).sum::<f64>() / n;
        let bin = |k: usize| {
            let within = |q: f64| ((q * BINS as f64) as usize).min(BINS - 1) == k;
            let own: Vec<&(f64, f64)> = stated.iter().filter(|s| within(s.0)).collect();
            let mean = |of: fn(&(f64, f64)) -> f64| own.iter().map(|s| of(s)).sum::<f64>() / own.len() as f64;
            (!own.is_empty()).then(|| ReliabilityBin {
                from: k as f64 / BINS as f64,
                to: (k + 1) as f64 / BINS as f64,
                samples: own.len(),
                stated: mean(|s| s.0),
                observed: mean(|s| s.1),
            })
        };
        let bins: Vec<ReliabilityBin> = (0..BINS).filter_map(bin).collect();
        let off = |b: &ReliabilityBin| b.samples as f64 / n * (b.stated - b.observed).abs();
        Some(Self {
            samples: calls.len(),
            share,
            brier: stated.iter().map(|(q, y)| (q - y).powi(2)).sum::<f64>() / n,
            brier_base_rate: share * (1.0 - share),
            expected_calibration_error: bins.iter().map(off).sum(),
            bins,
        })
    }
}

/// The network's own probabilities of several contacts, before any map, at the samples with contact; `base_known`: with the base's speed.
#[must_use]
pub fn several_calls<'a>(
    tracker: &Tracker,
    all_series: impl Iterator<Item = &'a SweepSeries>,
    base_known: bool,
) -> Vec<SeveralCall> {
    let tracker = &Tracker { several_maps: [PlattMap::default(); 2], ..tracker.clone() };
    let all_series: Vec<&SweepSeries> = all_series.collect();
    let one = |series: &&SweepSeries| {
        let sample = |i: &SweepSample| Sample {
            t_s: i.t_s,
            moment_nmm: i.moment_nmm,
            base_mm_s: base_known.then_some(i.speed_mm_s),
        };
        let answers = tracker.track_series(&series.samples.iter().map(sample).collect::<Vec<_>>());
        let both = series.samples.iter().zip(answers).filter(|(i, _)| i.contact.is_some());
        let calls = both.map(|(i, answer)| SeveralCall {
            probability: f64::from(answer.several),
            several: i.contacts >= 2,
        });
        calls.collect::<Vec<_>>()
    };
    all_series.par_iter().flat_map_iter(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Contacts that are several with probability sigmoid(-1 + 2 z), stated with `slope` times that logit.
    fn drawn(count: usize, slope: f64, seed: u64) -> Vec<SeveralCall> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let one = |_| {
            let z: f64 = StandardNormal.sample(&mut rng);
            let truth = -1.0 + 2.0 * z;
            SeveralCall { probability: sigmoid(slope * truth), several: rng.random_bool(sigmoid(truth)) }
        };
        (0..count).map(one).collect()
    }

    fn error(calls: &[SeveralCall], map: &PlattMap) -> f64 {
        Reliability::of(calls, map).unwrap().expected_calibration_error
    }

    /// 20,000 draws: slope and offset scatter by 0.02, the share in a bin of a tenth of them by 0.01.
    #[test]
    fn an_overconfident_probability_is_mended_on_other_samples() {
        let map = PlattMap::fitted(&drawn(20_000, 3.0, 1)).unwrap();
        assert!((map.slope - 1.0 / 3.0).abs() < 0.02 && map.offset.abs() < 0.08, "{map:?}");
        let others = drawn(20_000, 3.0, 2);
        let (before, after) = (error(&others, &PlattMap::default()), error(&others, &map));
        assert!(before > 0.08 && after < 0.02, "{before} {after}");
        let [bold, mended] = [PlattMap::default(), map].map(|m| Reliability::of(&others, &m).unwrap());
        assert!(mended.brier < bold.brier && mended.brier < mended.brier_base_rate, "{mended:?}");
    }

    #[test]
    fn a_calibrated_probability_is_left_alone() {
        let map = PlattMap::fitted(&drawn(20_000, 1.0, 3)).unwrap();
        assert!((map.slope - 1.0).abs() < 0.08 && map.offset.abs() < 0.08, "{map:?}");
        for p in [0.02, 0.3, 0.9] {
            assert!((map.apply(p) - p).abs() < 0.02, "{p}: {}", map.apply(p));
        }
        assert!(error(&drawn(20_000, 1.0, 4), &PlattMap::default()) < 0.02);
    }

    /// A statement that has nothing to do with the truth: the map says the base rate, and the Brier score is no better than that.
    #[test]
    fn a_probability_that_says_nothing_becomes_the_base_rate() {
        let mut calls = drawn(20_000, 3.0, 5);
        let truth: Vec<bool> = calls.iter().map(|c| c.several).collect();
        let shifted = truth.iter().cycle().skip(7777);
        calls.iter_mut().zip(shifted).for_each(|(c, s)| c.several = *s);
        let share = truth.iter().filter(|t| **t).count() as f64 / truth.len() as f64;
        let judged = Reliability::of(&calls, &PlattMap::default()).unwrap();
        assert!(judged.brier > 1.2 * judged.brier_base_rate && (judged.share - share).abs() < 1e-12);
        if let Some(map) = PlattMap::fitted(&calls) {
            assert!(map.slope < 0.02 && (map.apply(0.5) - share).abs() < 0.02, "{map:?}");
        }
        assert_eq!(PlattMap::fitted(&calls[..40]), None);
        assert_eq!(Reliability::of(&[], &PlattMap::default()), None);
    }

    /// Ten objects: a map that helps all is kept; one that only moves to the mean of objects that differ is not, nor one of too few objects.
    #[test]
    fn a_map_is_kept_where_it_holds_on_other_objects() {
        let bold: Vec<Vec<SeveralCall>> = (0..10).map(|k| drawn(2000, 3.0, 10 + k)).collect();
        let map = map_that_holds(&bold).unwrap();
        assert!((map.slope - 1.0 / 3.0).abs() < 0.03, "{map:?}");
        assert_eq!(map_that_holds(&bold[..2]), None);
        let calibrated: Vec<Vec<SeveralCall>> = (0..10).map(|k| drawn(2000, 1.0, 30 + k)).collect();
        let kept = map_that_holds(&calibrated);
        assert!(kept.is_none_or(|m| (m.slope - 1.0).abs() < 0.08), "{kept:?}");
        // Half of the objects have more than is stated, the others less: whatever a map of the others does helps one half alone.
        let shifted: Vec<Vec<SeveralCall>> = (0..10)
            .map(|k| {
                let by = PlattMap { slope: 1.0, offset: if k % 2 == 0 { 1.5 } else { -1.5 } };
                let calls = drawn(2000, 1.0, 50 + k);
                calls.into_iter().map(|c| SeveralCall { probability: by.apply(c.probability), ..c }).collect()
            })
            .collect();
        let error = |map: &PlattMap| error(&shifted.concat(), map);
        if let Some(map) = map_that_holds(&shifted) {
            assert!(error(&map) < error(&PlattMap::default()), "{map:?}");
        }
    }

    #[test]
    fn bins_hold_every_sample_once_certain_ones_too() {
        let of = |probability, several| SeveralCall { probability, several };
        let calls = [of(0.0, false), of(0.1, false), of(0.95, true), of(1.0, true), of(1.0, false)];
        let judged = Reliability::of(&calls, &PlattMap::default()).unwrap();
        assert_eq!(judged.bins.iter().map(|b| b.samples).sum::<usize>(), 5);
        assert_eq!(judged.bins.last().map(|b| b.samples), Some(3));
        assert!((judged.share - 0.4).abs() < 1e-12 && (judged.brier_base_rate - 0.24).abs() < 1e-12);
    }
}
