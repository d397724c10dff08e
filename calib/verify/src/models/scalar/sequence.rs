//! What the order of the rows says: directions, strokes, series.

use super::row::{ScalarRow, all};
use crate::models::range;
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

/// Fewer readings than this say nothing of a direction, of a series, of either side of a step or of
/// a limit.
pub(super) const MIN_REPEATS: usize = 3;

/// Given directions, or those of the sequence where time, cycles or strokes attest it.
pub(super) fn directions(rows: &[ScalarRow], setting: &[usize], least: usize) -> Option<Vec<f64>> {
    let found = match all(rows, |r| r.direction) {
        Some(given) => given,
        None if rows.iter().all(|r| r.t_s.is_some()) => {
            let step = |p: &[usize]| p[1] as f64 - p[0] as f64;
            let moves = || setting.windows(2).map(step).filter(|d| *d != 0.0);
            let mut way = moves().next().map_or(1.0, f64::signum);
            let first = way;
            let ways = setting.windows(2).map(|p| {
                if p[1] != p[0] {
                    way = step(p).signum();
                }
                way
            });
            std::iter::once(first).chain(ways).collect()
        }
        None if sorted_with_repetitions(setting) => return None,
        None if rows.iter().all(|r| r.cycle.is_some()) => ways_of_cycles(rows, setting),
        None if to_and_fro(setting) => ways(setting),
        None => return None,
    };
    let up = found.iter().filter(|d| **d > 0.0).count();
    // One way alone says nothing of a difference between the ways.
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
    let way = |a: usize, b: usize| f64::from(i8::from(b > a) - i8::from(b < a));
    let mut out = vec![0.0; setting.len()];
    let mut ahead = 0.0;
    for k in (0..setting.len()).rev() {
        let [before, after] = [k.saturating_sub(1), k + 1].map(|j| setting.get(j));
        let own = setting[k];
        let next = after.map_or(0.0, |next| way(own, *next));
        let came = before.map_or(0.0, |last| way(*last, own));
        ahead = [came, next, ahead]
            .into_iter()
            .find(|w| *w != 0.0)
            .unwrap_or_default();
        out[k] = ahead;
    }
    out
}

/// Cycles or replicates that are runs over several stimuli; else one group.
pub(super) fn groups(rows: &[ScalarRow]) -> Vec<u32> {
    let Some(cycles) = all(rows, |r| r.cycle) else {
        return vec![0; rows.len()];
    };
    let run = |c: u32| {
        let own = rows.iter().filter(|r| r.cycle == Some(c));
        let [lo, hi] = range(own.map(|r| r.x));
        hi > lo
    };
    let distinct: BTreeSet<u32> = cycles.iter().copied().collect();
    if distinct.len() > 1 && distinct.into_iter().all(run) {
        cycles
    } else {
        vec![0; rows.len()]
    }
}

/// Series of `rows` that each have readings enough for a zero of their own; none where one has not.
pub(super) fn series(rows: &[ScalarRow]) -> Vec<u32> {
    let groups = groups(rows);
    let distinct: BTreeSet<u32> = groups.iter().copied().collect();
    let size = |s: &u32| groups.iter().filter(|g| *g == s).count();
    let few = distinct.len() < 2 || distinct.iter().any(|s| size(s) < MIN_REPEATS);
    let series = distinct.into_iter().filter(|_| !few);
    series.collect()
}
