//! Which readings can be used at all.

use super::frame::{Declared, ScalarRow, Scaling};
use crate::models::range;
use crate::verify::sealed_in_fit::sealed_in_fit;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;
use wcal_core::Sealed;

/// Fewer readings than this, or than two beyond the coefficients, are refused: a line through three
/// points has one degree of freedom.
const MIN_ROWS: usize = 4;
/// The search takes at most this many readings of a session; all are predicted.
const MAX_ROWS: usize = 1000;

/// Why the readings of the points table cannot be used; `sealed` are those of the holdout.
pub(super) fn refusal(
    points: &[ScalarRow],
    sealed: &Sealed<ScalarRow>,
    scaling: &Scaling,
    declared: Declared,
) -> Option<String> {
    let parameters = match declared {
        Declared::Polynomial(degree) => degree + 1,
        Declared::Axis => 1,
    };
    let least = MIN_ROWS.max(parameters + 2);
    let readings = points.len();
    if readings < least {
        return Some(format!("{readings} readings; at least {least} are needed"));
    }
    let rows = &thin(points.to_vec())[..];
    if let Some(why) = not_finite(rows, &()).or_else(|| sealed.refusal(&(), not_finite)) {
        return Some(why);
    }
    let count = levels(rows).len();
    if count < parameters || (parameters > 1 && !(scaling.half > 0.0)) {
        return Some(declared.format_text(&format!(
            "{count} different stimuli do not determine {parameters} coefficients"
        )));
    }
    clock_fault(points.iter().map(|r| r.t_s))
        .or_else(|| {
            sealed.refusal(points, |sealed, points| {
                let read = |r: &ScalarRow| (r.t_s, [r.x, r.y]);
                sealed_in_fit(points.iter().map(read), sealed.iter().map(read))
            })
        })
        .or_else(|| constant_response(rows, declared))
        .or_else(|| transposed_digits(rows, declared).map(|why| declared.format_text(&why)))
}

/// Different stimuli, rising.
fn levels(rows: &[ScalarRow]) -> Vec<f64> {
    let mut x: Vec<f64> = rows.iter().map(|r| r.x).collect();
    x.sort_by(f64::total_cmp);
    x.dedup();
    x
}

/// The first reading that is no number.
fn not_finite(rows: &[ScalarRow], (): &()) -> Option<String> {
    let bad = rows.iter().find(|r| !r.x.is_finite() || !r.y.is_finite())?;
    let (file, _, point) = &bad.origin;
    Some(format!("reading {point} of {file} is not a finite number"))
}

/// One value throughout, where the declared model follows the stimulus.
fn constant_response(rows: &[ScalarRow], declared: Declared) -> Option<String> {
    let first = rows.first()?.y;
    let stuck = matches!(declared, Declared::Polynomial(degree) if degree > 0)
        && rows.iter().all(|r| r.y == first);
    stuck.then(|| {
        format!("the response is {first} in every reading: no sensitivity to the stimulus")
    })
}

/// Where the clock of a table in file order runs backwards, in words.
pub(crate) fn clock_fault(times: impl Iterator<Item = Option<f64>>) -> Option<String> {
    let times: Vec<f64> = times.flatten().collect();
    let k = times.windows(2).position(|w| w[1] < w[0])?;
    Some(format!(
        "the clock runs backwards after reading {} (t_s {} follows {})",
        k + 1,
        times[k + 1],
        times[k]
    ))
}

/// Factors of a decimal point in the wrong place.
const DECIMALS: [f64; 6] = [10.0, 0.1, 100.0, 0.01, 1e3, 1e-3];
/// Standard deviations beyond which a reading contradicts the others, and within which it agrees
/// once the decimal point is moved.
const CONTRADICTS: f64 = 20.0;
const AGREES: f64 = 4.0;
/// More levels than this are no table that was typed.
const MAX_LEVELS: usize = 200;

