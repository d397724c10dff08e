//! Single readings that do not belong: kept in the table, left out of the fit, readmitted where a
//! better model explains them.
//!
//! A gross reading bends the fit that holds it, so each is judged by a fit without it. The one with
//! the largest `e_v^2 / (1 - h_v)` is deleted, then the next, and all are judged by what remains of
//! the fit (Hadi & Simonoff, J. Am. Stat. Assoc. 88 (1993), 1264-1272):
//!
//! ```text
//! e_u += h_uv e_v / (1 - h_v),   h_u += h_uv^2 / (1 - h_v)              v deleted; e: whitened residual, h: hat matrix
//! d_v = e_v / sqrt(1 - h_v) of a reading that is held,   e_v / sqrt(1 + h_v) of a deleted one
//! ```
//!
//! [`super::noise::tails`] says which of them no noise explains; these alone are left out of the
//! next fit, until nothing changes. A gross reading beside a bend shows on a smooth curve of the
//! model's own ([`MeasurementModel::smooth_columns`]), which is no name: the search goes on without
//! that reading.

use super::fit::{Fit, Weights, fit, linear};
use super::hypothesis::Hypothesis;
use super::inference::covariance;
use super::noise::tails::extreme_values;
use super::signature::nuisance_basis;
use crate::effect::EffectTerm;
use crate::levels::SINGLE_READINGS;
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};

/// More flagged readings than this share are no longer single readings.
const MAX_SHARE: f64 = 0.08;
/// Rounds of flagging and refitting.
const ROUNDS: usize = 6;
/// Variance of the place that the others give a reading, in its own: where a smooth curve is known
/// no better, it says nothing of the reading.
const REACH: f64 = 1.0;
/// A reading that determines itself has no residual to be judged by.
const LEAST_LEFT: f64 = 0.05;

/// A residual in its standard deviations, `h` its leverage; NaN where the others do not say where
/// the reading should be.
fn studentised(left: f64, h: f64, held: bool, reach: f64) -> f64 {
    // A held reading draws the fit toward itself, a deleted one is predicted with the fit's error.
    let (variance, place) = if held {
        (1.0 - h, h / (1.0 - h))
    } else {
        (1.0 + h, h)
    };
    if place > reach || !place.is_finite() {
        f64::NAN
    } else {
        left / variance.max(LEAST_LEFT).sqrt()
    }
}

/// Studentised residuals of a fit, readings x channels: a reading that does not count is judged by
/// its prediction.
fn studentised_residuals(fit: &Fit, weights: &Weights, reach: f64) -> DMatrix<f64> {
    let ((n, channels), q) = (fit.residual.shape(), fit.design.ncols());
    let s = fit.variance().sqrt().max(1e-300);
    let (basis, spread) = (nuisance_basis(fit), covariance(fit, 1.0));
    DMatrix::from_fn(n, channels, |i, c| {
        if weights.counts(i) {
            let h = 1.0 - basis.unexplained_sd(c * n + i).powi(2);
            return studentised(fit.residual[(i, c)] / s, h, true, reach);
        }
        // Variance of the prediction by the parameters' covariance.
        let mut row = DVector::zeros(spread.nrows());
        row.rows_mut(c * q, q)
            .copy_from(&fit.raw_design.row(i).transpose());
        fit.raw_tangents
            .iter()
            .enumerate()
            .for_each(|(k, t)| row[q * channels + k] = t[(i, c)]);
        let own = weights.total_sd(i);
        // x' (X'X)^-1 x in units of the reading's own noise: the leverage that it would have.
        let h = row.dot(&(&spread * &row)) / (own * own);
        studentised(fit.raw_residual[(i, c)] / (s * own), h, false, reach)
    })
}

/// The same of the linear model of a fit from which the `most` readings that stand farthest out are
/// deleted, one after the other.
fn without_the_farthest(fit: &Fit, weights: &Weights, most: usize, reach: f64) -> DMatrix<f64> {
    let (n, channels) = fit.residual.shape();
    let size = n * channels;
    let basis = nuisance_basis(fit);
    let row = |v: usize| DVector::from_iterator(basis.rank(), basis.vectors().iter().map(|q| q[v]));
    let rows: Vec<DVector<f64>> = (0..size).map(row).collect();
    let mut inverse = DMatrix::identity(basis.rank(), basis.rank());
    let mut left = fit.residual.as_slice().to_vec();
    let mut leverage: Vec<f64> = rows.iter().map(|r| r.norm_squared()).collect();
    let mut held: Vec<bool> = (0..n).map(|i| weights.counts(i)).collect();
    for _ in 0..most {
        let fall = |v: &usize| left[*v] * left[*v] / (1.0 - leverage[*v]).max(LEAST_LEFT);
        let open = (0..size).filter(|v| held[v % n]);
        let Some(farthest) = open.max_by(|a, b| fall(a).total_cmp(&fall(b))) else {
            break;
        };
        held[farthest % n] = false;
        for v in (0..channels).map(|c| c * n + farthest % n) {
            if leverage[v] > 1.0 - LEAST_LEFT {
                continue;
            }
            // Sherman-Morrison: (A - q q')^-1 after one row is gone, without a refit.
            let along = &inverse * &rows[v];
            let (share, e) = (1.0 / (1.0 - leverage[v]), left[v]);
            for u in 0..size {
                let h = rows[u].dot(&along);
                left[u] += h * e * share;
                leverage[u] += h * h * share;
            }
            inverse += &along * along.transpose() * share;
        }
    }
    DMatrix::from_fn(n, channels, |i, c| {
        studentised(left[c * n + i], leverage[c * n + i], held[i], reach)
    })
}

