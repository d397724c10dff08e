//! Causal attention in one pass, with its gradient, on plain slices.
//!
//! ```text
//! p_ij = exp(s_ij) / sum_j exp(s_ij),   s_ij = q_i . k_j / sqrt(d) + b_ij,   j <= i;   o_i = sum_j p_ij v_j
//! dv_j = sum_i p_ij do_i,   ds_ij = p_ij (do_i . v_j - sum_l p_il do_i . v_l),   dq_i = sum_j ds_ij k_j / sqrt(d),   dk_j likewise
//! ```
//!
//! Sources: A. Vaswani et al., "Attention Is All You Need", 2017; the tiling is that of T. Dao et al., "FlashAttention", 2022. A few queries at
//! a time go over all keys: each key and value is loaded once for all of them. Keys, values and weights come in blocks as wide as a vector;
//! what is beyond the diagonal or the end has the weight 0. Loops instead of arrays' `map`, whose closures the compiler leaves outside, for the
//! oldest processor.

use super::kernels::exp;
use super::widest::{Kernel, Simd, widest};
use rayon::prelude::*;

/// Widest head, and the tokens of a block.
pub(super) const MAX_HEAD: usize = 16;
/// Queries that go together.
const TILE: usize = 4;

type Lanes = [f32; MAX_HEAD];

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

    fn scale(&self) -> f32 {
        1.0 / (self.head() as f32).sqrt()
    }
}

/// What one head of one series works on.
struct Head {
    sizes: Sizes,
    /// Queries, keys and values by block, a row each token, 0 beyond the last.
    rows: [Vec<[Lanes; MAX_HEAD]>; 3],
    /// Keys and values of a block of tokens by feature.
    keys: Vec<[Lanes; MAX_HEAD]>,
    values: Vec<[Lanes; MAX_HEAD]>,
    /// Of the tile's queries by block: weights of the softmax, and gradients by its scores.
    weights: Vec<[Lanes; TILE]>,
    d_scores: Vec<[Lanes; TILE]>,
}

/// A row of features with 0 behind them.
#[inline(always)]
fn padded(features: &[f32]) -> Lanes {
    let mut row = [0.0; MAX_HEAD];
    match <&Lanes>::try_from(features) {
        Ok(whole) => row = *whole,
        Err(_) => row.iter_mut().zip(features).for_each(|(to, x)| *to = *x),
    }
    row
}

/// Writes the features of a padded row.
#[inline(always)]
fn unpadded(to: &mut [f32], row: &Lanes) {
    match <&mut Lanes>::try_from(&mut *to) {
        Ok(whole) => *whole = *row,
        Err(_) => to.iter_mut().zip(row).for_each(|(to, x)| *to = *x),
    }
}

/// Bias of a block of keys, of which the first `seen.len()` are seen.
#[inline(always)]
fn biased(seen: &[f32], block: usize) -> Lanes {
    let from = block * MAX_HEAD;
    let mut lanes = [f32::NEG_INFINITY; MAX_HEAD];
    match seen.get(from..from + MAX_HEAD).and_then(|whole| <&Lanes>::try_from(whole).ok()) {
        Some(whole) => lanes = *whole,
        None => lanes.iter_mut().zip(seen.iter().skip(from)).for_each(|(to, x)| *to = *x),
    }
    lanes
}

/// The processor's vectors in a row.
#[inline(always)]
fn vectors<S: Simd>(row: &Lanes) -> &[S::f32s] {
    S::as_simd_f32s(row).0
}

#[inline(always)]
fn vectors_mut<S: Simd>(row: &mut Lanes) -> &mut [S::f32s] {
    S::as_mut_simd_f32s(row).0
}

/// One number for a row, by an operation between vectors and one within a vector.
#[inline(always)]
fn reduce<S: Simd>(
    simd: S,
    row: &Lanes,
    between: impl Fn(S, S::f32s, S::f32s) -> S::f32s,
    within: impl Fn(S, S::f32s) -> f32,
) -> f32 {
    let vectors = vectors::<S>(row);
    let mut all = vectors[0];
    for vector in &vectors[1..] {
        all = between(simd, all, *vector);
    }
    within(simd, all)
}

/// Vector `v` of each row.
#[inline(always)]
fn load<S: Simd>(rows: &[Lanes; TILE], v: usize) -> [S::f32s; TILE] {
    let of = |r: usize| vectors::<S>(&rows[r])[v];
    [of(0), of(1), of(2), of(3)]
}

