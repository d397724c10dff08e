//! Rows of a holdout that were in the fit.

use std::collections::BTreeSet;

/// Why the holdout proves nothing, where its rows were fitted. Under a clock every reading has a time of its own, so that a sealed row with time,
/// setting and values of a fitted one is that row; where fitted rows are alike among themselves, the clock is too coarse to tell. Rows: time first, none
/// without one.
pub fn sealed_in_fit(
    fitted: impl Iterator<Item = Option<Vec<f64>>>,
    sealed: impl Iterator<Item = Option<Vec<f64>>>,
) -> Option<String> {
    let bits = |row: Vec<f64>| row.into_iter().map(f64::to_bits).collect::<Vec<u64>>();
    let mut known = BTreeSet::new();
    if !fitted.flatten().all(|row| known.insert(bits(row))) {
        return None;
    }
    let count = sealed.flatten().filter(|row| known.contains(&bits(row.clone()))).count();
    (count > 0).then(|| {
        format!("{count} rows of the holdout are also in the points table; a holdout that was in the fit proves nothing")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_of_the_same_time_is_the_same_row_unless_the_clock_is_coarse() {
        let rows = |step_s: f64, first: i32| {
            (first..first + 4).map(move |k| Some(vec![step_s * f64::from(k), f64::from(k % 4), 2.0]))
        };
        assert!(sealed_in_fit(rows(1.0, 0), rows(1.0, 2)).is_some_and(|why| why.starts_with("2 rows")));
        // Another run, a table without a clock, and one whose clock stands still while the gauge repeats itself.
        assert_eq!(sealed_in_fit(rows(1.0, 0), rows(1.0, 4)), None);
        assert_eq!(sealed_in_fit(rows(1.0, 0), rows(1.0, 0).map(|_| None)), None);
        assert_eq!(sealed_in_fit(rows(0.0, 0).chain(rows(0.0, 0)), rows(0.0, 0)), None);
    }
}
