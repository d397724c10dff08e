//! Held-out errors with intervals by whole groups: what a further group (cycle, trajectory, fold)
//! is wrong by, root mean square.
//!
//! ```text
//! m = sum S_g / N,   v = G / (G - 1) sum ((S_g - n_g m) / N)^2        S_g: squares of group g, n_g: its values, N: all values, G: groups
//! nu = 2 m^2 / (v (G - 1) / chi2_(0.05, G - 1))                       from G to N
//! ```
//!
//! m nu / E m is about chi-squared with nu degrees of freedom (F. E. Satterthwaite, Biometrics
//! Bull. 2 (1946), 110-114). Values of a group share what they share: all of it leaves one degree
//! of freedom a group, nothing of it one a value. A few groups say little of v itself: its upper
//! end counts.

use super::session_model::{HeldOut, Quantity};
use crate::method::distributions::{chi_squared_quantile, sd_interval95};
use std::collections::BTreeMap;
use wcal_core::verify_document::HeldOutError;

/// Level of the end of the variance between groups that counts.
const UPPER: f64 = 0.05;

/// Root mean square of quantity `q` over rows; NaN without any.
pub fn rmse<'a>(rows: impl IntoIterator<Item = &'a HeldOut>, q: usize) -> f64 {
    root_mean_square(rows.into_iter().flat_map(|r| &r.errors[q]))
}

fn root_mean_square<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    if count > 0.0 {
        f64::sqrt(sum / count)
    } else {
        f64::NAN
    }
}

/// Rows of each group; where there is one group only, each row is one, so that an interval has a
/// width.
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

/// 95 % interval of the root mean square of further groups like these, from each one's squares and
/// number of values.
pub fn interval95(groups: &[(f64, f64)]) -> Option<[f64; 2]> {
    let count = groups.len() as f64;
    let (squares, values) = groups
        .iter()
        .fold((0.0, 0.0), |(s, n), g| (s + g.0, n + g.1));
    let mean = squares / values;
    let scatter: f64 = groups
        .iter()
        .map(|(s, n)| ((s - n * mean) / values).powi(2))
        .sum();
    // v (G - 1) / chi2 of the module's head.
    let upper = chi_squared_quantile(UPPER, count - 1.0).map(|chi2| count * scatter / chi2);
    // m nu / E m has the variance 2 nu of a chi-squared: nu = 2 m^2 / v.
    let nu = upper.map_or(count, |v| (2.0 * mean * mean / v).max(count).min(values));
    sd_interval95(mean.sqrt(), nu)
}

/// Errors of `rows`, each with a 95 % interval over groups.
pub fn summarise(rows: &[HeldOut], quantities: &[Quantity], split: &str) -> Option<HeldOutError> {
    if rows.is_empty() {
        return None;
    }
    let groups = groups(rows);
    let interval = |q: usize| {
        let squares = |group: &Vec<&HeldOut>| {
            let values = group.iter().flat_map(|r| &r.errors[q]);
            values.fold((0.0, 0.0), |(sum, count), e| (sum + e * e, count + 1.0))
        };
        let shown = groups.iter().map(squares).filter(|(_, count)| *count > 0.0);
        interval95(&shown.collect::<Vec<_>>())
    };
    let named = |q: &Quantity| q.key.to_owned();
    let shown = |of: &dyn Fn(usize) -> f64| -> BTreeMap<String, f64> {
        quantities
            .iter()
            .enumerate()
            .map(|(q, k)| (named(k), of(q)))
            .filter(|(_, e)| e.is_finite())
            .collect()
    };
    let moments = quantities.iter().position(|q| q.key == "moment_rmse_nmm");
    let of_component = |q: usize, c: usize| {
        let one = |r: &HeldOut| HeldOut {
            errors: vec![vec![r.errors[q][c]]],
            ..r.clone()
        };
        rmse(&rows.iter().map(one).collect::<Vec<_>>(), 0)
    };
    Some(HeldOutError {
        split: split.to_owned(),
        // What no row shows (a contact without pictures) has no error.
        rmse: shown(&|q| rmse(rows, q)),
        expected: shown(&|q| root_mean_square(rows.iter().flat_map(|r| &r.stated_sd[q]))),
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
    let hits = rows
        .iter()
        .flat_map(|r| &r.inside95)
        .filter(|inside| **inside)
        .count();
    (count > 0).then(|| hits as f64 / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Of a hundred: how often the interval from `groups` groups of `values` values holds the error
    /// of further ones, 1, where the values of a group share `shared` of their variance.
    fn held(groups: usize, values: usize, shared: f64) -> f64 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64((100 * groups + values) as u64);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut held = 0_u32;
        for _ in 0..2000 {
            let mut group = || {
                let common = shared.sqrt() * normal();
                let each = (0..values).map(|_| (common + (1.0 - shared).sqrt() * normal()).powi(2));
                (each.sum::<f64>(), values as f64)
            };
            let all: Vec<(f64, f64)> = (0..groups).map(|_| group()).collect();
            let [low, high] = interval95(&all).unwrap();
            held += u32::from((low..high).contains(&1.0));
        }
        held as f64 / 20.0
    }

    #[test]
    fn the_interval_holds_the_error_of_further_groups() {
        // Binomial standard deviation 0.5; values that share nothing are held more often where
        // groups are few.
        for groups in [3, 4, 6, 10, 40] {
            for (values, shared) in [(1, 0.0), (11, 0.0), (11, 0.5), (11, 1.0)] {
                let held = held(groups, values, shared);
                assert!(
                    (93.0..=100.0).contains(&held),
                    "{groups} x {values}, {shared}: {held}"
                );
            }
        }
        // It is no wider than it must be: readings by themselves, and many groups.
        assert!(held(17, 1, 0.0) < 96.5 && held(40, 11, 0.0) < 99.0);
    }

    /// Control: groups drawn again with replacement, central 95 % of their errors, hold it in 70 of
    /// 100.
    #[test]
    fn groups_drawn_again_are_too_few() {
        use rand::RngExt;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut held = 0;
        for seed in 0..400 {
            let squares = |_| {
                (0..11)
                    .map(|_| -> f64 { StandardNormal.sample(&mut rng) })
                    .map(|e| e * e)
                    .sum::<f64>()
            };
            let all: Vec<f64> = (0..4).map(squares).collect();
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let mut redrawn = |_| all[rng.random_range(0..4)];
            let mut draws: Vec<f64> = (0..400)
                .map(|_| (0..4).map(&mut redrawn).sum::<f64>() / 44.0)
                .collect();
            draws.sort_by(f64::total_cmp);
            held += usize::from((draws[10]..draws[389]).contains(&1.0));
        }
        assert!(held < 340, "{held}");
    }
}