/// Adds to each query's sixteen numbers the products of its features with sixteen tokens' (rows the features), or of its weights with
/// sixteen tokens' features (rows the tokens).
#[inline(always)]
fn add_products<S: Simd>(simd: S, onto: &mut [Lanes; TILE], by: &[Lanes; TILE], rows: &[Lanes; MAX_HEAD]) {
    for v in 0..MAX_HEAD / S::F32_LANES {
        let mut sums = load::<S>(onto, v);
        for k in 0..MAX_HEAD {
            let row = vectors::<S>(&rows[k])[v];
            for r in 0..TILE {
                sums[r] = simd.mul_add_e_f32s(simd.splat_f32s(by[r][k]), row, sums[r]);
            }
        }
        for r in 0..TILE {
            vectors_mut::<S>(&mut onto[r])[v] = sums[r];
        }
    }
}

/// Adds to sixteen rows each query's weights of them times the query's row.
#[inline(always)]
fn add_outer<S: Simd>(simd: S, onto: &mut [Lanes; MAX_HEAD], weights: &[Lanes; TILE], rows: &[Lanes; TILE]) {
    for v in 0..MAX_HEAD / S::F32_LANES {
        let rows = load::<S>(rows, v);
        for k in 0..MAX_HEAD {
            let onto = &mut vectors_mut::<S>(&mut onto[k])[v];
            let mut sum = *onto;
            for r in 0..TILE {
                sum = simd.mul_add_e_f32s(simd.splat_f32s(weights[r][k]), rows[r], sum);
            }
            *onto = sum;
        }
    }
}

impl Head {
    fn new(sizes: Sizes) -> Self {
        let blocks = sizes.time.div_ceil(MAX_HEAD);
        Self {
            sizes,
            rows: [0; 3].map(|_| vec![[[0.0; MAX_HEAD]; MAX_HEAD]; blocks]),
            keys: vec![[[0.0; MAX_HEAD]; MAX_HEAD]; blocks],
            values: vec![[[0.0; MAX_HEAD]; MAX_HEAD]; blocks],
            weights: vec![[[0.0; MAX_HEAD]; TILE]; blocks],
            d_scores: vec![[[0.0; MAX_HEAD]; TILE]; blocks],
        }
    }

    #[inline(always)]
    fn take(&mut self, head: usize, qkv: &[f32]) {
        let (d, width) = (self.sizes.head(), self.sizes.width);
        for (which, rows) in self.rows.iter_mut().enumerate() {
            let from = which * width + head * d;
            for (row, to) in qkv.chunks_exact(3 * width).zip(rows.as_flattened_mut()) {
                *to = padded(&row[from..from + d]);
            }
        }
        let [_, keys, values] = &self.rows;
        let blocks = keys.iter().zip(&mut self.keys).chain(values.iter().zip(&mut self.values));
        for (rows, turned) in blocks {
            for (k, turned) in turned.iter_mut().enumerate() {
                for (to, row) in turned.iter_mut().zip(rows) {
                    *to = row[k];
                }
            }
        }
    }

    /// Rows of the tile that begins with `first`; what is beyond the last is 0.
    #[inline(always)]
    fn queries(&self, first: usize) -> [Lanes; TILE] {
        let mut queries = [[0.0; MAX_HEAD]; TILE];
        for (query, row) in queries.iter_mut().zip(self.rows[0].as_flattened().iter().skip(first)) {
            *query = *row;
        }
        queries
    }