/// A level all of whose readings contradict the declared law of the others, and agree with it once
/// the decimal point of stimulus or responses is moved. A single reading between others, and one
/// that contradicts its repeats, is an outlier like any other.
fn transposed_digits(rows: &[ScalarRow], declared: Declared) -> Option<String> {
    let (degree, axis) = match declared {
        Declared::Polynomial(0) => return None,
        Declared::Polynomial(degree) => (degree, false),
        Declared::Axis => (1, true),
    };
    let y = |r: &ScalarRow| if axis { r.x + 1e-3 * r.y } else { r.y };
    let levels = levels(rows);
    if levels.len() < degree + 4 || levels.len() > MAX_LEVELS {
        return None;
    }
    levels.into_iter().filter(|level| *level != 0.0).find_map(|level| {
        let (own, others): (Vec<&ScalarRow>, Vec<&ScalarRow>) = rows.iter().partition(|r| r.x == level);
        let scale = others.iter().map(|r| r.x.abs()).fold(0.0, f64::max);
        // In units of the largest stimulus, so that the powers stay of one size.
        let powers = |x: f64| (0..=degree).map(move |k| (x / scale).powi(k as i32));
        let design = DMatrix::from_row_iterator(others.len(), degree + 1, others.iter().flat_map(|r| powers(r.x)));
        let read = DVector::from_iterator(others.len(), others.iter().map(|r| y(r)));
        let law = design.clone().svd(true, true).solve(&read, 1e-12).ok()?;
        // Readings that agree to the last bit are as good as their rounding.
        let dof = others.len().saturating_sub(degree + 1).max(1) as f64;
        let sd = ((&read - design * &law).norm() / dof.sqrt()).max(1e-12 * read.amax());
        let off = |r: &ScalarRow, [stimulus, response]: [f64; 2]| {
            let predicted: f64 = powers(stimulus * r.x).zip(law.iter()).map(|(p, c)| p * c).sum();
            (response * y(r) - predicted).abs() / sd
        };
        let beyond = others.iter().all(|r| r.x < level) || others.iter().all(|r| r.x > level);
        let contradicts = sd > 0.0 && own.iter().all(|r| off(r, [1.0, 1.0]) > CONTRADICTS);
        let tried = DECIMALS.map(|f| ([f, 1.0], "stimulus", f)).into_iter().chain(DECIMALS.map(|f| ([1.0, f], "response", f)));
        let agrees = |factors: [f64; 2]| own.iter().all(|r| off(r, factors) < AGREES);
        let (_, what, factor) = tried
            .filter(|(_, what, _)| contradicts && (own.len() > 1 || beyond && *what == "stimulus"))
            .find(|(factors, ..)| agrees(*factors))?;
        Some(format!(
            "the {} readings at the stimulus {level} contradict all others; with the {what} times {factor} they agree (a decimal point in the wrong place?)",
            own.len()
        ))
    })
}

/// Parts of the stimulus that are sampled alike.
const BINS: usize = 40;

/// At most [`MAX_ROWS`] readings for the search, chosen by strata (part of the stimulus, direction,
/// cycle) so that nothing that alternates from row to row is lost; in each stratum spread evenly
/// over the session from its own place. All rows carry their place.
pub(super) fn thin(mut rows: Vec<ScalarRow>) -> Vec<ScalarRow> {
    let total = rows.len();
    if total <= MAX_ROWS {
        return rows;
    }
    let [lo, hi] = range(rows.iter().map(|r| r.x));
    let bin =
        |x: f64| (((x - lo) / (hi - lo).max(1e-300)) * BINS as f64).min(BINS as f64 - 1.0) as usize;
    let mut strata: BTreeMap<(usize, i8, u32), Vec<usize>> = BTreeMap::new();
    for (k, r) in rows.iter().enumerate() {
        // Without a column the direction is that of the step from the row before.
        let step = k.checked_sub(1).map_or(0.0, |j| r.x - rows[j].x);
        let step = if step == 0.0 { 0.0 } else { step.signum() };
        let way = r.direction.unwrap_or(step) as i8;
        let stratum = (bin(r.x), way, r.cycle.unwrap_or(0));
        strata.entry(stratum).or_default().push(k);
    }
    let mut kept = vec![false; total];
    for (s, members) in strata.values().enumerate() {
        let share = ((members.len() * MAX_ROWS) as f64 / total as f64).max(1.0) as usize;
        let stride = members.len() as f64 / share as f64;
        // The golden ratio's multiples lie evenly between 0 and 1: no two strata keep the same
        // phase.
        let phase = (s as f64 * 0.618_034).fract();
        for j in 0..share {
            kept[members[(((j as f64 + phase) * stride) as usize).min(members.len() - 1)]] = true;
        }
    }
    let mut keep = kept.iter();
    rows.retain(|_| *keep.next().unwrap_or(&false));
    rows
}

/// Gives every reading its place in the order of the measurement.
pub(super) fn number(rows: &mut [ScalarRow]) {
    let mut order: Vec<usize> = (0..rows.len()).collect();
    if rows.iter().all(|r| r.t_s.is_some()) {
        let t_s = |k: usize| rows[k].t_s.unwrap_or_default();
        order.sort_by(|&a, &b| t_s(a).total_cmp(&t_s(b)));
    }
    for (place, k) in order.into_iter().enumerate() {
        rows[k].place = Some(place);
    }
}

#[cfg(test)]
mod tests {
    use super::super::row::bare;
    use super::*;

    fn rows(n: usize) -> Vec<ScalarRow> {
        let direction = |k: usize| Some(if k.is_multiple_of(2) { 1.0 } else { -1.0 });
        let row = |k: usize| ScalarRow {
            direction: direction(k),
            ..bare(k, (k / 2 % 50) as f64, 0.0)
        };
        (0..n).map(row).collect()
    }

    #[test]
    fn both_directions_of_alternating_rows_are_kept_alike() {
        let mut all = rows(2000);
        number(&mut all);
        let kept = thin(all.clone());
        let up = kept.iter().filter(|r| r.direction == Some(1.0)).count();
        assert!(kept.len() <= 1100 && kept.len() >= 800, "{}", kept.len());
        assert!(
            up.abs_diff(kept.len() - up) < kept.len() / 10,
            "{up} of {}",
            kept.len()
        );
        assert!(kept.iter().all(|r| r.place == Some(r.origin.2 as usize)));
        // Control: every second row has one direction only.
        assert!(all.iter().step_by(2).all(|r| r.direction == Some(1.0)));
        assert_eq!(thin(rows(900)).len(), 900);
    }
}
