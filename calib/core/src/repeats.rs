//! The step in which an instrument shows its readings.

/// Digits below the largest value that are looked at.
const DIGITS: i32 = 8;

/// Coarsest decimal step of which all values are multiples; none where it is fine beside their
/// size, as noise then hides it.
pub fn decimal_step(values: &[f64]) -> Option<f64> {
    let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if !(largest > 0.0) {
        return None;
    }
    let on = |step: f64| {
        values
            .iter()
            .all(|v| ((v / step) - (v / step).round()).abs() < 1e-6)
    };
    #[allow(clippy::cast_possible_truncation)]
    let top = largest.log10().floor() as i32;
    // From coarse to fine: the first that fits is the coarsest.
    let decimal = (0..DIGITS).map(|k| 10f64.powi(top - k)).find(|s| on(*s))?;
    // A scale may count in fives or twos: as many different values are multiples of such a step by
    // chance once in 2^8.
    let mut different = values.to_vec();
    different.sort_by(f64::total_cmp);
    different.dedup();
    let coarser = [5.0, 2.0]
        .map(|n| n * decimal)
        .into_iter()
        .find(|s| different.len() >= 8 && on(*s));
    Some(coarser.unwrap_or(decimal))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_is_the_coarsest_that_all_values_share() {
        assert_eq!(decimal_step(&[0.25, 1.5, 2.0]), Some(0.01));
        assert_eq!(decimal_step(&[500.0, 1000.0]), Some(100.0));
        assert_eq!(decimal_step(&[1.0 / 3.0, 2.0]), None);
        assert_eq!(decimal_step(&[]), None);
        let halves: Vec<f64> = (0..9).map(|k| 0.5 * f64::from(k * k)).collect();
        assert_eq!(decimal_step(&halves), Some(0.5));
        assert_eq!(decimal_step(&halves[..5]), Some(0.1));
    }
}
