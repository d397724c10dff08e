//! Noise of the no-contact prefix, and the limits that follow from it and a rate of false alarms.
//!
//! On blocks of 2 ms, two statistics, each a squared Mahalanobis distance with a covariance S estimated from the prefix (n degrees of
//! freedom):
//!
//! ```text
//! level     v = mean of the last 10 blocks - baseline
//! abrupt    v = mean of the last 5 blocks - the line through the 30 before them, continued
//! T^2       v^T S^-1 v;   under noise T^2 (n - 1) / (2 n) ~ F(2, n - 1)          (Hotelling)
//! limit     T^2_p = n (p^(-2 / (n - 1)) - 1),   p = false alarms an hour / 2 / blocks an hour
//! ```
//!
//! Source: H. Hotelling, Annals of Mathematical Statistics 2 (1931) 360; the tail of F(2, n) is (1 + 2 f / n)^(-n / 2).

use nalgebra::{Matrix2, Vector2};

/// Length of a block: samples are averaged over it before anything is judged, s. A 250 Hz ring still passes.
pub const BLOCK_S: f64 = 0.002;
/// Blocks of the window whose level is compared with the baseline.
pub const LEVEL_BLOCKS: usize = 10;
/// Blocks before and after an abrupt change: a line through those before, the mean of those after.
pub const BLOCKS_BEFORE: usize = 30;
/// See [`BLOCKS_BEFORE`].
pub const BLOCKS_AFTER: usize = 5;

/// A mean over [`BLOCK_S`]: middle of its time, s, and moments, N mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Block {
    /// Middle, s.
    pub t_s: f64,
    /// Mean, N mm.
    pub moment: Vector2<f64>,
}

/// Noise estimated from a no-contact prefix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Mean moment at the end of the prefix, N mm.
    pub baseline: Vector2<f64>,
    /// Covariance of a block, (N mm)^2.
    pub block: Matrix2<f64>,
    /// Covariance of a level window.
    pub level: Matrix2<f64>,
    /// Covariance of the contrast of an abrupt change.
    pub abrupt: Matrix2<f64>,
    /// Degrees of freedom of both.
    pub dof: [f64; 2],
    /// Largest drift that the prefix does not rule out (two standard errors), N mm/s.
    pub drift_nmm_s: f64,
}

/// Limits on the squared Mahalanobis distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thresholds {
    /// Level against baseline: contact.
    pub level: f64,
    /// Abrupt change.
    pub abrupt: f64,
    /// Below it the level counts as back at the baseline.
    pub back: f64,
}

/// Share of windows of a free wire that lie farther from the baseline than [`Thresholds::back`].
const BACK_SHARE: f64 = 0.01;

/// Limit that a squared distance with an estimated covariance (`dof`) passes with probability `p` (Hotelling, two components):
/// the tail of F(2, n) is (1 + 2 f / n)^(-n/2).
pub fn hotelling(p: f64, dof: f64) -> f64 {
    dof * (p.powf(-2.0 / (dof - 1.0)) - 1.0)
}

impl Noise {
    /// From the blocks of a prefix; `None` where there are too few or one axis does not vary at all.
    pub fn of(blocks: &[Block]) -> Option<Self> {
        let span = BLOCKS_BEFORE + BLOCKS_AFTER;
        if blocks.len() < 8 * span {
            return None;
        }
        let (mean, slope, detrended, [middle_s, stt]) = detrended(blocks);
        let spread = |vs: &[Vector2<f64>], lost: f64| {
            vs.iter().map(|v| v * v.transpose()).sum::<Matrix2<f64>>() / (vs.len() as f64 - lost)
        };
        let levels = windows(&detrended);
        let contrasts: Vec<Vector2<f64>> = (span..=blocks.len())
            .step_by(BLOCKS_AFTER)
            .map(|end| contrast(&blocks[end - span..end]))
            .collect();
        let level = spread(&levels, 2.0);
        let end_s = blocks.last()?.t_s;
        // From windows, not blocks: correlated noise would make the slope's standard error too small.
        let slope_var = level * LEVEL_BLOCKS as f64 / stt;
        let noise = Self {
            baseline: mean + slope * (end_s - middle_s),
            block: spread(&detrended, 2.0),
            level,
            abrupt: spread(&contrasts, 0.0),
            // Contrasts overlap: as many degrees of freedom as disjoint ones.
            dof: [levels.len() as f64 - 2.0, (blocks.len() / span) as f64],
            drift_nmm_s: slope.norm() + 2.0 * slope_var.trace().sqrt(),
        };
        let sound = [noise.block, noise.level, noise.abrupt].iter().all(|m| m.determinant() > 1e-30);
        sound.then_some(noise)
    }

