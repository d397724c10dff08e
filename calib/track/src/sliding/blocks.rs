//! Readings as the means of blocks over which the object goes on by a step: each step says about
//! the same, whatever the rate.
//!
//! The mean of moments over a step is not the moment at its middle: by m'' var(d) / 2, with m''
//! from the blocks around ([`Means::at_middles`]).

use crate::known_motion::MotionRow;
use nalgebra::{Matrix2, Vector3};

/// Way of the object over a block, mm.
const STEP_MM: f64 = 0.7;

/// Between blocks that are nearer to each other readings are placed by time, mm.
const MIN_STEP_MM: f64 = 0.2;

/// A reading at an end lies up to this many steps past the middle of the last block.
const PAST: f64 = 0.7;

/// Means over blocks, each with the variance of the way within it, mm^2.
#[derive(Debug, Clone, Default)]
pub struct Means {
    pub(super) rows: Vec<MotionRow>,
    spreads_mm2: Vec<f64>,
}

impl Means {
    fn push(&mut self, rows: &[MotionRow]) {
        let mean = mean(rows);
        // Variance of the way within the block, by which its mean moment is off.
        let off = |r: &MotionRow| (r.moved_mm - mean.moved_mm).norm_squared();
        self.spreads_mm2
            .push(rows.iter().map(off).sum::<f64>() / rows.len() as f64);
        self.rows.push(mean);
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The moments at the blocks' mean places.
    pub(crate) fn at_middles(&self) -> Vec<MotionRow> {
        let rows = &self.rows;
        // Second divided difference over three blocks of unequal steps.
        let second = |k: usize| -> Option<[f64; 2]> {
            let [a, b, c] = rows.get(k.checked_sub(1)?..k + 2)? else {
                return None;
            };
            let [before, after] =
                [(a, b), (b, c)].map(|(a, b)| (b.moved_mm - a.moved_mm).norm().max(1e-9));
            Some([0, 1].map(|i| {
                let rates = (c.moment_nmm[i] - b.moment_nmm[i]) / after
                    - (b.moment_nmm[i] - a.moment_nmm[i]) / before;
                2.0 * rates / (before + after)
            }))
        };
        let last = rows.len().saturating_sub(2);
        let middle = |(k, (row, spread)): (usize, (&MotionRow, &f64))| {
            // The outer blocks take the bend of their neighbour, which has a block on both sides.
            let bend = second(k.clamp(1, last.max(1))).unwrap_or_default();
            let moment_nmm = [0, 1].map(|i| row.moment_nmm[i] - 0.5 * bend[i] * spread);
            MotionRow {
                moment_nmm,
                ..row.clone()
            }
        };
        rows.iter()
            .zip(&self.spreads_mm2)
            .enumerate()
            .map(middle)
            .collect()
    }

    pub(super) fn extend(&mut self, other: Self) {
        self.rows.extend(other.rows);
        self.spreads_mm2.extend(other.spreads_mm2);
    }
}

/// Means over blocks, and for each reading where it lies among them: a block and the share of the
/// way to the next.
pub(super) fn blocks(rows: &[MotionRow]) -> (Means, Vec<(usize, f64)>) {
    let mut all = Means::default();
    let mut from = 0;
    while from < rows.len() {
        let way = |k: usize| (rows[k].moved_mm - rows[from].moved_mm).norm();
        let mut to = (from + 1..rows.len())
            .find(|k| way(*k) >= STEP_MM)
            .unwrap_or(rows.len());
        // The readings at the end join the last block.
        if rows[to..]
            .iter()
            .all(|r| (r.moved_mm - rows[to].moved_mm).norm() < 0.5 * STEP_MM)
        {
            to = rows.len();
        }
        all.push(&rows[from..to]);
        from = to;
    }
    let means = &all.rows;
    let place = |row: &MotionRow| {
        let Some(last) = means.len().checked_sub(2) else {
            return (0, 0.0);
        };
        let k = means
            .partition_point(|b| b.t_s <= row.t_s)
            .saturating_sub(1)
            .min(last);
        let step = means[k + 1].moved_mm - means[k].moved_mm;
        // A contact goes on with the motion: a hold where it turns lies at the turn, whatever its
        // time.
        let share = if step.norm() > MIN_STEP_MM {
            (row.moved_mm - means[k].moved_mm).dot(&step) / step.norm_squared()
        } else {
            (row.t_s - means[k].t_s) / (means[k + 1].t_s - means[k].t_s)
        };
        (k, share.clamp(-PAST, 1.0 + PAST))
    };
    let places = rows.iter().map(place).collect();
    (all, places)
}

/// Readings of a block that are kept: a long hold says no more.
const MAX_OPEN: usize = 64;

/// Blocks of readings as they come.
#[derive(Debug, Clone, Default)]
pub struct Blocks {
    /// Means of those that are complete.
    pub means: Means,
    open: Vec<MotionRow>,
}

impl Blocks {
    /// Puts a reading into its block; whether one is complete by it.
    pub fn push(&mut self, row: &MotionRow) -> bool {
        let complete = self
            .open
            .first()
            .is_some_and(|first| (row.moved_mm - first.moved_mm).norm() >= STEP_MM);
        if complete {
            self.means.push(&self.open);
            self.open.clear();
        }
        if self.open.len() < MAX_OPEN {
            self.open.push(row.clone());
        }
        complete
    }
}

fn mean(rows: &[MotionRow]) -> MotionRow {
    let n = rows.len() as f64;
    let of = |value: &dyn Fn(&MotionRow) -> f64| rows.iter().map(value).sum::<f64>() / n;
    // Rotation, visit and the like have no mean: the middle reading stands for them.
    let middle = &rows[rows.len() / 2];
    MotionRow {
        t_s: of(&|r| r.t_s),
        moment_nmm: [0, 1].map(|c| of(&|r| r.moment_nmm[c])),
        // Noise of a mean of n independent readings: the mean covariance over n.
        noise_nmm2: rows.iter().map(|r| r.noise_nmm2).sum::<Matrix2<f64>>() / (n * n),
        shared_nmm: (0..middle.shared_nmm.len())
            .map(|j| [0, 1].map(|c| of(&|r| r.shared_nmm[j][c])))
            .collect(),
        moved_mm: rows.iter().map(|r| r.moved_mm).sum::<Vector3<f64>>() / n,
        moved_sd_mm: of(&|r| r.moved_sd_mm),
        ..middle.clone()
    }
}
