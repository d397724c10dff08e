//! What the order of the rows says: directions, strokes, series.

use super::row::{ScalarRow, all, range};
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// A table sorted by the stimulus with its repetitions side by side was put in order afterwards, or
/// might have been: where a reading stands among its repetitions then says nothing of when it was
/// taken.
pub(super) fn sorted_with_repetitions(setting: &[usize]) -> bool {
    let rises = setting.windows(2).all(|p| p[1] >= p[0]);
    let falls = setting.windows(2).all(|p| p[1] <= p[0]);
    let level = rises && falls;
    (rises || falls) && !level && setting.windows(2).any(|p| p[1] == p[0])
}

/// Directions are usable where each occurs this often.
pub(super) const MIN_EACH_WAY: usize = 3;

/// Given directions, or those of the sequence where time, cycles or strokes attest it.
pub(super) fn directions(rows: &[ScalarRow], setting: &[usize], least: usize) -> Option<Vec<f64>> {
    let found = match all(rows, |r| r.direction) {
        Some(given) => given,
        None if rows.iter().all(|r| r.t_s.is_some()) => {
            let mut out = vec![0.0; rows.len()];
            for k in 1..rows.len() {
                out[k] = match setting[k].cmp(&setting[k - 1]) {
                    Ordering::Equal => out[k - 1],
                    Ordering::Greater => 1.0,
                    Ordering::Less => -1.0,
                };
            }
            let first = out.iter().copied().find(|d| *d != 0.0).unwrap_or(1.0);
            out.iter()
                .map(|d| if *d == 0.0 { first } else { *d })
                .collect()
        }
        None if sorted_with_repetitions(setting) => return None,
        None if rows.iter().all(|r| r.cycle.is_some()) => ways_of_cycles(rows, setting),
        None if to_and_fro(setting) => ways(setting),
        None => return None,
    };
    let up = found.iter().filter(|d| **d > 0.0).count();
    (up >= least && found.len() - up >= least).then_some(found)
}

/// The same, cycle by cycle: the way back to where a series begins is none of its readings' ways.
/// Cycles in turns are one sequence.
fn ways_of_cycles(rows: &[ScalarRow], setting: &[usize]) -> Vec<f64> {
    let runs: Vec<&[ScalarRow]> = rows.chunk_by(|a, b| a.cycle == b.cycle).collect();
    let distinct: BTreeSet<Option<u32>> = rows.iter().map(|r| r.cycle).collect();
    if runs.len() > distinct.len() {
        return ways(setting);
    }
    let mut left = setting;
    let of_run = |run: &&[ScalarRow]| left.split_off(..run.len()).map_or(Vec::new(), ways);
    runs.iter().flat_map(of_run).collect()
}

/// Readings of a stroke.
const MIN_STROKE: usize = 4;

/// The stimulus goes to and fro in strokes of readings enough: nobody sorts a table so.
fn to_and_fro(setting: &[usize]) -> bool {
    let ways = ways(setting);
    let mut strokes = ways.chunk_by(|a, b| a == b);
    strokes.all(|stroke| stroke.len() >= MIN_STROKE)
}

/// Way of the stimulus at each row, by the order of the table: a place that is read twice at a turn
/// is read once on either way.
pub(crate) fn ways(setting: &[usize]) -> Vec<f64> {
    let step = |k: usize| {
        setting
            .get(k + 1)
            .map_or(0.0, |next| *next as f64 - setting[k] as f64)
    };
    let mut out = vec![0.0; setting.len()];
    for k in (0..setting.len()).rev() {
        let before = if k > 0 { step(k - 1) } else { 0.0 };
        let ahead = if step(k) != 0.0 {
            step(k).signum()
        } else {
            out.get(k + 1).copied().unwrap_or(0.0)
        };
        out[k] = if before != 0.0 {
            before.signum()
        } else {
            ahead
        };
    }
    out
}

/// Cycles or replicates that are runs over several stimuli; else one group.
pub(super) fn groups(rows: &[ScalarRow]) -> Vec<u32> {
    let Some(cycles) = all(rows, |r| r.cycle) else {
        return vec![0; rows.len()];
    };
    let run = |c: u32| {
        let [lo, hi] = range(
            rows.iter()
                .zip(&cycles)
                .filter(|(_, k)| **k == c)
                .map(|(r, _)| r.x),
        );
        hi > lo
    };
    let mut distinct = cycles.clone();
    distinct.sort_unstable();
    distinct.dedup();
    if distinct.len() > 1 && distinct.iter().all(|c| run(*c)) {
        cycles
    } else {
        vec![0; rows.len()]
    }
}

/// Fewer readings than this do not tell a series's zero.
const MIN_OF_SERIES: usize = 3;

/// Series of `rows` that each have readings enough for a zero of their own; none where one has not.
pub(super) fn series(rows: &[ScalarRow]) -> Vec<u32> {
    let groups = groups(rows);
    let mut distinct = groups.clone();
    distinct.sort_unstable();
    distinct.dedup();
    let enough = distinct
        .iter()
        .all(|s| groups.iter().filter(|g| *g == s).count() >= MIN_OF_SERIES);
    if enough && distinct.len() > 1 {
        distinct
    } else {
        Vec::new()
    }
}
