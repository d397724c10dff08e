//! Noise of the beginning of a stream in which nothing touches.
//!
//! On means over 2 ms, b_k, about their own line:
//!
//! ```text
//! S = sum (b_k - line_k) (b_k - line_k)^T / (n - 2)        covariance of a block
//! ```

use nalgebra::{Matrix2, Vector2};

/// Length of a block: samples are averaged over it before anything is judged, s. A 250 Hz ring
/// still passes.
pub const BLOCK_S: f64 = 0.002;
/// Blocks of a window in which a slow variation shows.
const WINDOW_BLOCKS: usize = 10;
/// Fewer blocks say nothing of noise.
const MIN_BLOCKS: usize = 280;

/// A mean over [`BLOCK_S`]: middle of its time, s, and moments, N mm.
#[derive(Debug, Clone, Copy)]
struct Block {
    t_s: f64,
    moment: Vector2<f64>,
}

/// Learns the noise from the beginning of a stream; a hole or a touch in it puts it off.
#[derive(Debug, Clone)]
pub struct Prefix {
    length_s: f64,
    per_block: usize,
    /// Count, and sums of time and moments, of the block at hand.
    sum: (usize, f64, Vector2<f64>),
    blocks: Vec<Block>,
    block_nmm2: Option<Matrix2<f64>>,
}

impl Prefix {
    /// A prefix of this length (s), still to be seen, of moments at this rate (Hz).
    pub fn new(length_s: f64, rate_hz: f64) -> Self {
        Self {
            length_s,
            per_block: ((BLOCK_S * rate_hz).round() as usize).max(1),
            sum: (0, 0.0, Vector2::zeros()),
            blocks: Vec::new(),
            block_nmm2: None,
        }
    }

    /// Covariance of a block, (N mm)^2, once the prefix is over.
    pub fn block_nmm2(&self) -> Option<Matrix2<f64>> {
        self.block_nmm2
    }

    /// The stream was interrupted: a prefix with a hole is none.
    pub fn gap(&mut self) {
        self.sum = (0, 0.0, Vector2::zeros());
        self.blocks.clear();
    }

    /// Takes a sample: time (s) and moments (N mm).
    pub fn push(&mut self, t_s: f64, moment_nmm: [f64; 2]) {
        let (n, t, m) = self.sum;
        self.sum = (n + 1, t + t_s, m + Vector2::from(moment_nmm));
        if n + 1 < self.per_block {
            return;
        }
        let (n, t, m) = std::mem::replace(&mut self.sum, (0, 0.0, Vector2::zeros()));
        self.blocks.push(Block {
            t_s: t / n as f64,
            moment: m / n as f64,
        });
        if self.blocks[self.blocks.len() - 1].t_s - self.blocks[0].t_s < self.length_s {
            return;
        }
        if !quiet(&self.blocks) {
            // Something happened in it: the prefix begins later.
            self.blocks.drain(..self.blocks.len() / 4);
            return;
        }
        self.block_nmm2 = covariance(&self.blocks);
        if self.block_nmm2.is_some() {
            self.blocks = Vec::new();
        }
    }
}

/// Covariance of a block about the line; none where there are too few or one axis does not vary at
/// all.
fn covariance(blocks: &[Block]) -> Option<Matrix2<f64>> {
    if blocks.len() < MIN_BLOCKS {
        return None;
    }
    // Mean and slope are two numbers an axis that the blocks paid for.
    let sum = detrended(blocks)
        .iter()
        .map(|v| v * v.transpose())
        .sum::<Matrix2<f64>>();
    Some(sum / (blocks.len() as f64 - 2.0)).filter(|m| m.determinant() > 1e-30)
}

/// Parts that a prefix is judged in, the fewest windows that one must have, and the largest ratio
/// of their variances: of 37 windows each, noise alone reaches 6 less than once in a million
/// prefixes.
const PREFIX_PARTS: usize = 4;
const MIN_PART_WINDOWS: usize = 20;
const MAX_VARIANCE_RATIO: f64 = 6.0;

/// Largest variance of windows over what the blocks' own jitter explains: five times the standard
/// deviation is motion, not noise.
const MAX_SLOW_RATIO: f64 = 25.0;

