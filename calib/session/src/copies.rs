//! Rows that were pasted again. A repeat that agrees to the last digit is a copy where the noise would hardly let it agree: judged by how often
//! other repeats of the table do, or else by the roughness of its readings. A coarse gauge agrees with itself and keeps its rows.

use std::collections::{BTreeMap, BTreeSet};
use wcal_core::repeats::agreement_by_chance;

/// Chance below which agreement is none, over all places where a block could stand.
const LEVEL: f64 = 1e-4;
/// Pairs of repeats outside the suspected block that tell how often repeats agree.
const MIN_PAIRS: usize = 5;
/// Longer tables come from programs, which paste nothing.
const MAX_ROWS: usize = 20_000;
/// Share of distinct times from which on a time stands for one reading.
const OWN_TIMES: f64 = 0.9;
/// Earlier rows of the same content that a block is followed from.
const MAX_STARTS: usize = 16;

/// A row as it is compared.
pub(crate) struct Row {
    /// Setting: readings of one setting and direction ought to agree but for noise.
    pub setting: f64,
    /// Direction, 0 where it is not given.
    pub direction: f64,
    /// Reading.
    pub reading: f64,
    /// Time.
    pub t_s: Option<f64>,
    /// Whatever else was measured beside it.
    pub more: Vec<f64>,
}

impl Row {
    fn content(&self) -> Vec<u64> {
        // Numbers of cycles and times may have been continued by hand: they prove nothing.
        [self.setting, self.direction, self.reading].iter().chain(&self.more).map(|v| v.to_bits()).collect()
    }
}

/// A run of rows that repeats an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Block {
    original: usize,
    copy: usize,
    length: usize,
}

/// Indices of the rows that are copies of others, ascending.
pub(crate) fn copies(rows: &[Row]) -> Vec<usize> {
    if rows.len() > MAX_ROWS {
        return Vec::new();
    }
    let content: Vec<Vec<u64>> = rows.iter().map(Row::content).collect();
    let mut out: BTreeSet<usize> = same_times(rows, &content).into_iter().collect();
    #[allow(clippy::cast_precision_loss)]
    let places = (rows.len() * rows.len()) as f64 / 2.0;
    // Blocks that repeat the same rows are judged together: among three copies two agree for no other reason than the third.
    let mut by_original: BTreeMap<(usize, usize), BTreeSet<usize>> = BTreeMap::new();
    for b in blocks(&content) {
        by_original.entry((b.original, b.length)).or_default().extend(b.copy..b.copy + b.length);
    }
    for suspected in by_original.into_values() {
        let chance = agreement(rows, &suspected);
        if i32::try_from(suspected.len()).is_ok_and(|m| places * chance.powi(m) < LEVEL) {
            out.extend(suspected);
        }
    }
    if out.is_empty() {
        let beyond: BTreeSet<usize> = all_multiple(&content).into_iter().collect();
        let chance = agreement(rows, &beyond);
        let by_chance = i32::try_from(beyond.len()).map_or(0.0, |m| chance.powi(m));
        if by_chance < LEVEL {
            out = beyond;
        }
    }
    out.into_iter().collect()
}

/// Rows whose time and content stand in the table already, where every reading has a time of its own.
fn same_times(rows: &[Row], content: &[Vec<u64>]) -> Vec<usize> {
    let times: Vec<u64> = rows.iter().filter_map(|r| r.t_s).map(f64::to_bits).collect();
    let key = |i: usize| (times[i], &content[i]);
    if times.len() < rows.len() {
        return Vec::new();
    }
    let mut seen = BTreeSet::new();
    let again: Vec<usize> = (0..rows.len()).filter(|&i| !seen.insert(key(i))).collect();
    let distinct: BTreeSet<u64> = times.iter().copied().collect();
    #[allow(clippy::cast_precision_loss)]
    let own = distinct.len() as f64 >= OWN_TIMES * (rows.len() - again.len()) as f64;
    if own { again } else { Vec::new() }
}

/// The longest runs that repeat earlier rows, first come first served; runs do not overlap what they repeat.
fn blocks(content: &[Vec<u64>]) -> Vec<Block> {
    let mut known: BTreeMap<&[u64], Vec<usize>> = BTreeMap::new();
    let mut out: Vec<Block> = Vec::new();
    let mut copy = 0;
    while copy < content.len() {
        let starts = known.get(content[copy].as_slice()).map_or(&[][..], Vec::as_slice);
        let length = |original: usize| {
            let most = (copy - original).min(content.len() - copy);
            (0..most).take_while(|k| content[original + k] == content[copy + k]).count()
        };
        let best = starts
            .iter()
            .take(MAX_STARTS)
            .map(|&o| (length(o), o))
            .max_by_key(|b| (b.0, std::cmp::Reverse(b.1)));
        let step = match best {
            Some((length, original)) if length >= 2 => {
                out.push(Block { original, copy, length });
                length
            }
            _ => 1,
        };
        for (k, row) in content.iter().enumerate().skip(copy).take(step) {
            known.entry(row).or_default().push(k);
        }
        copy += step;
    }
    out
}