    /// Weights of a tile's queries, not normalised, in `weights`; gives what each sums up to, and the blocks that are seen.
    #[inline(always)]
    fn scores<S: Simd>(&mut self, simd: S, first: usize, bias: &[f32]) -> ([f32; TILE], usize) {
        let time = self.sizes.time;
        let end = (first + TILE).min(time);
        let blocks = end.div_ceil(MAX_HEAD);
        let scale = self.sizes.scale();
        let mut queries = self.queries(first);
        queries.as_flattened_mut().iter_mut().for_each(|q| *q *= scale);
        let mut seen: [&[f32]; TILE] = [&[]; TILE];
        for (i, seen) in (first..end).zip(&mut seen) {
            *seen = &bias[i * time..=i * time + i];
        }
        let mut largest = [[f32::NEG_INFINITY; MAX_HEAD]; TILE];
        for (block, (weights, keys)) in self.weights[..blocks].iter_mut().zip(&self.keys).enumerate() {
            for (weights, seen) in weights.iter_mut().zip(&seen) {
                *weights = biased(seen, block);
            }
            add_products(simd, weights, &queries, keys);
            for v in 0..MAX_HEAD / S::F32_LANES {
                for (largest, weights) in largest.iter_mut().zip(&*weights) {
                    let largest = &mut vectors_mut::<S>(largest)[v];
                    *largest = simd.max_f32s(*largest, vectors::<S>(weights)[v]);
                }
            }
        }
        let mut totals = [0.0; TILE];
        for r in 0..TILE {
            // What is beyond the end has seen nothing.
            let largest = reduce(simd, &largest[r], S::max_f32s, S::reduce_max_f32s).max(f32::MIN);
            let mut sums = [0.0_f32; MAX_HEAD];
            for weights in &mut self.weights[..blocks] {
                for (w, sum) in weights[r].iter_mut().zip(&mut sums) {
                    *w = exp::<S>(*w - largest);
                    *sum += *w;
                }
            }
            totals[r] = reduce(simd, &sums, S::add_f32s, S::reduce_sum_f32s);
        }
        (totals, blocks)
    }
}

/// One series: answers, queries with keys and values, bias.
struct Attend<'a> {
    head: Head,
    out: &'a mut [f32],
    qkv: &'a [f32],
    bias: &'a [f32],
}

impl Kernel for Attend<'_> {
    type Out = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { mut head, out, qkv, bias } = self;
        let Sizes { heads, time, width } = head.sizes;
        let d = head.sizes.head();
        for (number, bias) in (0..heads).zip(bias.chunks_exact(time * time)) {
            head.take(number, qkv);
            for first in (0..time).step_by(TILE) {
                let (totals, blocks) = head.scores(simd, first, bias);
                let mut mixed = [[0.0_f32; MAX_HEAD]; TILE];
                for (weights, values) in head.weights[..blocks].iter().zip(&head.rows[2]) {
                    add_products(simd, &mut mixed, weights, values);
                }
                for (r, i) in (first..time.min(first + TILE)).enumerate() {
                    let each = 1.0 / totals[r];
                    mixed[r].iter_mut().for_each(|m| *m *= each);
                    unpadded(&mut out[i * width + number * d..][..d], &mixed[r]);
                }
            }
        }
    }
}

/// Causal attention: queries, keys and values `[batch, time, 3 width]` side by side, bias `[batch, heads, time, time]` of which the part
/// up to the diagonal counts; gives `[batch, time, width]`.
pub(super) fn attend(sizes: Sizes, qkv: &[f32], bias: &[f32]) -> Vec<f32> {
    let Sizes { heads, time, width } = sizes;
    let mut out = vec![0.0; qkv.len() / 3];
    out.par_chunks_mut(time * width)
        .zip(qkv.par_chunks(3 * time * width))
        .zip(bias.par_chunks(heads * time * time))
        .for_each(|((out, qkv), bias)| widest(Attend { head: Head::new(sizes), out, qkv, bias }));
    out
}

/// One series: gradients by queries, keys and values; those, bias, and the gradient of the answer.
struct AttendBack<'a> {
    head: Head,
    out: &'a mut [f32],
    qkv: &'a [f32],
    bias: &'a [f32],
    grad: &'a [f32],
    by: [Vec<[Lanes; MAX_HEAD]>; 3],
}

impl Kernel for AttendBack<'_> {
    type Out = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { mut head, out, qkv, bias, grad, mut by } = self;
        let Sizes { heads, time, width } = head.sizes;
        let d = head.sizes.head();
        for (number, bias) in (0..heads).zip(bias.chunks_exact(time * time)) {
            head.take(number, qkv);
            by.iter_mut().for_each(|rows| rows.as_flattened_mut().fill([0.0; MAX_HEAD]));
            for first in (0..time).step_by(TILE) {
                let (totals, blocks) = head.scores(simd, first, bias);
                let mut out_grads = [[0.0; MAX_HEAD]; TILE];
                for (i, backward) in (first..time).zip(&mut out_grads) {
                    *backward = padded(&grad[i * width + number * d..][..d]);
                }
                head.backward(simd, blocks, &totals, &out_grads);
                let queries = head.queries(first);
                let mut by_queries = [[0.0_f32; MAX_HEAD]; TILE];
                let [_, by_keys, by_values] = &mut by;
                let seen = head.weights[..blocks].iter().zip(&head.d_scores).zip(&head.rows[1]);
                for (((weights, d_scores), keys), (by_keys, by_values)) in
                    seen.zip(by_keys.iter_mut().zip(by_values))
                {
                    add_products(simd, &mut by_queries, d_scores, keys);
                    add_outer(simd, by_keys, d_scores, &queries);
                    add_outer(simd, by_values, weights, &out_grads);
                }
                let rows = by[0].as_flattened_mut()[first..].iter_mut().zip(by_queries);
                rows.for_each(|(row, by_query)| *row = by_query);
            }
            for (t, out) in out.chunks_exact_mut(3 * width).enumerate() {
                for (which, by) in by.iter().enumerate() {
                    unpadded(&mut out[which * width + number * d..][..d], &by[t / MAX_HEAD][t % MAX_HEAD]);
                }
            }
        }
    }
}

