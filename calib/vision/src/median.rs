//! The median as estimates from pictures take it.

use wcal_core::order_statistics::quantile;

/// Median of the finite values; NaN where there is none.
pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(values.iter().copied().filter(|v| v.is_finite()), 0.5).unwrap_or(f64::NAN)
}
