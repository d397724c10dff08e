//! Settings of an input: values that lie close together beside the distance of the next one are one
//! setting that was read more than once.
//!
//! ```text
//! y = f(xi) + e,   x = xi + d                            errors in variables (GUM H.3.5, ISO/TS 28037)
//! lambda = var(xi) / (var(xi) + var(d))                  reliability of x within a setting (Fuller, "Measurement Error Models" (1987), 1.1)
//! E[y | x] within a setting = mean + lambda f' (x - mean),      E[xi | x] = mean + lambda (x - mean)       (regression calibration)
//! ```
//!
//! The slope within settings over the slope between them is lambda: 1 where the stimulus went where
//! its reading says, 0 where only the reading scatters.

/// Widest setting beside the smallest distance between two of them.
const NEAR: f64 = 0.1;

/// Number of the setting of each value, ascending. Values are joined where most settings were read
/// at more than one value and all of them are narrow; else equal values alone are one setting.
pub fn settings(values: &[f64]) -> Vec<usize> {
    let mut distinct = values.to_vec();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    let mut gaps: Vec<f64> = distinct.windows(2).map(|p| p[1] - p[0]).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.dedup();
    // Least joined first: the jump from the distances within to those between is the first that
    // leaves narrow settings.
    let joined = gaps
        .windows(2)
        .filter(|g| g[0] <= NEAR * g[1])
        .map(|g| g[0])
        .find(|within| is_clear(&distinct, *within));
    let starts = starts(&distinct, joined.unwrap_or(0.0));
    values
        .iter()
        .map(|v| starts.partition_point(|s| s <= v).max(1) - 1)
        .collect()
}

/// First values of the runs of `distinct` whose neighbours are no further apart than `within`.
fn starts(distinct: &[f64], within: f64) -> Vec<f64> {
    distinct
        .chunk_by(|a, b| b - a <= within)
        .map(|run| run[0])
        .collect()
}

/// Most runs hold more than one value, and all are narrow beside the smallest distance between two.
fn is_clear(distinct: &[f64], within: f64) -> bool {
    let runs: Vec<&[f64]> = distinct.chunk_by(|a, b| b - a <= within).collect();
    let widest = runs
        .iter()
        .map(|r| r[r.len() - 1] - r[0])
        .fold(0.0, f64::max);
    let between = runs
        .windows(2)
        .map(|r| r[1][0] - r[0][r[0].len() - 1])
        .fold(f64::INFINITY, f64::min);
    runs.len() > 1
        && widest <= NEAR * between
        && 2 * runs.iter().filter(|r| r.len() > 1).count() >= runs.len()
}

/// Means of `values` by setting.
pub fn means(of: &[usize], values: &[f64]) -> Vec<f64> {
    let count = of.iter().max().map_or(0, |m| m + 1);
    let mut sums = vec![(0.0, 0.0); count];
    for (&k, v) in of.iter().zip(values) {
        sums[k].0 += v;
        sums[k].1 += 1.0;
    }
    sums.into_iter()
        .map(|(sum, n)| sum / f64::max(n, 1.0))
        .collect()
}

/// Reliability of `x` within its settings, from 0 to 1; 1 where no setting was read at more than
/// one value.
pub(crate) fn reliability(of: &[usize], x: &[f64], y: &[f64]) -> f64 {
    let [mx, my] = [x, y].map(|v| means(of, v));
    // Slope between the neighbours of a setting: the law need not be straight.
    let slope = |k: usize| {
        let [a, b] = [k.saturating_sub(1), (k + 1).min(mx.len() - 1)];
        if b > a {
            (my[b] - my[a]) / (mx[b] - mx[a])
        } else {
            0.0
        }
    };
    let (mut product, mut square) = (0.0, 0.0);
    for (i, &k) in of.iter().enumerate() {
        // lambda by least squares of y - my on f' (x - mx), over all settings.
        let along = slope(k) * (x[i] - mx[k]);
        product += along * (y[i] - my[k]);
        square += along * along;
    }
    if square > 0.0 {
        (product / square).clamp(0.0, 1.0)
    } else {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Levels every 500, read by a reference that scatters by `scatter`, `runs` times.
    fn read(scatter: f64, runs: usize) -> Vec<f64> {
        (0..11 * runs)
            .map(|k| 500.0 * (k % 11) as f64 + scatter * ((k * 7919) % 101) as f64 / 50.0)
            .collect()
    }

    #[test]
    fn values_close_beside_the_distance_of_the_next_are_one_setting() {
        for scatter in [0.0, 0.45, 20.0] {
            let of = settings(&read(scatter, 4));
            assert!(
                of.iter().enumerate().all(|(k, s)| *s == k % 11),
                "{scatter}"
            );
        }
        // Controls: a scatter as wide as the distance, a ramp, decades, a small first load.
        let alone = |v: &[f64]| settings(v).iter().max().copied();
        assert!(alone(&read(300.0, 4)) > Some(20));
        assert_eq!(alone(&(0..60).map(f64::from).collect::<Vec<_>>()), Some(59));
        assert_eq!(alone(&[0.01, 0.1, 1.0, 10.0, 100.0]), Some(4));
        assert_eq!(alone(&[0.0, 0.5, 20.0, 40.0, 60.0]), Some(4));
    }

    #[test]
    fn the_slope_within_settings_says_whether_the_stimulus_or_its_reading_scatters() {
        let x = read(0.45, 4);
        let of = settings(&x);
        let moved: Vec<f64> = x.iter().map(|x| 0.004 * x).collect();
        let only_read: Vec<f64> = of.iter().map(|k| 2.0 * *k as f64).collect();
        assert!((reliability(&of, &x, &moved) - 1.0).abs() < 1e-9);
        assert!(reliability(&of, &x, &only_read) < 1e-9);
        assert_eq!(
            reliability(&settings(&read(0.0, 4)), &read(0.0, 4), &only_read),
            1.0
        );
    }
}
