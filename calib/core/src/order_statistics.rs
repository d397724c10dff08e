//! Statistics by rank: of values in order x_1 <= ... <= x_n.
//!
//! Median: the middle one, the upper of the two of an even n. Quantile q: x at (n - 1) q + 1,
//! linear in between (R. Hyndman & Y. Fan, Amer. Statist. 50, 1996, type 7). The median absolute
//! deviation of a normal distribution is its standard deviation over 1.4826 (F. Hampel, J. Amer.
//! Statist. Assoc. 69, 1974).

/// Standard deviation of a normal distribution over its median absolute deviation: 1 / Phi^-1(3/4).
pub const MAD_TO_SD: f64 = 1.4826;

/// The middle value, the upper of the two middle ones of an even count; none without values.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Standard deviation by the median absolute deviation from `centre`; none without values.
pub fn mad_sd(values: impl IntoIterator<Item = f64>, centre: f64) -> Option<f64> {
    Some(MAD_TO_SD * median(values.into_iter().map(|v| (v - centre).abs()))?)
}

/// The smallest and the largest value; the ends of nothing, infinite, without values.
pub fn extent(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    let ends = [f64::INFINITY, f64::NEG_INFINITY];
    values
        .into_iter()
        .fold(ends, |[low, high], v| [low.min(v), high.max(v)])
}

/// The value below which the share `q` lies, linear between neighbours; none without values.
pub fn quantile(values: impl IntoIterator<Item = f64>, q: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = last as f64 * q;
    let (k, f) = ((at as usize).min(last), at.fract());
    Some(if f == 0.0 {
        sorted[k]
    } else {
        sorted[k] * (1.0 - f) + sorted[k + 1] * f
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_by_rank_whatever_the_order() {
        assert_eq!(median([3.0, -1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(quantile([4.0, 1.0, 3.0, 2.0], 0.5), Some(2.5));
        assert_eq!(
            [0.0, 0.25, 1.0].map(|q| quantile([5.0, 1.0, 3.0], q)),
            [Some(1.0), Some(2.0), Some(5.0)]
        );
        assert_eq!(
            (median([]), mad_sd([], 0.0), quantile([], 0.5)),
            (None, None, None)
        );
    }

    /// One value far out moves no median deviation; the root mean square of the same values is far
    /// off.
    #[test]
    fn the_deviation_of_a_normal_sample_is_its_standard_deviation() {
        use statrs::distribution::{ContinuousCDF, Normal};
        let normal = Normal::standard();
        let mut sample: Vec<f64> = (1..1000)
            .map(|k| 5.0 + 2.0 * normal.inverse_cdf(f64::from(k) / 1000.0))
            .collect();
        sample[3] = 1e6;
        let sd = mad_sd(
            sample.iter().copied(),
            median(sample.iter().copied()).unwrap(),
        )
        .unwrap();
        assert!((sd - 2.0).abs() < 0.02, "{sd}");
        let rms = (sample.iter().map(|v| (v - 5.0).powi(2)).sum::<f64>() / 999.0).sqrt();
        assert!(rms > 100.0, "negative control: {rms}");
    }
}
