//! Noise of the no-contact prefix, and the thresholds that follow from it and a rate of false alarms.

use nalgebra::{Matrix2, Vector2};

/// Length of a block: samples are averaged over it before anything is judged, s. A 250 Hz ring still passes.
pub const BLOCK_S: f64 = 0.002;
/// Blocks of the window whose level is compared with the baseline.
pub const LEVEL: usize = 10;
/// Blocks before and after an abrupt change: a line through those before, the mean of those after.
pub const BEFORE: usize = 30;
/// See [`BEFORE`].
pub const AFTER: usize = 5;

/// A mean over [`BLOCK_S`]: middle of its time, s, and moments, N mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Block {
    /// Middle, s.
    pub t_s: f64,
    /// Mean, N mm.
    pub moment: Vector2<f64>,
}

/// What a no-contact prefix says of the noise.
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
#[must_use]
pub fn hotelling(p: f64, dof: f64) -> f64 {
    dof * (p.powf(-2.0 / (dof - 1.0)) - 1.0)
}

impl Noise {
    /// From the blocks of a prefix; `None` where there are too few or one axis does not vary at all.
    #[must_use]
    pub fn of(blocks: &[Block]) -> Option<Self> {
        let span = BEFORE + AFTER;
        if blocks.len() < 8 * span {
            return None;
        }
        let (mean, slope, flat, [middle_s, stt]) = flat(blocks);
        let spread = |vs: &[Vector2<f64>], lost: f64| {
            vs.iter().map(|v| v * v.transpose()).sum::<Matrix2<f64>>() / (vs.len() as f64 - lost)
        };
        let levels = windows(&flat);
        let contrasts: Vec<Vector2<f64>> =
            (span..=blocks.len()).step_by(AFTER).map(|end| contrast(&blocks[end - span..end])).collect();
        let level = spread(&levels, 2.0);
        let end_s = blocks.last()?.t_s;
        // Windows, not blocks: what is correlated must not make the slope look better known than it is.
        let slope_var = level * LEVEL as f64 / stt;
        let noise = Self {
            baseline: mean + slope * (end_s - middle_s),
            block: spread(&flat, 2.0),
            level,
            abrupt: spread(&contrasts, 0.0),
            // Contrasts overlap: they count as those that do not.
            dof: [levels.len() as f64 - 2.0, (blocks.len() / span) as f64],
            drift_nmm_s: slope.norm() + 2.0 * slope_var.trace().sqrt(),
        };
        let sound = [noise.block, noise.level, noise.abrupt].iter().all(|m| m.determinant() > 1e-30);
        sound.then_some(noise)
    }

    /// Thresholds for a rate of false alarms per hour, shared between both tests. Every block is a look, and looks are counted as
    /// independent: the rate is an upper bound for noise as in the prefix.
    #[must_use]
    pub fn thresholds(&self, false_alarms_per_hour: f64) -> Thresholds {
        let looks = 3600.0 / BLOCK_S;
        let each = (false_alarms_per_hour / 2.0 / looks).min(0.01);
        Thresholds {
            level: hotelling(each, self.dof[0]),
            abrupt: hotelling(each, self.dof[1]),
            back: hotelling(BACK_SHARE, self.dof[0]),
        }
    }
}

/// Parts that a prefix is judged in, the fewest windows that one must have, and the largest ratio of their variances: of 37 windows each,
/// noise alone reaches 6 less than once in a million prefixes.
const PARTS: usize = 4;
const PART_WINDOWS: usize = 20;
const ALIKE: f64 = 6.0;

/// Largest variance of level windows over what the blocks' own jitter explains: five times the standard deviation is motion, not noise.
const SLOW: f64 = 25.0;

/// Whether a prefix shows noise alone: its parts and the whole vary alike, each about its own line, and not more slowly than noise does. A contact that
/// does not change at all cannot be told. A prefix too short to be divided is taken as it is.
#[must_use]
pub fn quiet(blocks: &[Block]) -> bool {
    let size = blocks.len() / PARTS;
    if size < PART_WINDOWS * LEVEL {
        return true;
    }
    let mean_square =
        |vs: &[Vector2<f64>]| vs.iter().map(Vector2::norm_squared).sum::<f64>() / vs.len() as f64;
    // The whole as well: a ramp in one part is a line there.
    let parts = blocks.chunks_exact(size).chain([blocks]);
    let variances = parts.map(|part| mean_square(&windows(&flat(part).2)));
    let (low, high) = variances.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    let jitter: Vec<Vector2<f64>> = blocks.windows(2).map(|w| w[1].moment - w[0].moment).collect();
    high < ALIKE * low && high < SLOW * mean_square(&jitter) / 2.0 / LEVEL as f64
}

/// Mean and slope (1/s) of the moments, what is left of them, and the middle (s) and squared spread (s^2) of the times.
fn flat(blocks: &[Block]) -> (Vector2<f64>, Vector2<f64>, Vec<Vector2<f64>>, [f64; 2]) {
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
    left.chunks_exact(LEVEL).map(|c| c.iter().sum::<Vector2<f64>>() / LEVEL as f64).collect()
}

/// Mean of the last [`AFTER`] blocks less what the line through the [`BEFORE`] blocks before them foretells.
#[must_use]
pub fn contrast(blocks: &[Block]) -> Vector2<f64> {
    let (before, after) = blocks.split_at(BEFORE);
    let n = before.len() as f64;
    let half = (n - 1.0) / 2.0;
    let mean = before.iter().map(|b| b.moment).sum::<Vector2<f64>>() / n;
    let slope = before.iter().enumerate().map(|(k, b)| b.moment * (k as f64 - half)).sum::<Vector2<f64>>()
        / (n * (n * n - 1.0) / 12.0);
    let ahead = half + (after.len() as f64 + 1.0) / 2.0;
    after.iter().map(|b| b.moment).sum::<Vector2<f64>>() / after.len() as f64 - mean - slope * ahead
}

/// Squared distance of `v` by a covariance.
#[must_use]
pub fn distance(v: &Vector2<f64>, covariance: &Matrix2<f64>) -> f64 {
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| (v.transpose() * inverse * v)[0])
}

/// Limit that chi-square with 4 degrees of freedom passes with probability `p`: (1 + x/2) exp(-x/2) = p.
#[must_use]
pub fn chi2_4(p: f64) -> f64 {
    let mut x = -2.0 * p.ln();
    for _ in 0..30 {
        x = -2.0 * (p / (1.0 + x / 2.0)).ln();
    }
    x
}