/// Whether a prefix is noise alone: its parts and the whole have similar variances about their own
/// lines, and no slow variation beyond the noise. A constant contact cannot be detected. A prefix
/// too short to be divided is accepted.
fn quiet(blocks: &[Block]) -> bool {
    let size = blocks.len() / PREFIX_PARTS;
    if size < MIN_PART_WINDOWS * WINDOW_BLOCKS {
        return true;
    }
    let mean_square =
        |vs: &[Vector2<f64>]| vs.iter().map(Vector2::norm_squared).sum::<f64>() / vs.len() as f64;
    // The whole as well: a ramp over one part is a line there and has no residual.
    let parts = blocks.chunks_exact(size).chain([blocks]);
    let variances = parts.map(|part| mean_square(&windows(&detrended(part))));
    let (low, high) = variances.fold((f64::INFINITY, 0.0_f64), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    // Differences of neighbours have twice the noise's variance and nothing of what is slow.
    let jitter: Vec<Vector2<f64>> = blocks
        .windows(2)
        .map(|w| w[1].moment - w[0].moment)
        .collect();
    high < MAX_VARIANCE_RATIO * low
        && high < MAX_SLOW_RATIO * mean_square(&jitter) / 2.0 / WINDOW_BLOCKS as f64
}

/// What the moments leave about their own line.
fn detrended(blocks: &[Block]) -> Vec<Vector2<f64>> {
    let n = blocks.len() as f64;
    let middle_s = blocks.iter().map(|b| b.t_s).sum::<f64>() / n;
    let mean = blocks.iter().map(|b| b.moment).sum::<Vector2<f64>>() / n;
    let stt: f64 = blocks.iter().map(|b| (b.t_s - middle_s).powi(2)).sum();
    // Least squares: drift of the zero is no noise of a block.
    let slope = blocks
        .iter()
        .map(|b| (b.moment - mean) * (b.t_s - middle_s))
        .sum::<Vector2<f64>>()
        / stt;
    blocks
        .iter()
        .map(|b| b.moment - mean - slope * (b.t_s - middle_s))
        .collect()
}

/// Means of windows.
fn windows(left: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    left.chunks_exact(WINDOW_BLOCKS)
        .map(|c| c.iter().sum::<Vector2<f64>>() / WINDOW_BLOCKS as f64)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const RATE_HZ: f64 = 2000.0;
    const SD_NMM: f64 = 0.002;

    /// SIMULATED: white noise with a drift; a touch of 0.5 s at `touched_s`, scans missing at
    /// `gap_s`. Covariance, and when it was known.
    fn learnt(touched_s: Option<f64>, gap_s: Option<f64>) -> (Matrix2<f64>, f64) {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut prefix = Prefix::new(2.0, RATE_HZ);
        for k in 0..20_000 {
            let t_s = f64::from(k) / RATE_HZ;
            let within = |from: Option<f64>| from.is_some_and(|f| (f..f + 0.5).contains(&t_s));
            if within(gap_s) {
                prefix.gap();
                continue;
            }
            let level = if within(touched_s) { 0.2 } else { 1e-3 * t_s };
            prefix.push(
                t_s,
                [0, 1].map(|_| {
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    level + SD_NMM * noise
                }),
            );
            if let Some(found) = prefix.block_nmm2() {
                return (found, t_s);
            }
        }
        panic!("no quiet prefix in 10 s");
    }

    #[test]
    fn the_noise_is_that_of_the_free_wire_and_what_happens_in_the_prefix_puts_it_off() {
        // Four samples a block: half of the samples' standard deviation.
        let right = |m: &Matrix2<f64>| {
            [0, 1]
                .iter()
                .all(|k| (m[(*k, *k)].sqrt() / (SD_NMM / 2.0) - 1.0).abs() < 0.1)
        };
        let (free, at_s) = learnt(None, None);
        assert!(right(&free) && (at_s - 2.0).abs() < 0.02, "{free} {at_s}");
        let (touched, at_s) = learnt(Some(1.0), None);
        assert!(right(&touched) && at_s > 3.0, "{touched} {at_s}");
        let (cut, at_s) = learnt(None, Some(1.0));
        assert!(right(&cut) && (at_s - 3.5).abs() < 0.02, "{cut} {at_s}");
    }
}
