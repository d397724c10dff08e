//! Rows of a holdout that were in the fit.
//!
//! ```text
//! P(at least m of n agree) = binomial tail with q = (r + 1) / (N + 2),   r of N fitted rows agree with another one
//! ```
//!
//! Readings without a clock agree by chance as often as the fitted ones agree with each other (I.
//! J. Good, Biometrika 40 (1953), 237-264). Under a clock every reading has its own time: one that
//! agrees is the same row. Where fitted rows of one time agree, the clock is too coarse to tell.

use crate::levels::NEGLIGIBLE;
use statrs::distribution::{Binomial, DiscreteCDF};
use std::collections::BTreeMap;

/// Why the holdout proves nothing, where its rows were fitted. Rows: time, where there is one,
/// setting and values.
pub(crate) fn sealed_in_fit<const K: usize>(
    fitted: impl Iterator<Item = (Option<f64>, [f64; K])>,
    sealed: impl Iterator<Item = (Option<f64>, [f64; K])>,
) -> Option<String> {
    let bits = |(t_s, row): (Option<f64>, [f64; K])| (t_s.map(f64::to_bits), row.map(f64::to_bits));
    let (mut known, mut timed) = (BTreeMap::new(), true);
    for row in fitted {
        timed &= row.0.is_some();
        *known.entry(bits(row)).or_insert(0) += 1;
    }
    let agree: Vec<bool> = sealed.map(|row| known.contains_key(&bits(row))).collect();
    let count = agree.iter().filter(|agrees| **agrees).count();
    let repeated: usize = known.values().filter(|times| **times > 1).sum();
    // Laplace's rule: a table without repeats may still have some by chance.
    let share = (repeated + 1) as f64 / (known.values().sum::<usize>() + 2) as f64;
    // P(at least m of n) is the tail beyond m - 1.
    let by_chance = Binomial::new(share, agree.len() as u64)
        .map_or(1.0, |b| b.sf((count as u64).saturating_sub(1)));
    let same = count > 0 && (timed && repeated == 0 || by_chance < NEGLIGIBLE);
    same.then(|| {
        format!(
            "{count} of {} rows of the holdout are also in the points table (the same file?); a holdout that was in the fit proves nothing",
            agree.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_of_the_same_time_is_the_same_row_unless_the_clock_is_coarse() {
        let rows = |step_s: f64, first: i32| {
            (first..first + 4).map(move |k| (Some(step_s * f64::from(k)), [f64::from(k % 4), 2.0]))
        };
        assert!(
            sealed_in_fit(rows(1.0, 0), rows(1.0, 2))
                .is_some_and(|why| why.starts_with("2 of 4 rows"))
        );
        // Another run, and one whose clock stands still while the gauge repeats itself.
        assert_eq!(sealed_in_fit(rows(1.0, 0), rows(1.0, 4)), None);
        assert_eq!(
            sealed_in_fit(rows(0.0, 0).chain(rows(0.0, 0)), rows(0.0, 0)),
            None
        );
    }

    #[test]
    fn rows_without_a_clock_are_the_same_where_chance_does_not_make_them_agree() {
        // Readings at ten settings with so many digits of scatter.
        let rows = |first: u32, count: u32, steps: f64| {
            (first..first + count).map(move |k| {
                let scatter = (f64::from(k) * 12.9898).sin() * 43758.5453;
                (
                    None,
                    [f64::from(k % 10), (scatter.rem_euclid(1.0) * steps).round()],
                )
            })
        };
        let found = |fitted: u32, first: u32, count: u32, steps: f64| {
            sealed_in_fit(rows(0, fitted, steps), rows(first, count, steps))
        };
        assert!(found(40, 0, 40, 1e9).unwrap().starts_with("40 of 40 rows"));
        assert!(
            found(40, 36, 10, 1e9).unwrap().starts_with("4 of 10 rows"),
            "the rest is new"
        );
        assert!(found(10, 0, 10, 1e9).is_some());
        // Negative controls: other rows, one of many that agrees, and a gauge so coarse that each
        // reading was there before.
        assert_eq!(found(40, 40, 40, 1e9), None);
        assert_eq!(found(40, 39, 40, 1e9), None);
        assert_eq!(found(40, 40, 20, 3.0), None);
    }
}