    /// Thresholds for a rate of false alarms per hour, shared between both tests. Every block is a test, and tests count as
    /// independent: the rate is an upper bound for noise as in the prefix.
    pub fn thresholds(&self, false_alarms_per_hour: f64) -> Thresholds {
        // Bonferroni: the expected number of false alarms of all blocks and both tests is the stated one.
        let tests = 3600.0 / BLOCK_S;
        let each = (false_alarms_per_hour / 2.0 / tests).min(0.01);
        Thresholds {
            level: hotelling(each, self.dof[0]),
            abrupt: hotelling(each, self.dof[1]),
            back: hotelling(BACK_SHARE, self.dof[0]),
        }
    }
}

/// Parts that a prefix is judged in, the fewest windows that one must have, and the largest ratio of their variances: of 37 windows each,
/// noise alone reaches 6 less than once in a million prefixes.
const PREFIX_PARTS: usize = 4;
const MIN_PART_WINDOWS: usize = 20;
const MAX_VARIANCE_RATIO: f64 = 6.0;

/// Largest variance of level windows over what the blocks' own jitter explains: five times the standard deviation is motion, not noise.
const MAX_SLOW_RATIO: f64 = 25.0;

/// Whether a prefix is noise alone: its parts and the whole have similar variances about their own lines, and no slow variation beyond the
/// noise. A constant contact cannot be detected. A prefix too short to be divided is accepted.
pub fn quiet(blocks: &[Block]) -> bool {
    let size = blocks.len() / PREFIX_PARTS;
    if size < MIN_PART_WINDOWS * LEVEL_BLOCKS {
        return true;
    }
    let mean_square =
        |vs: &[Vector2<f64>]| vs.iter().map(Vector2::norm_squared).sum::<f64>() / vs.len() as f64;
    // The whole as well: a ramp over one part is a line there and has no residual.
    let parts = blocks.chunks_exact(size).chain([blocks]);
    let variances = parts.map(|part| mean_square(&windows(&detrended(part).2)));
    let (low, high) = variances.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    let jitter: Vec<Vector2<f64>> = blocks.windows(2).map(|w| w[1].moment - w[0].moment).collect();
    high < MAX_VARIANCE_RATIO * low
        && high < MAX_SLOW_RATIO * mean_square(&jitter) / 2.0 / LEVEL_BLOCKS as f64
}

/// Mean and slope (1/s) of the moments, their residuals, and the middle (s) and squared spread (s^2) of the times.
fn detrended(blocks: &[Block]) -> (Vector2<f64>, Vector2<f64>, Vec<Vector2<f64>>, [f64; 2]) {
    let n = blocks.len() as f64;
    let middle_s = blocks.iter().map(|b| b.t_s).sum::<f64>() / n;
    let mean = blocks.iter().map(|b| b.moment).sum::<Vector2<f64>>() / n;
    let stt: f64 = blocks.iter().map(|b| (b.t_s - middle_s).powi(2)).sum();
    let slope = blocks.iter().map(|b| (b.moment - mean) * (b.t_s - middle_s)).sum::<Vector2<f64>>() / stt;
    let left = blocks.iter().map(|b| b.moment - mean - slope * (b.t_s - middle_s)).collect();
    (mean, slope, left, [middle_s, stt])
}

/// Means of level windows.
fn windows(left: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    left.chunks_exact(LEVEL_BLOCKS).map(|c| c.iter().sum::<Vector2<f64>>() / LEVEL_BLOCKS as f64).collect()
}

/// Mean of the last [`BLOCKS_AFTER`] blocks less what the line through the [`BLOCKS_BEFORE`] blocks before them predicts.
pub fn contrast(blocks: &[Block]) -> Vector2<f64> {
    let (before, after) = blocks.split_at(BLOCKS_BEFORE);
    let n = before.len() as f64;
    let half = (n - 1.0) / 2.0;
    let mean = before.iter().map(|b| b.moment).sum::<Vector2<f64>>() / n;
    let slope = before.iter().enumerate().map(|(k, b)| b.moment * (k as f64 - half)).sum::<Vector2<f64>>()
        / (n * (n * n - 1.0) / 12.0);
    let ahead = half + (after.len() as f64 + 1.0) / 2.0;
    after.iter().map(|b| b.moment).sum::<Vector2<f64>>() / after.len() as f64 - mean - slope * ahead
}

/// Squared distance of `v` by a covariance.
pub fn distance(v: &Vector2<f64>, covariance: &Matrix2<f64>) -> f64 {
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| (v.transpose() * inverse * v)[0])
}

/// Limit that chi-square with 4 degrees of freedom passes with probability `p`: (1 + x/2) exp(-x/2) = p.
pub fn chi2_4(p: f64) -> f64 {
    let mut x = -2.0 * p.ln();
    for _ in 0..30 {
        x = -2.0 * (p / (1.0 + x / 2.0)).ln();
    }
    x
}
