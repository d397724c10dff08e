//! The median as estimates from pictures take it.

use std::borrow::Borrow;
use wcal_core::order_statistics::{MAD_TO_SD, quantile};

/// Median of the finite values; NaN where there is none.
pub(crate) fn median(values: impl IntoIterator<Item = impl Borrow<f64>>) -> f64 {
    let values = values.into_iter().map(|v| *v.borrow());
    quantile(values.filter(|v| v.is_finite()), 0.5).unwrap_or(f64::NAN)
}

/// The same, and the standard deviation of a value by the median absolute deviation from it.
pub(crate) fn median_and_sd(values: &[f64]) -> [f64; 2] {
    let middle = median(values);
    [
        middle,
        MAD_TO_SD * median(values.iter().map(|v| (v - middle).abs())),
    ]
}