impl Head {
    /// Normalises a tile's weights, and writes the gradients by the scores into `d_scores`: ds = p (dp - sum p dp).
    #[inline(always)]
    fn backward<S: Simd>(&mut self, simd: S, blocks: usize, totals: &[f32; TILE], out_grads: &[Lanes; TILE]) {
        let scale = self.sizes.scale();
        let mut row_dots = [[0.0_f32; MAX_HEAD]; TILE];
        let tiles = self.weights[..blocks].iter_mut().zip(&mut self.d_scores);
        for ((weights, d_scores), values) in tiles.zip(&self.values) {
            *d_scores = [[0.0; MAX_HEAD]; TILE];
            add_products(simd, d_scores, out_grads, values);
            for r in 0..TILE {
                let each = simd.splat_f32s(if totals[r] > 0.0 { 1.0 / totals[r] } else { 0.0 });
                for v in 0..MAX_HEAD / S::F32_LANES {
                    let weight = &mut vectors_mut::<S>(&mut weights[r])[v];
                    *weight = simd.mul_f32s(*weight, each);
                    let row_dot = &mut vectors_mut::<S>(&mut row_dots[r])[v];
                    *row_dot = simd.mul_add_e_f32s(*weight, vectors::<S>(&d_scores[r])[v], *row_dot);
                }
            }
        }
        for r in 0..TILE {
            let row_dot = simd.splat_f32s(reduce(simd, &row_dots[r], S::add_f32s, S::reduce_sum_f32s));
            for (weights, d_scores) in self.weights[..blocks].iter().zip(&mut self.d_scores) {
                for v in 0..MAX_HEAD / S::F32_LANES {
                    let d_score = &mut vectors_mut::<S>(&mut d_scores[r])[v];
                    let scaled = simd.mul_f32s(simd.splat_f32s(scale), vectors::<S>(&weights[r])[v]);
                    *d_score = simd.mul_f32s(scaled, simd.sub_f32s(*d_score, row_dot));
                }
            }
        }
    }
}

/// Gradient of `attend` by queries, keys and values. The weights are made again: that is cheaper than to keep them.
pub(super) fn attend_back(sizes: Sizes, qkv: &[f32], bias: &[f32], grad: &[f32]) -> Vec<f32> {
    let Sizes { heads, time, width } = sizes;
    let mut out = vec![0.0; qkv.len()];
    out.par_chunks_mut(3 * time * width)
        .zip(qkv.par_chunks(3 * time * width))
        .zip(bias.par_chunks(heads * time * time))
        .zip(grad.par_chunks(time * width))
        .for_each(|(((out, qkv), bias), grad)| {
            let head = Head::new(sizes);
            let by = [0; 3].map(|_| vec![[[0.0; MAX_HEAD]; MAX_HEAD]; head.keys.len()]);
            widest(AttendBack { head, out, qkv, bias, grad, by });
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plain_processor_gives_what_the_widest_vectors_give() {
        let sizes = Sizes { heads: 2, time: 21, width: 24 };
        let numbers = |n: usize, step: f32| (0..n).map(|k| (k as f32 * step).sin()).collect::<Vec<f32>>();
        let (qkv, bias) = (numbers(21 * 72, 0.7), numbers(2 * 21 * 21, 0.3));
        let (wide, mut plain) = (attend(sizes, &qkv, &bias), vec![0.0; 21 * 24]);
        Attend { head: Head::new(sizes), out: &mut plain, qkv: &qkv, bias: &bias }.run(pulp::Scalar::new());
        let off = wide.iter().zip(&plain).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let largest = wide.iter().map(|x| x.abs()).fold(0.0, f32::max);
        assert!(off < 1e-5 && largest > 0.1, "{off} {largest}");
    }
}
