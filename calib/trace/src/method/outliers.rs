//! Single readings that do not belong: kept in the table, left out of the fit, taken back where a better model explains them.
//!
//! Residuals are judged by [`super::tails`]. The declared model's first fit must not lean on a gross reading, or it bends toward it and
//! its neighbours look wrong: it starts from least trimmed squares (Rousseeuw & Van Driessen, Technometrics 41, 1999), the coefficients
//! for which the smaller three quarters of the residuals have the least sum of squares.

use super::fit::{Fit, Weights, fit, linear};
use super::hypothesis::Hypothesis;
use super::noise::tails::extreme_values;
use super::signature::nuisance_basis;
use crate::effect::EffectTerm;
use crate::levels::SINGLE_READINGS;
use crate::measurement_model::MeasurementModel;
use nalgebra::DMatrix;
use rand::SeedableRng;
use rand::seq::index::sample;
use std::cmp::Ordering;
use wcal_core::order_statistics::median;

/// More flagged readings than this share are no longer single readings.
const MAX_SHARE: f64 = 0.08;
/// Rounds of flagging and refitting.
const ROUNDS: usize = 6;

/// Residuals in standard deviations of their own, readings x channels: a reading that counts by its whitened residual over the share that
/// the fit leaves, one that does not by its prediction.
pub fn studentised_residuals(fit: &Fit, weights: &Weights) -> DMatrix<f64> {
    let (n, channels) = fit.residual.shape();
    let s = fit.variance().sqrt().max(1e-300);
    let basis = nuisance_basis(fit);
    DMatrix::from_fn(n, channels, |i, c| {
        if weights.counts(i) {
            fit.residual[(i, c)] / (s * basis.unexplained_sd(c * n + i))
        } else {
            fit.raw_residual[(i, c)] / (s * weights.total_sd(i))
        }
    })
}

/// Last digit of each channel's readings, 0 where they are written finely: a reading that is one digit off is no outlier, however well the others
/// agree.
fn quantisation_step(system: &dyn MeasurementModel, channels: usize) -> Vec<f64> {
    let steps = system.noise_inputs().step;
    (0..channels)
        .map(|c| steps.get(c).copied().flatten().unwrap_or(0.0))
        .collect()
}

/// How far a reading of the digit beside the nearest one may lie from a model that passes between two, in digits.
const ONE_DIGIT: f64 = 1.5;

/// Flags readings that no tails explain, refits, and flags anew from all readings until nothing changes. `weights` may hold earlier flags.
pub fn reject_outliers(
    system: &dyn MeasurementModel,
    terms: &[EffectTerm],
    start: &Fit,
    weights: &Weights,
) -> Option<Hypothesis> {
    let (n, channels) = start.residual.shape();
    if n < 12 {
        return None;
    }
    let most = (MAX_SHARE * n as f64) as usize + 1;
    let all = weights.unmasked();
    let mut current = start.clone();
    let mut weights = weights.clone();
    let mut flagged: Vec<usize> = (0..n)
        .filter(|&i| all.counts(i) && !weights.counts(i))
        .collect();
    let (mut p_value, digit) = (1.0, quantisation_step(system, channels));
    for _ in 0..ROUNDS {
        let z = studentised_residuals(&current, &weights);
        let judged: Vec<f64> = (0..n)
            .filter(|&i| all.counts(i))
            .flat_map(|i| z.row(i).iter().copied().collect::<Vec<_>>())
            .collect();
        let found = extreme_values(&judged, most * channels, SINGLE_READINGS);
        let next: Vec<usize> = found.as_ref().map_or(Vec::new(), |f| {
            let beyond = |i: usize, c: usize| {
                z[(i, c)].abs() >= f.beyond
                    && current.raw_residual[(i, c)].abs() > ONE_DIGIT * digit[c]
            };
            (0..n)
                .filter(|&i| all.counts(i) && (0..channels).any(|c| beyond(i, c)))
                .collect()
        });
        p_value = found.map_or(1.0, |f| f.p_value);
        if next.len() > most {
            return None;
        }
        if next == flagged {
            break;
        }
        flagged = next;
        weights = all.masked(|i| !flagged.contains(&i));
        current = fit(system, terms, &weights, 15)?;
    }
    let singly = !flagged.is_empty() && are_isolated(system, &all, &flagged);
    singly.then_some(Hypothesis {
        fit: current,
        weights,
        flagged,
        flag_p: p_value,
    })
}

/// Fewest flagged readings of which it can be said that they are no single ones.
const MIN_STRUCTURE: usize = 4;
/// Share of the flagged readings that may have a flagged neighbour.
const MAX_NEIGHBOURS: f64 = 0.5;
/// Share of the readings at rest that may be flagged: nothing touches the wire there.
const MAX_REST: f64 = 0.25;

/// Fewest readings of a group, or of a setting, that, flagged all together, are what the model lacks of it.
const MIN_GROUP: usize = 3;

