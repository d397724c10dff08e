//! Rows that were pasted again. Rounded readings agree now and then, so many in a row do not: a run of rows that repeats an earlier one is a copy,
//! and so is a row with the time of the one that it repeats. A coarse gauge agrees with itself and keeps its rows.

use std::collections::HashMap;

/// Rows of a run that repeats an earlier one: fewer agree by chance.
const MIN_RUN: usize = 6;
/// Pairs of repeats outside the runs that tell whether repeats agree, and the share that may.
const MIN_PAIRS: usize = 5;
const MAX_AGREEING: f64 = 0.25;
/// Longer tables come from programs, which paste nothing.
const MAX_ROWS: usize = 20_000;
/// A gauge with no more steps over what was read is coarse: its repeats agree. 12 bits.
const COARSE_STEPS: f64 = 4096.0;

/// A row as it is compared.
pub(crate) struct Row {
    /// Setting and direction (0 where it is not given): readings of one of them ought to agree but for noise.
    pub setting: [f64; 2],
    /// Reading.
    pub reading: f64,
    /// Time. Numbers of cycles and times may have been continued by hand: that they differ proves nothing.
    pub t_s: Option<f64>,
    /// Whatever else was measured beside it.
    pub more: Vec<f64>,
}

/// Places of the rows that are copies, ascending.
pub(crate) fn copies(rows: &[Row]) -> Vec<usize> {
    let content = |row: &Row| -> Vec<u64> {
        row.setting.iter().chain([&row.reading]).chain(&row.more).map(|v| v.to_bits()).collect()
    };
    let contents: Vec<Vec<u64>> = rows.iter().map(content).collect();
    let (mut seen, mut last) = (HashMap::new(), None);
    let repeat = |(k, row): (usize, &Row)| {
        let first = *seen.entry(&contents[k]).or_insert(k);
        // A run goes on although one of its rows agrees with another by chance.
        let next = last.map(|l: usize| l + 1).filter(|n| *n < k && contents[*n] == contents[k]);
        let known = next.or((first < k).then_some(first));
        last = known;
        (known, known.is_some_and(|first| row.t_s.is_some() && row.t_s == rows[first].t_s))
    };
    let found = repeated(&rows.iter().enumerate().map(repeat).collect::<Vec<_>>());
    if rows.len() > MAX_ROWS || repeats_agree(rows, &found) { Vec::new() } else { found }
}

/// Places of rows that are copies, from the place of the row that each repeats, and whether it is one beyond doubt; runs of others count.
pub(crate) fn repeated(rows: &[(Option<usize>, bool)]) -> Vec<usize> {
    let mut copies = Vec::new();
    let mut start = 0;
    while start < rows.len() {
        let Some(first) = rows[start].0 else {
            start += 1;
            continue;
        };
        let follows = |k: usize| rows.get(start + k).is_some_and(|r| r.0 == Some(first + k));
        let length = (1..).find(|k| !follows(*k)).unwrap_or(1);
        copies.extend((start..start + length).filter(|&k| length >= MIN_RUN || rows[k].1));
        start += length;
    }
    copies
}

/// Whether honest repeats of the table agree to the last digit: as others do that are under no suspicion, or where the gauge is coarse.
fn repeats_agree(rows: &[Row], suspected: &[usize]) -> bool {
    let mut cells: HashMap<[u64; 2], HashMap<u64, usize>> = HashMap::new();
    for (_, r) in rows.iter().enumerate().filter(|(k, _)| suspected.binary_search(k).is_err()) {
        *cells.entry(r.setting.map(f64::to_bits)).or_default().entry(r.reading.to_bits()).or_default() += 1;
    }
    let pairs = |n: usize| n * (n - 1) / 2;
    let all: usize = cells.values().map(|cell| pairs(cell.values().sum())).sum();
    let equal: usize = cells.values().flat_map(HashMap::values).map(|n| pairs(*n)).sum();
    if all >= MIN_PAIRS {
        return equal as f64 > MAX_AGREEING * all as f64;
    }
    let [low, high] = rows
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], r| [a.min(r.reading), b.max(r.reading)]);
    // A display shows whole multiples of a power of ten.
    let unit = 10f64.powf(((high - low) / COARSE_STEPS).log10().ceil());
    let on_scale = |r: &Row| (r.reading / unit - (r.reading / unit).round()).abs() < 1e-6;
    !(high > low) || rows.iter().all(on_scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `sweeps` of eleven settings; `noise` counts of scatter in the last digit of `digits`, another in each sweep.
    fn sweeps(sweeps: usize, noise: f64, digits: f64) -> Vec<Row> {
        let scatter = |k: usize| (k as f64 * 12.9898).sin() * 43758.5453;
        let of = |k: usize| {
            let x = (k % 11) as f64;
            let z = 3.4 * (scatter(k).rem_euclid(1.0) - 0.5);
            let reading = (0.2 * x * digits + noise * z).round() / digits;
            Row { setting: [x, 0.0], reading, t_s: None, more: Vec::new() }
        };
        (0..11 * sweeps).map(of).collect()
    }

    fn again(rows: &[Row], places: impl IntoIterator<Item = usize>) -> Vec<Row> {
        let copy = |r: &Row| Row { more: r.more.clone(), ..*r };
        rows.iter().map(copy).chain(places.into_iter().map(|k| copy(&rows[k]))).collect()
    }

    #[test]
    fn pasted_sweeps_are_found_and_honest_repeats_stay() {
        let one = sweeps(1, 4.0, 1e5);
        assert_eq!(copies(&again(&again(&one, 0..11), 0..11)), (11..33).collect::<Vec<_>>());
        // One of three sweeps pasted once more.
        assert_eq!(copies(&again(&sweeps(3, 4.0, 1e5), 11..22)), (33..44).collect::<Vec<_>>());
        // Repeats with noise, and repeats of a gauge whose noise hides below its last digit.
        assert!(copies(&sweeps(6, 4.0, 1e5)).is_empty());
        assert!(copies(&again(&sweeps(1, 0.0, 100.0), 0..11)).is_empty());
        assert!(copies(&sweeps(6, 0.2, 100.0)).is_empty());
    }

    #[test]
    fn a_time_is_read_once() {
        let timed = |rows: Vec<Row>, time: fn(usize) -> f64| -> Vec<Row> {
            rows.into_iter().enumerate().map(|(k, r)| Row { t_s: Some(time(k)), ..r }).collect()
        };
        let one = timed(sweeps(2, 4.0, 1e5), |k| k as f64);
        assert_eq!(copies(&again(&one, [3, 4])), [22, 23]);
        // A coarse clock, and a gauge that repeats itself.
        assert!(copies(&timed(sweeps(4, 0.0, 100.0), |_| 60.0)).is_empty());
    }
}