/// Rows beyond a whole share of a table in which every row stands equally often or a multiple of it: two or three times the same table, sorted.
fn all_multiple(content: &[Vec<u64>]) -> Vec<usize> {
    let mut places: BTreeMap<&[u64], Vec<usize>> = BTreeMap::new();
    for (k, c) in content.iter().enumerate() {
        places.entry(c).or_default().push(k);
    }
    let times = places.values().fold(0, |g, p| gcd(g, p.len()));
    if times < 2 {
        return Vec::new();
    }
    places.values().flat_map(|p| p[p.len() / times..].to_vec()).collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Chance that two repeats agree, from the rows that are under no suspicion.
fn agreement(rows: &[Row], suspected: &BTreeSet<usize>) -> f64 {
    let kept: Vec<&Row> =
        rows.iter().enumerate().filter(|(i, _)| !suspected.contains(i)).map(|(_, r)| r).collect();
    let mut cells: BTreeMap<[u64; 2], Vec<u64>> = BTreeMap::new();
    for r in &kept {
        cells.entry([r.setting.to_bits(), r.direction.to_bits()]).or_default().push(r.reading.to_bits());
    }
    let (mut pairs, mut equal) = (0usize, 0usize);
    for cell in cells.values() {
        for (k, a) in cell.iter().enumerate() {
            pairs += k;
            equal += cell[..k].iter().filter(|b| *b == a).count();
        }
    }
    if pairs >= MIN_PAIRS {
        // Half a pair more of each kind: never certain of what a few pairs show.
        #[allow(clippy::cast_precision_loss)]
        return (equal as f64 + 0.5) / (pairs as f64 + 1.0);
    }
    let of = |f: fn(&Row) -> f64| kept.iter().map(|r| f(r)).collect::<Vec<f64>>();
    agreement_by_chance(&of(|r| r.setting), &of(|r| r.reading))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `sweeps` of eleven settings; `noise` counts of scatter in the last digit, another in each sweep.
    fn sweeps(sweeps: usize, noise: f64) -> Vec<Row> {
        let scatter = |k: usize| (k as f64 * 12.9898).sin() * 43758.5453;
        let of = |k: usize| {
            let x = (k % 11) as f64;
            let z = 3.4 * (scatter(k).rem_euclid(1.0) - 0.5);
            let reading = ((20_000.0 * x + noise * z).round()) / 1e5;
            Row { setting: x, direction: 0.0, reading, t_s: None, more: Vec::new() }
        };
        (0..11 * sweeps).map(of).collect()
    }

    fn again(rows: &[Row], places: impl IntoIterator<Item = usize>) -> Vec<Row> {
        let copy = |r: &Row| Row { more: r.more.clone(), ..*r };
        rows.iter().map(copy).chain(places.into_iter().map(|k| copy(&rows[k]))).collect()
    }

    #[test]
    fn pasted_sweeps_are_found_and_honest_repeats_stay() {
        let one = sweeps(1, 4.0);
        let three = again(&again(&one, 0..11), 0..11);
        assert_eq!(copies(&three), (11..33).collect::<Vec<_>>());
        // One of three sweeps pasted once more.
        assert_eq!(copies(&again(&sweeps(3, 4.0), 11..22)), (33..44).collect::<Vec<_>>());
        // Sorted by the setting, copies side by side.
        let mut sorted = three;
        sorted.sort_by(|a, b| a.setting.total_cmp(&b.setting));
        assert_eq!(copies(&sorted).len(), 22);
        // Repeats with noise, and repeats of a gauge whose noise hides below its last digit.
        assert!(copies(&sweeps(6, 4.0)).is_empty());
        assert!(copies(&again(&sweeps(1, 0.0), 0..11)).is_empty());
        assert!(copies(&sweeps(6, 0.2)).is_empty());
    }

    #[test]
    fn a_time_is_read_once() {
        let timed = |rows: Vec<Row>, time: fn(usize) -> f64| -> Vec<Row> {
            rows.into_iter().enumerate().map(|(k, r)| Row { t_s: Some(time(k)), ..r }).collect()
        };
        let one = timed(sweeps(2, 0.0), |k| k as f64);
        assert_eq!(copies(&again(&one, [3, 4])), [22, 23]);
        assert!(copies(&one).is_empty());
        // Stamps of the day are shared by honest repeats.
        assert!(copies(&timed(again(&sweeps(1, 0.0), 0..11), |k| (k / 22) as f64)).is_empty());
    }
}
