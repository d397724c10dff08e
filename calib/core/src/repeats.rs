//! How often two honest readings of one setting agree to the last digit.
//!
//! ```text
//! P(same digits) = 1 / sqrt(1 + 4 pi s^2)          s: noise in units of the last digit
//! ```
//!
//! The chance that two normal values, rounded to whole numbers with a random offset, fall on the same one, to within 2 %. Where the noise hides
//! below the last digit every repeat agrees, and agreement says nothing.

/// Digits below the largest value that are looked at.
const DIGITS: i32 = 8;
/// Degree of the smoothest course that a response may have besides its noise.
const MAX_DEGREE: usize = 5;
/// Roughness below this many last digits is rounding (0.29) and a little more: it says nothing of the noise.
const MIN_ROUGHNESS: f64 = 1.0;

/// Coarsest decimal step of which all values are multiples; none where it is fine beside their size, as noise then hides it.
#[must_use]
pub fn decimal_step(values: &[f64]) -> Option<f64> {
    let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if !(largest > 0.0) {
        return None;
    }
    let on = |step: f64| values.iter().all(|v| ((v / step) - (v / step).round()).abs() < 1e-6);
    #[allow(clippy::cast_possible_truncation)]
    let top = largest.log10().floor() as i32;
    (0..DIGITS).map(|k| 10f64.powi(top - k)).find(|s| on(*s))
}

/// Chance that two readings of one setting show the same digits, from the roughness of `readings` over `settings`: what the smoothest of
/// several polynomials leaves. An upper bound: a course of the response that is itself rough makes the chance too small only where it is
/// rougher than the noise by far. 1 where rounding explains the roughness, or where there are too few settings.
#[must_use]
pub fn agreement_by_chance(settings: &[f64], readings: &[f64]) -> f64 {
    let (x, y) = means(settings, readings);
    let largest = y.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    // Digits that a double holds beyond those of any instrument stand for a step where the values have none.
    let step = decimal_step(readings).map_or(largest * 2f64.powi(-40), |step| grid_step(readings, step));
    let roughness =
        (1..=MAX_DEGREE).filter_map(|d| left_by_polynomial(&x, &y, d)).fold(f64::INFINITY, f64::min);
    let digits = roughness / step;
    if !digits.is_finite() || digits < MIN_ROUGHNESS {
        return 1.0;
    }
    1.0 / (1.0 + 4.0 * std::f64::consts::PI * digits * digits).sqrt()
}

/// Step of a converter or scale whose readings are printed with a finer last digit `step`: the widest grid on which all readings lie to within
/// their rounding, where chance would hardly put them there; else `step`.
fn grid_step(readings: &[f64], step: f64) -> f64 {
    /// Expected number of such grids among values without one.
    const CHANCE: f64 = 0.01;
    /// Finer grids are as good as none.
    const MIN_GRID: f64 = 4.0;
    /// More steps than this are no coarse grid.
    const MAX_STEPS: u32 = 100_000;
    let low = readings.iter().copied().fold(f64::INFINITY, f64::min);
    let mut counts: Vec<f64> = readings.iter().map(|v| ((v - low) / step).round()).collect();
    counts.sort_by(f64::total_cmp);
    counts.dedup();
    let (Some(&range), Ok(distinct)) = (counts.last(), i32::try_from(counts.len())) else { return step };
    let on = |grid: f64| counts.iter().all(|c| (c / grid - (c / grid).round()).abs() * grid <= 1.0);
    for steps in 1..=MAX_STEPS {
        let grid = range / f64::from(steps);
        if grid < MIN_GRID {
            break;
        }
        // Both ends lie on every grid of this kind; three places in each of its steps count as on it.
        if f64::from(steps) * (3.0 / grid).powi(distinct - 2) < CHANCE && on(grid) {
            return grid * step;
        }
    }
    step
}

/// Settings in rising order and the mean reading of each.
fn means(settings: &[f64], readings: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let mut rows: Vec<(f64, f64)> = settings.iter().copied().zip(readings.iter().copied()).collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    #[allow(clippy::cast_precision_loss)]
    let mean = |group: &[(f64, f64)]| group.iter().map(|r| r.1).sum::<f64>() / group.len() as f64;
    rows.chunk_by(|a, b| a.0 == b.0).map(|group| (group[0].0, mean(group))).unzip()
}

/// Standard deviation that a polynomial leaves; none where fewer than two degrees of freedom are left.
fn left_by_polynomial(x: &[f64], y: &[f64], degree: usize) -> Option<f64> {
    let n = x.len();
    if n < degree + 3 {
        return None;
    }
    let (low, high) = (x[0], x[n - 1]);
    let u = |v: f64| (2.0 * v - low - high) / (high - low);
    let design =
        nalgebra::DMatrix::from_fn(n, degree + 1, |i, k| u(x[i]).powi(i32::try_from(k).unwrap_or(i32::MAX)));
    let y = nalgebra::DVector::from_row_slice(y);
    let b = design.clone().svd(true, true).solve(&y, 1e-12).ok()?;
    #[allow(clippy::cast_precision_loss)]
    let dof = (n - degree - 1) as f64;
    Some(((y - design * b).norm_squared() / dof).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between -1.7 and 1.7 with a standard deviation of 1.
    fn scatter(k: f64) -> f64 {
        3.46 * (((k + 1.0) * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 1.73
    }

    /// A line over eleven settings with a repeatable scatter of `counts` last digits.
    fn agreement(counts: f64) -> f64 {
        let x: Vec<f64> = (0..11).map(f64::from).collect();
        let y: Vec<f64> = x.iter().map(|v| (100.0 * v + counts * scatter(*v)).round() / 100.0).collect();
        agreement_by_chance(&x, &y)
    }

    #[test]
    fn a_coarse_gauge_agrees_with_itself_and_a_fine_one_does_not() {
        assert_eq!(agreement(0.0), 1.0);
        let chance = agreement(4.0);
        // 1 / sqrt(1 + 4 pi 16) = 0.07; the roughness of eleven values is known to a factor of two.
        assert!((0.035..0.14).contains(&chance), "{chance}");
        // A converter of 12 bits over 10 V, printed with five decimals, and a scale that shows every fifth digit.
        let x: Vec<f64> = (0..20).map(f64::from).collect();
        for grid in [10.0 / 4096.0, 0.005] {
            let coarse: Vec<f64> =
                x.iter().map(|v| ((0.4337 * v / grid).round() * grid * 1e5).round() / 1e5).collect();
            assert_eq!(agreement_by_chance(&x, &coarse), 1.0, "{grid}");
        }
        // Full doubles of an exact line agree, too; those of a rough course do not.
        let x: Vec<f64> = (0..11).map(f64::from).collect();
        let exact: Vec<f64> = x.iter().map(|v| 0.1 + v / 3.0).collect();
        assert_eq!(agreement_by_chance(&x, &exact), 1.0);
        let rough: Vec<f64> = x.iter().map(|v| v / 3.0 + 0.01 * scatter(*v)).collect();
        assert!(agreement_by_chance(&x, &rough) < 1e-6);
    }

    #[test]
    fn the_step_is_the_coarsest_that_all_values_share() {
        assert_eq!(decimal_step(&[0.25, 1.5, 2.0]), Some(0.01));
        assert_eq!(decimal_step(&[500.0, 1000.0]), Some(100.0));
        assert_eq!(decimal_step(&[1.0 / 3.0, 2.0]), None);
        assert_eq!(decimal_step(&[]), None);
    }
}
