//! Attention, normalisation and GELU in one pass each, with their gradients, on plain slices.
//!
//! Written out of small tensor operations these three move some twenty times the memory that they need. Loops are compiled for the widest
//! vectors that the processor has (`pulp`). A closure that is run under it owns what it changes: one that borrows it is called through a
//! shim, which stays outside and is compiled for the oldest processor.

use rayon::prelude::*;

/// Widest head.
pub(super) const MOST: usize = 16;
/// As in `LayerNormConfig`.
pub(super) const EPSILON: f32 = 1e-5;
/// Rows of one task.
const ROWS: usize = 256;

/// Added and taken off again, it leaves a whole number.
const ROUNDS: f32 = 12_582_912.0;

/// Product and sum, each rounded: `mul_add` is a call where the compiler does not know of the processor's fused one.
trait TimesPlus {
    fn times_plus(self, factor: f32, summand: f32) -> f32;
}

impl TimesPlus for f32 {
    #[inline(always)]
    fn times_plus(self, factor: f32, summand: f32) -> f32 {
        self * factor + summand
    }
}

/// Sizes of an attention.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    pub heads: usize,
    pub time: usize,
    pub width: usize,
}

impl Sizes {
    fn head(&self) -> usize {
        self.width / self.heads
    }
}

/// exp(x) to two units in the last place; 0 below the range of single precision.
#[inline(always)]
fn exp(x: f32) -> f32 {
    let y = x.clamp(-87.3, 88.0);
    // Rounds to a whole number: single precision has no more digits up there.
    let n = (y * std::f32::consts::LOG2_E + ROUNDS) - ROUNDS;
    let r = n.times_plus(-0.693_359_4, y);
    let r = n.times_plus(2.121_944_4e-4, r);
    let mut p = 1.987_569_1e-4_f32;
    for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        p = p.times_plus(r, c);
    }
    let p = (p * r).times_plus(r, r) + 1.0;
    let scaled = p * f32::from_bits(((n as i32 + 127) << 23) as u32);
    if x < -87.3 { 0.0 } else { scaled }
}

/// Normal distribution function and density (M. Abramowitz, I. A. Stegun, 7.1.26: off by 1.5e-7 at most).
#[inline(always)]
fn normal(x: f32) -> (f32, f32) {
    let bell = exp(-0.5 * x * x);
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / z.times_plus(0.327_591_1, 1.0);
    let mut p = 1.061_405_4_f32;
    for c in [-1.453_152_1, 1.421_413_8, -0.284_496_72, 0.254_829_6] {
        p = p.times_plus(t, c);
    }
    let tail = 0.5 * p * t * bell;
    (if x < 0.0 { tail } else { 1.0 - tail }, 0.398_942_3 * bell)
}

/// x times the normal distribution function.
pub(super) fn gelu(x: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; x.len()];
    let task = |(out, x): (&mut [f32], &[f32])| {
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || out.iter_mut().zip(x).for_each(|(o, x)| *o = x * normal(*x).0),
        );
    };
    out.par_chunks_mut(ROWS * ROWS).zip(x.par_chunks(ROWS * ROWS)).for_each(task);
    out
}

/// Gradient of `gelu` over that of its answer.
pub(super) fn gelu_back(x: &[f32], mut grad: Vec<f32>) -> Vec<f32> {
    let task = |(out, x): (&mut [f32], &[f32])| {
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                out.iter_mut().zip(x).for_each(|(o, x)| {
                    let (share, density) = normal(*x);
                    *o *= x.times_plus(density, share);
                });
            },
        );
    };
    grad.par_chunks_mut(ROWS * ROWS).zip(x.par_chunks(ROWS * ROWS)).for_each(task);
    grad
}

#[inline(always)]
fn sum(values: impl Fn(usize) -> f32, n: usize) -> f32 {
    // Sixteen sums: one alone would wait for itself.
    let mut lanes = [0.0_f32; MOST];
    let whole = n / MOST * MOST;
    for from in (0..whole).step_by(MOST) {
        for (k, lane) in lanes.iter_mut().enumerate() {
            *lane += values(from + k);
        }
    }
    lanes.iter().sum::<f32>() + (whole..n).map(values).sum::<f32>()
}

/// Mean and inverse spread of a row.
#[inline(always)]
fn spread(row: &[f32]) -> (f32, f32) {
    let n = row.len();
    let mean = sum(|k| row[k], n) / n as f32;
    let variance = sum(|k| (row[k] - mean) * (row[k] - mean), n) / n as f32;
    (mean, 1.0 / (variance + EPSILON).sqrt())
}

/// Rows normalised, times `gamma`, plus `beta`.
pub(super) fn layer_norm(x: &[f32], gamma: &[f32], beta: &[f32]) -> Vec<f32> {
    let width = gamma.len();
    let mut out = vec![0.0; x.len()];
    let task = |(out, x): (&mut [f32], &[f32])| {
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for (out, x) in out.chunks_exact_mut(width).zip(x.chunks_exact(width)) {
                    let (mean, rate) = spread(x);
                    for k in 0..width {
                        out[k] = ((x[k] - mean) * rate).times_plus(gamma[k], beta[k]);
                    }
                }
            },
        );
    };
    out.par_chunks_mut(ROWS * width).zip(x.par_chunks(ROWS * width)).for_each(task);
    out
}

