//! Attention of a stream's last token over those that it remembers: keys and values of earlier tokens are kept, so that a token costs one row.
//!
//! `o = sum_j p_j v_j`, `p_j ~ exp(q . k_j / sqrt(d) - a (t - t_j))` over the last `context` tokens: the last row of `attention`.

use super::attention_bias::time_bias_slope;
use super::kernels::{exp, sum};
use super::widest::{Kernel, Simd, mul_add, widest};

/// What a stream remembers: keys and values by layer, and the tokens' times, s.
#[derive(Debug, Clone, Default)]
pub struct KvCache {
    kept: Vec<LayerCache>,
    times_s: Vec<f64>,
}

/// Keys and values of a layer, `[time, width]`; masked tokens lead them, and are dropped now and then.
#[derive(Debug, Clone, Default)]
struct LayerCache {
    keys: Vec<f32>,
    values: Vec<f32>,
}

impl KvCache {
    /// Appends a token; the one `context` tokens back is masked from now on.
    pub(super) fn advance(&mut self, t_s: f64, context: usize) {
        self.times_s.push(t_s);
        let out_of_sight = self.times_s.len().saturating_sub(context);
        self.times_s.drain(..out_of_sight);
    }

    /// Values of the last token, weighted over the tokens in the cache, from its queries, keys and values `[3 width]`.
    pub(super) fn attend(&mut self, layer: usize, qkv: &[f32], heads: usize) -> Vec<f32> {
        let width = qkv.len() / 3;
        if self.kept.len() <= layer {
            self.kept.resize_with(layer + 1, LayerCache::default);
        }
        let LayerCache { keys, values } = &mut self.kept[layer];
        let seen = self.times_s.len() * width;
        for (all, new) in [&mut *keys, &mut *values].into_iter().zip(qkv[width..].chunks_exact(width)) {
            all.extend_from_slice(new);
            if all.len() > 2 * seen.max(MIN_KEPT * width) {
                all.drain(..all.len() - seen);
            }
        }
        let now = self.times_s.last().copied().unwrap_or_default();
        widest(LastQuery {
            heads,
            query: &qkv[..width],
            keys: &keys[keys.len() - seen..],
            values: &values[values.len() - seen..],
            ages_s: self.times_s.iter().map(|t| (now - t) as f32).collect(),
            weights: vec![0.0; self.times_s.len()],
            out: vec![0.0; width],
        })
    }
}

/// Tokens below which nothing is dropped.
const MIN_KEPT: usize = 16;

/// The last token's query over all keys.
struct LastQuery<'a> {
    heads: usize,
    query: &'a [f32],
    keys: &'a [f32],
    values: &'a [f32],
    ages_s: Vec<f32>,
    /// Room for a head's weights.
    weights: Vec<f32>,
    out: Vec<f32>,
}

impl Kernel for LastQuery<'_> {
    type Out = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<f32> {
        let Self { heads, query, keys, values, ages_s, mut weights, mut out } = self;
        let width = query.len();
        let of_head = width / heads;
        let scale = 1.0 / (of_head as f32).sqrt();
        for head in 0..heads {
            let (from, to) = (head * of_head, (head + 1) * of_head);
            let (query, slope) = (&query[from..to], time_bias_slope(head, heads));
            let mut largest = f32::NEG_INFINITY;
            for ((weight, key), age_s) in weights.iter_mut().zip(keys.chunks_exact(width)).zip(&ages_s) {
                let product = sum(simd, [query, &key[from..to]], |q, k| simd.mul_f32s(q, k), |q, k| q * k);
                *weight = mul_add::<S>(product, scale, -slope * age_s);
                largest = largest.max(*weight);
            }
            weights.iter_mut().for_each(|w| *w = exp::<S>(*w - largest));
            let each = 1.0 / weights.iter().sum::<f32>();
            let out = &mut out[from..to];
            for (weight, value) in weights.iter().zip(values.chunks_exact(width)) {
                let share = weight * each;
                for (out, value) in out.iter_mut().zip(&value[from..to]) {
                    *out = mul_add::<S>(*value, share, *out);
                }
            }
        }
        out
    }
}