/// Whether flagged readings stand singly: a whole stretch of them, a whole group, or many at rest, is what the model lacks.
fn are_isolated(system: &dyn MeasurementModel, all: &Weights, flagged: &[usize]) -> bool {
    let counted: Vec<usize> = (0..all.len()).filter(|&i| all.counts(i)).collect();
    let place = |i: &usize| counted.binary_search(i).unwrap_or(usize::MAX);
    let places: std::collections::BTreeSet<usize> = flagged.iter().map(place).collect();
    let beside = |p: &&usize| {
        places.contains(&(**p + 1)) || p.checked_sub(1).is_some_and(|q| places.contains(&q))
    };
    let neighbours = places.iter().filter(beside).count();
    let posed = system.noise_inputs().posed;
    let at_rest = counted.iter().filter(|&&i| !posed[i]).count();
    let rest_flagged = flagged.iter().filter(|&&i| !posed[i]).count();
    let groups = system.groups();
    let of_group = |group: u32| {
        counted
            .iter()
            .filter(|&&i| posed[i] && groups[i] == group)
            .collect::<Vec<_>>()
    };
    let whole_group = flagged.iter().any(|&i| {
        let own = of_group(groups[i]);
        own.len() >= MIN_GROUP && own.iter().all(|k| flagged.contains(k))
    });
    // Readings of equal columns are of one setting.
    let whole_setting = system.design(&[]).is_some_and(|design| {
        flagged.iter().any(|&i| {
            let own = counted.iter().filter(|&&k| design.row(k) == design.row(i));
            own.clone().count() >= MIN_GROUP && own.into_iter().all(|k| flagged.contains(k))
        })
    });
    let stretch =
        neighbours >= MIN_STRUCTURE && neighbours as f64 > MAX_NEIGHBOURS * flagged.len() as f64;
    let resting = rest_flagged >= MIN_STRUCTURE && rest_flagged as f64 > MAX_REST * at_rest as f64;
    !(stretch || resting || whole_group || whole_setting)
}

/// Draws of the elemental sets.
const DRAWS: usize = 300;
/// Fits of a set, each to the readings that the one before holds.
const CONCENTRATIONS: usize = 4;
/// Share of the readings that the trimmed fit holds on to.
const HELD: f64 = 0.75;
/// Robust standard deviations from which a reading is gross: what anything less does to the first fit, flagging anew mends.
const GROSS: f64 = 20.0;
/// Robust standard deviations that noise with heavy tails reaches now and then.
const LARGE: f64 = 5.0;

/// Readings that stand so far out of the declared model that its first fit must not see them.
pub fn initial_outliers(system: &dyn MeasurementModel, weights: &Weights, seed: u64) -> Vec<usize> {
    let Some(raw) = system.design(&[]) else {
        return Vec::new();
    };
    let rows: Vec<usize> = (0..weights.len()).filter(|&i| weights.counts(i)).collect();
    let (n, q) = (rows.len(), raw.ncols());
    let held = ((HELD * n as f64) as usize).max(q + 2);
    if n < q + 6 || held >= n {
        return Vec::new();
    }
    let scaled = |m: &DMatrix<f64>| {
        DMatrix::from_fn(n, m.ncols(), |k, j| m[(rows[k], j)] * weights.of(rows[k]))
    };
    let (x, y) = (scaled(&raw), scaled(system.measured()));
    let channels = y.ncols();
    let digit = quantisation_step(system, channels);
    // Channels may have noises of different sizes; a reading is as far out as its worst channel.
    let sizes = |subset: &[usize]| -> Vec<f64> {
        let (b, ..) = linear(&x.select_rows(subset), &y.select_rows(subset));
        let r = &y - &x * b;
        let scale: Vec<f64> = (0..channels)
            .map(|c| {
                let typical = median(r.column(c).iter().map(|v| v.abs())).unwrap_or(0.0);
                typical.max(0.6745 * digit[c] / 12.0_f64.sqrt()).max(1e-300)
            })
            .collect();
        (0..n)
            .map(|k| {
                (0..channels)
                    .map(|c| r[(k, c)].abs() / scale[c])
                    .fold(0.0, f64::max)
                    * 0.6745
            })
            .collect()
    };
    // The whole fit's trimmed sum in the worst channel's units would change with the scale: compare by the spread itself.
    let spread = |subset: &[usize]| -> (f64, Vec<usize>) {
        let (b, ..) = linear(&x.select_rows(subset), &y.select_rows(subset));
        let r = &y - &x * b;
        let squares: Vec<f64> = r.row_iter().map(|r| r.norm_squared()).collect();
        let mut ranked = squares.clone();
        let limit = *ranked.select_nth_unstable_by(held - 1, f64::total_cmp).1;
        let mut ties = held
            - squares
                .iter()
                .filter(|s| s.total_cmp(&limit).is_lt())
                .count();
        // In the order of the table, so that sums do not depend on how they were picked; of equal ones the first.
        let mut is_held = |square: f64| match square.total_cmp(&limit) {
            Ordering::Equal if ties > 0 => {
                ties -= 1;
                true
            }
            by => by.is_lt(),
        };
        let order: Vec<usize> = (0..n).filter(|&k| is_held(squares[k])).collect();
        (order.iter().map(|&k| squares[k]).sum(), order)
    };
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed ^ 0x0175);
    let mut best: Option<(f64, Vec<usize>)> = None;
    for _ in 0..DRAWS {
        let mut subset = sample(&mut rng, n, (q + 1).min(n)).into_vec();
        let mut cost = f64::INFINITY;
        for _ in 0..CONCENTRATIONS {
            let (next_cost, next) = spread(&subset);
            let settled = next == subset;
            (cost, subset) = (next_cost, next);
            if settled {
                break;
            }
        }
        if best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, subset));
        }
    }
    let Some((_, subset)) = best else {
        return Vec::new();
    };
    let size = sizes(&subset);
    let out: Vec<usize> = (0..n)
        .filter(|&k| size[k] > GROSS)
        .map(|k| rows[k])
        .collect();
    // Many such readings, or a slope of large ones beside them, are structure: what the model lacks, not gross readings.
    let large = (0..n)
        .filter(|&k| size[k] > LARGE && size[k] <= GROSS)
        .count() as f64;
    let structure = out.len() as f64 > 0.03 * n as f64 + 2.0
        || large > (0.02 * n as f64 + 1.0).max(out.len() as f64);
    if structure { Vec::new() } else { out }
}