/// How far a reading of the digit beside the nearest one may lie from a model that passes between
/// two, in digits.
const ONE_DIGIT: f64 = 1.5;

/// Flags readings that no tails explain, refits, and flags anew from all readings until nothing
/// changes. `weights` may hold earlier flags.
pub fn reject_outliers(
    system: &dyn MeasurementModel,
    terms: &[EffectTerm],
    start: &Fit,
    weights: &Weights,
) -> Option<Hypothesis> {
    reject(
        system,
        &|weights| fit(system, terms, weights, 15),
        start,
        weights,
        f64::INFINITY,
    )
}

fn reject(
    system: &dyn MeasurementModel,
    refit: &dyn Fn(&Weights) -> Option<Fit>,
    start: &Fit,
    weights: &Weights,
    reach: f64,
) -> Option<Hypothesis> {
    let (n, channels) = start.residual.shape();
    let most = (MAX_SHARE * n as f64) as usize + 1;
    let all = weights.unmasked();
    let mut current = start.clone();
    let mut weights = weights.clone();
    let mut flagged: Vec<usize> = (0..n)
        .filter(|&i| all.counts(i) && !weights.counts(i))
        .collect();
    let (mut p_value, digit) = (1.0, system.noise_inputs().step);
    let values = channels * (0..n).filter(|&i| all.counts(i)).count();
    let dof = values.saturating_sub(start.design.ncols() * channels + start.tangents.len());
    let mut z = if flagged.is_empty() {
        without_the_farthest(start, &weights, most, reach)
    } else {
        studentised_residuals(start, &weights, reach)
    };
    for _ in 0..ROUNDS {
        let judged: Vec<f64> = (0..n)
            .filter(|&i| all.counts(i))
            .flat_map(|i| {
                z.row(i)
                    .iter()
                    .copied()
                    .filter(|z| z.is_finite())
                    .collect::<Vec<_>>()
            })
            .collect();
        let found = extreme_values(&judged, most * channels, dof, SINGLE_READINGS);
        let next: Vec<usize> = found.as_ref().map_or(Vec::new(), |f| {
            let beyond = |i: usize, c: usize| {
                z[(i, c)].abs() >= f.beyond
                    && current.raw_residual[(i, c)].abs()
                        > ONE_DIGIT * digit.get(c).copied().flatten().unwrap_or(0.0)
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
        current = refit(&weights)?;
        z = studentised_residuals(&current, &weights, reach);
    }
    let singly = !flagged.is_empty() && are_isolated(system, &all, &flagged);
    singly.then_some(Hypothesis {
        fit: current,
        weights,
        flagged,
        flag_p: p_value,
    })
}

/// The declared model without readings that stand out of every smooth curve through the others,
/// bent or not.
pub(crate) fn without_gross_readings(
    system: &dyn MeasurementModel,
    declared: Hypothesis,
) -> Hypothesis {
    let columns = system.smooth_columns();
    let curve = |weights: &Weights| {
        let plain = fit(system, &[], weights, 15)?;
        let (n, q) = plain.raw_design.shape();
        let raw = DMatrix::from_fn(n, q + columns.len(), |i, j| {
            if j < q {
                plain.raw_design[(i, j)]
            } else {
                columns[j - q][i]
            }
        });
        let design = weights.apply(&raw);
        let (coefficients, residual, _) = linear(&design, &weights.apply(system.measured()));
        let dof = plain.dof - (columns.len() * residual.ncols()) as f64;
        let ssr = residual.norm_squared() + plain.auxiliary_residual.norm_squared();
        let raw_residual = system.measured() - &raw * &coefficients;
        Some(Fit {
            raw_design: raw,
            raw_residual,
            design,
            coefficients,
            residual,
            ssr,
            dof,
            ..plain
        })
    };
    // Beyond the last of the others only a declared model says where a reading should be.
    let reach = if columns.is_empty() {
        f64::INFINITY
    } else {
        REACH
    };
    let found = curve(&declared.weights)
        .and_then(|start| reject(system, &curve, &start, &declared.weights, reach));
    let apart = found.and_then(|found| {
        Some(Hypothesis {
            fit: fit(system, &[], &found.weights, 15)?,
            ..found
        })
    });
    apart.unwrap_or(declared)
}

/// Fewest flagged readings of which it can be said that they are no single ones.
const MIN_STRUCTURE: usize = 4;
/// Share of the flagged readings that may have a flagged neighbour.
const MAX_NEIGHBOURS: f64 = 0.5;
/// Share of the readings at rest that may be flagged: nothing touches the wire there.
const MAX_REST: f64 = 0.25;

/// Fewest readings of a group, or of a setting, that, flagged all together, are what the model
/// lacks of it.
const MIN_GROUP: usize = 3;

/// Whether flagged readings stand singly: a whole stretch of them, a whole group, or many at rest,
/// is what the model lacks.
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
