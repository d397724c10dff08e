//! What the unit of the stimulus and the read-out's range say: a full turn, absolute zero, and
//! where a count starts again.

use super::row::ScalarRow;
use crate::models::range;
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

/// A full turn, where readings in `levels` places over `span` go around once: the next place after
/// the last is the first again.
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

/// Where a count starts again, rising: jumps by its whole range after which the responses go on as
/// before, between two places of the stimulus, or at one whose readings lie on both sides. Empty
/// where none does.
pub(super) fn wraps(rows: &[ScalarRow]) -> Vec<f64> {
    let mut all: Vec<(f64, f64)> = rows.iter().map(|r| (r.x, r.y)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [low, high] = range(rows.iter().map(|r| r.y));
    let levels: Vec<&[(f64, f64)]> = all.chunk_by(|a, b| a.0 == b.0).collect();
    let of = |modulus: f64| {
        // Each reading as near as whole ranges bring it to the mean of the place before.
        let mut before = levels.first()?[0].1;
        let (mut means, mut passed) = (Vec::new(), Vec::new());
        for level in &levels {
            let count = |y: f64| ((before - y) / modulus).round();
            passed.push(range(level.iter().map(|(_, y)| count(*y))));
            let whole = level.iter().map(|(_, y)| y + modulus * count(*y));
            before = whole.sum::<f64>() / level.len() as f64;
            means.push(before);
        }
        let steps: Vec<f64> = means.windows(2).map(|m| m[1] - m[0]).collect();
        // With whole ranges taken off, a count has one slope throughout.
        let typical = steps.iter().sum::<f64>().abs() / steps.len().max(1) as f64;
        // All of one count's range is used, and what remains of every step is a step of the slope.
        let fits = high - low < modulus
            && high - low + SAME_SLOPE * typical > modulus
            && steps.iter().all(|d| d.abs() < SAME_SLOPE * typical);
        let mixed = |p: &[f64; 2]| p[0] < p[1];
        let within = levels.iter().zip(&passed).filter(|(_, p)| mixed(p));
        let within = within.map(|(level, _)| level[0].0);
        let between = passed.windows(2).zip(levels.windows(2));
        let between = between.filter(|(p, _)| p[0] != p[1] && !p.iter().any(mixed));
        let between = between.map(|(_, level)| 0.5 * (level[0][0].0 + level[1][0].0));
        let mut places: Vec<f64> = between.chain(within).collect();
        places.sort_by(f64::total_cmp);
        (fits && !places.is_empty()).then_some(places)
    };
    moduli().find_map(of).unwrap_or_default()
}

/// How often the count of each reading has started again. At a place whose readings lie on both
/// sides each is recognised by its neighbours.
pub(super) fn times_wrapped(rows: &[ScalarRow], wraps: &[f64]) -> Vec<f64> {
    let [low, high] = range(rows.iter().map(|r| r.y));
    let of = |r: &ScalarRow| {
        let before = wraps.iter().filter(|place| r.x > **place).count() as f64;
        // The nearest reading on one side is in the same round.
        let same = |after: bool| {
            let off = |o: &ScalarRow| (o.x - r.x).abs();
            let beyond = rows.iter().filter(|o| o.x != r.x && (o.x > r.x) == after);
            let nearest = beyond.min_by(|a, b| off(a).total_cmp(&off(b)))?;
            // Readings of one round differ by less than half of the range, those of two by more.
            Some((2.0 * (r.y - nearest.y).abs() < high - low) == after)
        };
        let after = || same(true).or_else(|| same(false)).unwrap_or(false);
        before + f64::from(u8::from(wraps.contains(&r.x) && after()))
    };
    rows.iter().map(of).collect()
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
        // At the first place noise alone takes readings below zero.
        let mut turn: Vec<ScalarRow> = (0..72)
            .map(|k| bare(0, f64::from(k % 24) * 15.0, 0.0))
            .collect();
        turn.iter_mut()
            .enumerate()
            .for_each(|(k, r)| r.y = (r.x + [0.3, -0.2, 0.1][k / 24]).rem_euclid(360.0));
        assert_eq!(wraps(&turn), vec![0.0]);
        let times = times_wrapped(&turn, &[0.0]);
        assert!(
            (0..72).all(|k| times[k] == if k == 24 { 0.0 } else { 1.0 }),
            "{times:?}"
        );
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
