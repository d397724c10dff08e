//! Copies in a holdout, and honest repeats that only look like them (SIMULATED).

use wcal_trace::verify::copied_holdout::{ComparedRow, copied_holdout};

/// Runs over ten levels; `read` gives the reading of a run at a level.
fn rows(runs: std::ops::Range<usize>, timed: bool, read: impl Fn(usize, usize) -> f64) -> Vec<ComparedRow> {
    runs.flat_map(|run| (0..10).map(move |level| (run, level)))
        .map(|(run, level)| ComparedRow {
            setting: vec![(level as f64).to_bits()],
            reading: vec![read(run, level)],
            rest: Vec::new(),
            t_s: timed.then(|| (10 * run + level) as f64),
        })
        .collect()
}

fn noise(run: usize, level: usize) -> f64 {
    ((run * 10 + level) as f64 * 12.9898).sin() * 43_758.545
}

fn fine(run: usize, level: usize) -> f64 {
    level as f64 * 3.3 + 0.01 * noise(run, level).fract()
}

fn dial(run: usize, level: usize) -> f64 {
    (fine(run, level) * 10.0).round() / 10.0
}

#[test]
fn repeats_of_a_coarse_gauge_are_no_copies() {
    assert_eq!(copied_holdout(&rows(0..3, false, dial), &rows(3..4, false, dial)), None);
    // One run alone shows no repeats: the steps tell.
    assert_eq!(copied_holdout(&rows(0..1, false, dial), &rows(3..4, false, dial)), None);
    // A clock of whole minutes: readings of one minute agree in every column.
    let minutes = |rows: Vec<ComparedRow>| -> Vec<ComparedRow> {
        rows.into_iter().map(|r| ComparedRow { t_s: r.t_s.map(|_| 60.0), ..r }).collect()
    };
    assert_eq!(copied_holdout(&minutes(rows(0..3, true, dial)), &minutes(rows(3..4, true, dial))), None);
}

#[test]
fn copies_are_named() {
    let copied = |fitted: &[ComparedRow], sealed: &[ComparedRow]| copied_holdout(fitted, sealed).is_some();
    let all = rows(0..3, false, fine);
    assert!(copied(&all, &all[10..20]) && copied(&all[..10], &all[..10]));
    let timed = rows(0..3, true, dial);
    // Of a coarse gauge too, where the clock tells: one row is enough.
    assert!(copied(&timed, &timed[7..8]));
    assert!(!copied(&all, &rows(5..6, false, fine)) && !copied(&timed, &rows(5..6, true, dial)));
}
