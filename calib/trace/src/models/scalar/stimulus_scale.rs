//! What the unit of the stimulus and the read-out's range say: a full turn, absolute zero, and where a count starts again.

use super::row::ScalarRow;
use std::f64::consts::TAU;

/// A full turn in a unit of angle.
fn turn_in(unit: &str) -> Option<f64> {
    Some(match unit.trim().to_lowercase().as_str() {
        "deg" | "degree" | "degrees" | "\u{b0}" => 360.0,
        "rad" | "radian" | "radians" => TAU,
        "mrad" => 1e3 * TAU,
        "gon" | "grad" => 400.0,
        "turn" | "turns" | "rev" | "revolution" | "revolutions" => 1.0,
        "arcmin" => 21_600.0,
        _ => return None,
    })
}

/// A full turn, where readings in `levels` places over `span` go around once: the next place after the last is the first again.
pub(super) fn full_turn(unit: &str, span: f64, levels: usize) -> Option<f64> {
    turn_in(unit).filter(|turn| levels > 2 && span > turn * (1.0 - 1.5 / levels as f64))
}

/// Absolute zero on a linear scale of temperature.
pub(super) fn absolute_zero(unit: &str) -> Option<f64> {
    Some(match unit.trim().to_lowercase().as_str() {
        "degc" | "deg_c" | "deg c" | "celsius" | "\u{b0}c" | "c" => -273.15,
        "k" | "kelvin" => 0.0,
        "degf" | "deg_f" | "deg f" | "fahrenheit" | "\u{b0}f" | "f" => -459.67,
        _ => return None,
    })
}

/// Ranges of counts: powers of two (8 bits and more), of ten, and a turn.
fn moduli() -> impl Iterator<Item = f64> {
    (8..=32)
        .map(|k| f64::from(k).exp2())
        .chain((2..=6).map(|k| 10f64.powi(k)))
        .chain([360.0, TAU])
}

/// Steps up to this many times the typical one are steps of the same slope.
const SAME_SLOPE: f64 = 3.0;

/// Where a count starts again (between two places of the stimulus), rising: jumps by its whole range after which the responses go on as before.
/// Empty where none does.
pub(super) fn wraps(rows: &[ScalarRow]) -> Vec<f64> {
    let mut all: Vec<(f64, f64)> = rows.iter().map(|r| (r.x, r.y)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let (low, high) = all
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), r| {
            (a.min(r.1), b.max(r.1))
        });
    let steps: Vec<([f64; 2], f64)> = all
        .windows(2)
        .map(|p| ([p[0].0, p[1].0], p[1].1 - p[0].1))
        .collect();
    let of = |modulus: f64| {
        let unwrapped = |d: f64| d - modulus * (d / modulus).round();
        let taken: Vec<f64> = steps.iter().map(|(_, d)| unwrapped(*d)).collect();
        let largest = taken.iter().fold(0.0_f64, |a, d| a.max(d.abs()));
        let places: Vec<([f64; 2], f64)> = steps
            .iter()
            .copied()
            .filter(|(_, d)| d.abs() > 0.5 * modulus)
            .collect();
        let between: Vec<f64> = taken
            .iter()
            .zip(&steps)
            .filter(|(_, s)| s.0[0] < s.0[1])
            .map(|(d, _)| *d)
            .collect();
        let typical = between.iter().sum::<f64>().abs() / between.len().max(1) as f64;
        // All of one count's range is used, and what is left of every step is a step of the slope.
        let fits = !places.is_empty()
            && high - low < modulus
            && high - low + SAME_SLOPE * typical > modulus
            && largest < SAME_SLOPE * typical
            && places
                .iter()
                .all(|(x, d)| x[0] < x[1] && d.signum() == places[0].1.signum());
        fits.then(|| {
            places
                .iter()
                .map(|(x, _)| 0.5 * (x[0] + x[1]))
                .collect::<Vec<f64>>()
        })
    };
    moduli().find_map(of).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::row::bare;
    use super::*;

    /// Counts of `bits` bits over a turn in 40 places, from `zero` on.
    fn counts(bits: i32, zero: f64, noise: f64) -> Vec<ScalarRow> {
        let modulus = f64::from(bits).exp2();
        let count =
            |k: i32| (zero + modulus * f64::from(k) / 41.0 + noise * f64::from(k * 7 % 5)).round();
        (0..40)
            .map(|k| bare(0, 9.0 * f64::from(k), count(k).rem_euclid(modulus)))
            .collect()
    }

    #[test]
    fn a_count_that_starts_again_is_told_from_a_step() {
        assert_eq!(wraps(&counts(12, 3000.0, 0.5)), vec![94.5]);
        assert_eq!(wraps(&counts(14, 5000.0, 0.5)), vec![256.5]);
        // Controls: from zero on nothing wraps, and a step by another height is none.
        assert!(wraps(&counts(14, 0.0, 0.5)).is_empty());
        let mut stepped = counts(14, 0.0, 0.5);
        stepped.iter_mut().skip(20).for_each(|r| r.y -= 9000.0);
        assert!(wraps(&stepped).is_empty());
    }

    #[test]
    fn a_turn_is_full_where_the_next_place_is_the_first() {
        assert_eq!(full_turn("deg", 350.0, 36), Some(360.0));
        assert_eq!(full_turn("rad", 6.2, 64), Some(TAU));
        assert!(full_turn("deg", 300.0, 31).is_none() && full_turn("mm", 350.0, 36).is_none());
    }
}
