//! Held-out errors with bootstrap intervals over whole groups.

use super::session_model::{HeldOut, Quantity};
use std::collections::BTreeMap;
use wcal_core::bootstrap::{percentile_interval95, redrawn, replicates};
use wcal_core::verify_document::HeldOutError;

/// Bootstrap draws over whole groups.
const DRAWS: usize = 1000;

/// Root mean square of quantity `q` over rows; NaN without any.
pub fn rmse<'a>(rows: impl IntoIterator<Item = &'a HeldOut>, q: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in rows.into_iter().flat_map(|r| &r.errors[q]) {
        sum += value * value;
        count += 1.0;
    }
    if count > 0.0 { f64::sqrt(sum / count) } else { f64::NAN }
}

/// Rows of each group; where there is one group only, each row is one, so that an interval has a width.
fn groups(rows: &[HeldOut]) -> Vec<Vec<&HeldOut>> {
    let mut by_group: BTreeMap<u32, Vec<&HeldOut>> = BTreeMap::new();
    for r in rows {
        by_group.entry(r.group).or_default().push(r);
    }
    if by_group.len() < 2 {
        return rows.iter().map(|r| vec![r]).collect();
    }
    by_group.into_values().collect()
}

/// Errors of `rows` with 95 % percentile intervals over resampled groups.
pub fn summarise(rows: &[HeldOut], quantities: &[Quantity], split: &str, seed: u64) -> Option<HeldOutError> {
    if rows.is_empty() {
        return None;
    }
    let groups = groups(rows);
    let draws: Vec<Vec<f64>> = replicates(DRAWS, seed, |rng| {
        let sample: Vec<&HeldOut> = redrawn(groups.len(), rng).flat_map(|k| groups[k].clone()).collect();
        (0..quantities.len()).map(|q| rmse(sample.iter().copied(), q)).collect()
    });
    let interval = |q: usize| percentile_interval95(draws.iter().map(|d| d[q]).collect());
    let named = |q: &Quantity| q.key.to_owned();
    let moments = quantities.iter().position(|q| q.key == "moment_rmse_nmm");
    let of_component = |q: usize, c: usize| {
        let one = |r: &HeldOut| HeldOut { errors: vec![vec![r.errors[q][c]]], ..r.clone() };
        rmse(&rows.iter().map(one).collect::<Vec<_>>(), 0)
    };
    Some(HeldOutError {
        split: split.to_owned(),
        // What no row shows (a contact without pictures) has no error.
        rmse: quantities
            .iter()
            .enumerate()
            .map(|(q, k)| (named(k), rmse(rows, q)))
            .filter(|(_, e)| e.is_finite())
            .collect(),
        moment_rmse_nmm_each: moments.map(|q| [0, 1].map(|c| of_component(q, c))),
        interval95: (quantities.iter().enumerate())
            .filter_map(|(q, k)| Some((named(k), interval(q)?)))
            .filter(|(_, i)| i.iter().all(|v| v.is_finite()))
            .collect(),
        points: rows.len(),
    })
}

/// Share of values inside their stated 95 % intervals.
pub fn coverage95(rows: &[HeldOut]) -> Option<f64> {
    let count: usize = rows.iter().map(|r| r.inside95.len()).sum();
    let hits = rows.iter().flat_map(|r| &r.inside95).filter(|inside| **inside).count();
    (count > 0).then(|| hits as f64 / count as f64)
}
