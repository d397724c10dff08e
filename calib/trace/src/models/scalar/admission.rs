//! Which readings can be used at all.

use super::frame::{Declared, ScalarRow, Scaling};
use crate::verify::copied_holdout::{ComparedRow, bits, copied_holdout};
use std::collections::BTreeMap;
use wcal_core::Sealed;

/// Fewer readings than this are refused.
const MIN_ROWS: usize = 8;
/// The search takes at most this many readings of a session; all are predicted.
const MAX_ROWS: usize = 1000;

/// Why the readings of the points table cannot be used; `sealed` are those of the holdout.
pub(super) fn refusal(
    rows: &[ScalarRow],
    sealed: &Sealed<ScalarRow>,
    scaling: &Scaling,
    declared: Declared,
) -> Option<String> {
    let parameters = match declared {
        Declared::Polynomial(degree) => degree + 1,
        Declared::Axis => 1,
    };
    if rows.len() < MIN_ROWS {
        return Some(format!("{} readings; at least {MIN_ROWS} are needed", rows.len()));
    }
    let finite = |r: &ScalarRow| (r.x.is_finite() && r.y.is_finite(), r.origin.clone());
    let all = rows.iter().map(finite).chain(sealed.admission(finite));
    if let Some((_, bad)) = all.into_iter().find(|r| !r.0) {
        return Some(format!("reading {} of {} is not a finite number", bad.2, bad.0));
    }
    let mut x: Vec<f64> = rows.iter().map(|r| r.x).collect();
    x.sort_by(f64::total_cmp);
    x.dedup();
    if x.len() < parameters || (parameters > 1 && !(scaling.half > 0.0)) {
        let count = x.len();
        return Some(
            declared.worded(&format!("{count} different stimuli do not determine {parameters} coefficients")),
        );
    }
    let fitted: Vec<ComparedRow> = rows.iter().map(compared).collect();
    clock_fault(rows.iter().map(|r| r.t_s)).or_else(|| copied_holdout(&fitted, &sealed.admission(compared)))
}

/// Where the clock of a table in file order runs backwards, in words.
pub fn clock_fault(times: impl Iterator<Item = Option<f64>>) -> Option<String> {
    let times: Vec<f64> = times.flatten().collect();
    let k = times.windows(2).position(|w| w[1] < w[0])?;
    Some(format!(
        "the clock runs backwards after reading {} (t_s {} follows {})",
        k + 1,
        times[k + 1],
        times[k]
    ))
}

/// A reading as it is compared with those of the points table.
fn compared(r: &ScalarRow) -> ComparedRow {
    let more = [r.temperature_degc, r.cycle.map(f64::from)];
    ComparedRow {
        setting: bits(&[Some(r.x), r.direction]),
        reading: vec![r.y],
        rest: more.into_iter().chain(r.covariates.iter().map(|v| Some(*v))).map(|v| bits(&[v])[0]).collect(),
        t_s: r.t_s,
    }
}

/// Parts of the stimulus that are sampled alike.
const BINS: usize = 40;

/// At most [`MAX_ROWS`] readings for the search, chosen by strata (part of the stimulus, direction, cycle) so that nothing that alternates
/// from row to row is lost; in each stratum spread evenly over the session from a place of its own. All rows carry their place.
pub(super) fn thin(mut rows: Vec<ScalarRow>) -> Vec<ScalarRow> {
    let total = rows.len();
    if total <= MAX_ROWS {
        return rows;
    }
    let [lo, hi] = rows.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], r| [a.min(r.x), b.max(r.x)]);
    let bin = |x: f64| (((x - lo) / (hi - lo).max(1e-300)) * BINS as f64).min(BINS as f64 - 1.0) as usize;
    let mut strata: BTreeMap<(usize, i8, u32), Vec<usize>> = BTreeMap::new();
    for (k, r) in rows.iter().enumerate() {
        // Without a column the direction is that of the step from the row before.
        let step = k.checked_sub(1).map_or(0.0, |j| r.x - rows[j].x);
        let direction = r.direction.unwrap_or(if step == 0.0 { 0.0 } else { step.signum() });
        strata.entry((bin(r.x), direction as i8, r.cycle.unwrap_or(0))).or_default().push(k);
    }
    let mut kept = vec![false; total];
    for (s, members) in strata.values().enumerate() {
        let share = ((members.len() * MAX_ROWS) as f64 / total as f64).max(1.0) as usize;
        let stride = members.len() as f64 / share as f64;
        // The golden ratio's multiples lie evenly between 0 and 1: no two strata keep the same phase.
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
        order.sort_by(|&a, &b| rows[a].t_s.unwrap_or(0.0).total_cmp(&rows[b].t_s.unwrap_or(0.0)));
    }
    for (place, k) in order.into_iter().enumerate() {
        rows[k].place = Some(place);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_core::observation::Role;

    fn rows(n: usize) -> Vec<ScalarRow> {
        let row = |k: usize| ScalarRow {
            origin: ("t.csv".into(), k + 2, k as i64),
            role: Role::Calibration,
            x: (k / 2 % 50) as f64,
            y: 0.0,
            t_s: None,
            temperature_degc: None,
            direction: Some(if k.is_multiple_of(2) { 1.0 } else { -1.0 }),
            cycle: None,
            covariates: Vec::new(),
            place: None,
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
        assert!(up.abs_diff(kept.len() - up) < kept.len() / 10, "{up} of {}", kept.len());
        assert!(kept.iter().all(|r| r.place == Some(r.origin.2 as usize)));
        // Control: every second row has one direction only.
        assert!(all.iter().step_by(2).all(|r| r.direction == Some(1.0)));
        assert_eq!(thin(rows(900)).len(), 900);
    }
}
