//! Readings as the means of blocks over which the object goes on by a step: each step says about the same, whatever the rate.

use crate::known_motion::MotionRow;
use nalgebra::{Matrix2, Vector3};

/// Way of the object over a block, mm.
pub(super) const STEP_MM: f64 = 0.7;

/// A reading at an end lies up to this many steps past the middle of the last block.
const PAST: f64 = 0.7;

/// Means over blocks, and for each reading where it lies among them: a block and the share of the way to the next.
pub(super) fn blocks(rows: &[MotionRow]) -> (Vec<MotionRow>, Vec<(usize, f64)>) {
    let mut means = Vec::new();
    let mut from = 0;
    while from < rows.len() {
        let way = |k: usize| (rows[k].moved_mm - rows[from].moved_mm).norm();
        let mut to = (from + 1..rows.len()).find(|k| way(*k) >= STEP_MM).unwrap_or(rows.len());
        // What is left at the end joins the last block.
        let last = rows.len() - 1;
        if to <= last && (rows[last].moved_mm - rows[to].moved_mm).norm() < 0.5 * STEP_MM {
            to = rows.len();
        }
        means.push(mean(&rows[from..to]));
        from = to;
    }
    let place = |row: &MotionRow| {
        let Some(last) = means.len().checked_sub(2) else { return (0, 0.0) };
        let k = means.partition_point(|b| b.t_s <= row.t_s).saturating_sub(1).min(last);
        let share = (row.t_s - means[k].t_s) / (means[k + 1].t_s - means[k].t_s);
        (k, share.clamp(-PAST, 1.0 + PAST))
    };
    let places = rows.iter().map(place).collect();
    (means, places)
}

pub(super) fn mean(rows: &[MotionRow]) -> MotionRow {
    let n = rows.len() as f64;
    let of = |value: &dyn Fn(&MotionRow) -> f64| rows.iter().map(value).sum::<f64>() / n;
    let middle = &rows[rows.len() / 2];
    MotionRow {
        t_s: of(&|r| r.t_s),
        moment_nmm: [0, 1].map(|c| of(&|r| r.moment_nmm[c])),
        noise_nmm2: rows.iter().map(|r| r.noise_nmm2).sum::<Matrix2<f64>>() / (n * n),
        shared_nmm: (0..middle.shared_nmm.len())
            .map(|j| [0, 1].map(|c| of(&|r| r.shared_nmm[j][c])))
            .collect(),
        moved_mm: rows.iter().map(|r| r.moved_mm).sum::<Vector3<f64>>() / n,
        moved_sd_mm: of(&|r| r.moved_sd_mm),
        ..middle.clone()
    }
}