/// Gradients of `layer_norm` by x, gamma and beta.
pub(super) fn layer_norm_back(x: &[f32], gamma: &[f32], grad: &[f32]) -> [Vec<f32>; 3] {
    let width = gamma.len();
    let mut by_x = vec![0.0; x.len()];
    let task = |((by_x, x), grad): ((&mut [f32], &[f32]), &[f32])| {
        let by = (vec![0.0_f32; width], vec![0.0_f32; width]);
        let rows = (vec![0.0_f32; width], vec![0.0_f32; width]);
        pulp::Arch::new().dispatch(
            #[inline(always)]
            move || {
                let (mut by, (mut normed, mut pulled)) = (by, rows);
                let rows = by_x.chunks_exact_mut(width).zip(x.chunks_exact(width));
                for ((by_x, x), grad) in rows.zip(grad.chunks_exact(width)) {
                    let (mean, rate) = spread(x);
                    for k in 0..width {
                        normed[k] = (x[k] - mean) * rate;
                        pulled[k] = grad[k] * gamma[k];
                        by.0[k] += grad[k] * normed[k];
                        by.1[k] += grad[k];
                    }
                    let level = sum(|k| pulled[k], width) / width as f32;
                    let tilt = sum(|k| pulled[k] * normed[k], width) / width as f32;
                    for k in 0..width {
                        by_x[k] = rate * (pulled[k] - level - normed[k] * tilt);
                    }
                }
                by
            },
        )
    };
    let parts: Vec<(Vec<f32>, Vec<f32>)> = by_x
        .par_chunks_mut(ROWS * width)
        .zip(x.par_chunks(ROWS * width))
        .zip(grad.par_chunks(ROWS * width))
        .map(task)
        .collect();
    let mut sums = [vec![0.0; width], vec![0.0; width]];
    for (gamma, beta) in &parts {
        sums[0].iter_mut().zip(gamma).for_each(|(s, x)| *s += x);
        sums[1].iter_mut().zip(beta).for_each(|(s, x)| *s += x);
    }
    let [by_gamma, by_beta] = sums;
    [by_x, by_gamma, by_beta]
}

/// What one head of one course works on: rows of `MOST`, and the same turned, with room for whole vectors.
struct Head {
    part: [Vec<[f32; MOST]>; 3],
    turned_keys: Vec<Lanes>,
    turned_values: Vec<Lanes>,
    weights: Vec<f32>,
    slopes: Vec<f32>,
}

/// Sixteen tokens' numbers of each feature.
type Lanes = [[f32; MOST]; MOST];

impl Head {
    fn new(time: usize) -> Self {
        let blocks = time.div_ceil(MOST);
        Self {
            part: [0; 3].map(|_| vec![[0.0; MOST]; time]),
            turned_keys: vec![[[0.0; MOST]; MOST]; blocks],
            turned_values: vec![[[0.0; MOST]; MOST]; blocks],
            weights: vec![0.0; blocks * MOST],
            slopes: vec![0.0; blocks * MOST],
        }
    }

    #[inline(always)]
    fn take(&mut self, sizes: Sizes, head: usize, qkv: &[f32]) {
        let d = sizes.head();
        for t in 0..sizes.time {
            for (which, part) in self.part.iter_mut().enumerate() {
                let from = t * 3 * sizes.width + which * sizes.width + head * d;
                part[t][..d].copy_from_slice(&qkv[from..from + d]);
            }
            for k in 0..d {
                self.turned_keys[t / MOST][k][t % MOST] = self.part[1][t][k];
                self.turned_values[t / MOST][k][t % MOST] = self.part[2][t][k];
            }
        }
    }

    /// Weights of row `i`, not normalised, and their sum; 0 beyond it up to the end of its vector.
    #[inline(always)]
    fn weigh(&mut self, i: usize, bias: &[f32], scale: f32) -> f32 {
        let n = i + 1;
        let weights = &mut self.weights[..n.next_multiple_of(MOST)];
        weights[..n].copy_from_slice(&bias[..n]);
        weights[n..].fill(f32::NEG_INFINITY);
        let query = self.part[0][i].map(|q| q * scale);
        let mut lanes = [f32::NEG_INFINITY; MOST];
        for (block, keys) in weights.chunks_exact_mut(MOST).zip(&self.turned_keys) {
            dots(block, &query, keys);
            for (lane, w) in lanes.iter_mut().zip(block) {
                *lane = lane.max(*w);
            }
        }
        let most = lanes.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let mut sums = [0.0_f32; MOST];
        for block in weights.chunks_exact_mut(MOST) {
            for (sum, w) in sums.iter_mut().zip(block) {
                *w = exp(*w - most);
                *sum += *w;
            }
        }
        sums.iter().sum()
    }
}

/// Adds to each of sixteen the products of its features with `by`: all of it in registers.
#[inline(always)]
fn dots(onto: &mut [f32], by: &[f32; MOST], features: &Lanes) {
    let mut sums = [0.0_f32; MOST];
    sums.copy_from_slice(onto);
    for (b, feature) in by.iter().zip(features) {
        for (s, f) in sums.iter_mut().zip(feature) {
            *s = b.times_plus(*f, *s);
        }
    }
    onto.copy_from_slice(&sums);
}

/// Causal attention: queries, keys and values `[batch, time, 3 width]` side by side, bias `[batch, heads, time, time]` of which the part
/// up to the diagonal counts; gives `[batch, time, width]`.
pub(super) fn attend(sizes: Sizes, qkv: &[f32], bias: &[f32]) -> Vec<f32> {
    let Sizes { heads, time, width } = sizes;
    let d = sizes.head();
    let scale = 1.0 / (d as f32).sqrt();
    let mut out = vec![0.0; qkv.len() / 3];
    let task = |((out, qkv), bias): ((&mut [f32], &[f32]), &[f32])| {
        let h = Head::new(time);
        pulp::Arch::new().dispatch(
            #[inline(always)]
            move || {
                let mut h = h;
                for head in 0..heads {
                    h.take(sizes, head, qkv);
                    for i in 0..time {
                        let total = h.weigh(i, &bias[(head * time + i) * time..], scale);
                        let mut mixed = [0.0_f32; MOST];
                        for (w, value) in h.weights[..=i].iter().zip(&h.part[2]) {
                            for k in 0..MOST {
                                mixed[k] = w.times_plus(value[k], mixed[k]);
                            }
                        }
                        let to = &mut out[i * width + head * d..i * width + (head + 1) * d];
                        to.iter_mut().zip(&mixed).for_each(|(o, m)| *o = m / total);
                    }
                }
            },
        );
    };
    out.par_chunks_mut(time * width)
        .zip(qkv.par_chunks(3 * time * width))
        .zip(bias.par_chunks(heads * time * time))
        .for_each(task);
    out
}

/// A sequence's share of the gradient, its queries, keys and values, its bias and the gradient of its answer.
type Share<'a> = (((&'a mut [f32], &'a [f32]), &'a [f32]), &'a [f32]);

/// Gradient of `attend` by queries, keys and values. The weights are made again: that is cheaper than to keep them.
pub(super) fn attend_back(sizes: Sizes, qkv: &[f32], bias: &[f32], grad: &[f32]) -> Vec<f32> {
    let Sizes { heads, time, width } = sizes;
    let d = sizes.head();
    let scale = 1.0 / (d as f32).sqrt();
    let mut out = vec![0.0; qkv.len()];
    let task = |(((out, qkv), bias), grad): Share<'_>| {
        let h = Head::new(time);
        let back = [0; 3].map(|_| vec![[0.0_f32; MOST]; time]);
        pulp::Arch::new().dispatch(
            #[inline(always)]
            move || {
                let (mut h, mut back) = (h, back);
                for head in 0..heads {
                    h.take(sizes, head, qkv);
                    back.iter_mut().flatten().for_each(|row| *row = [0.0; MOST]);
                    for i in 0..time {
                        let n = i + 1;
                        let total = h.weigh(i, &bias[(head * time + i) * time..], scale);
                        let mut pull = [0.0_f32; MOST];
                        let from = i * width + head * d;
                        pull[..d].copy_from_slice(&grad[from..from + d]);
                        let slopes = &mut h.slopes[..n.next_multiple_of(MOST)];
                        slopes.fill(0.0);
                        for (block, values) in slopes.chunks_exact_mut(MOST).zip(&h.turned_values) {
                            dots(block, &pull, values);
                        }
                        let weights = &mut h.weights[..n];
                        let each = 1.0 / total;
                        weights.iter_mut().for_each(|w| *w *= each);
                        let level = sum(|j| weights[j] * slopes[j], n);
                        for j in 0..n {
                            slopes[j] = scale * weights[j] * (slopes[j] - level);
                        }
                        let query = h.part[0][i];
                        let mut by_query = [0.0_f32; MOST];
                        let [_, by_keys, by_values] = &mut back;
                        for j in 0..n {
                            let (w, s, key) = (weights[j], slopes[j], &h.part[1][j]);
                            let (by_key, by_value) = (&mut by_keys[j], &mut by_values[j]);
                            for k in 0..MOST {
                                by_query[k] = s.times_plus(key[k], by_query[k]);
                                by_key[k] = s.times_plus(query[k], by_key[k]);
                                by_value[k] = w.times_plus(pull[k], by_value[k]);
                            }
                        }
                        back[0][i] = by_query;
                    }
                    for t in 0..time {
                        for (which, back) in back.iter().enumerate() {
                            let to = t * 3 * width + which * width + head * d;
                            out[to..to + d].copy_from_slice(&back[t][..d]);
                        }
                    }
                }
            },
        );
    };
    out.par_chunks_mut(3 * time * width)
        .zip(qkv.par_chunks(3 * time * width))
        .zip(bias.par_chunks(heads * time * time))
        .zip(grad.par_chunks(time * width))
        .for_each(task);
    out
}
