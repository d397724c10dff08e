//! Attention of a stream's last token over those that it remembers: keys and values of earlier
//! tokens are kept, so that a token costs one row.
//!
//! `o = sum_j p_j v_j`, `p_j ~ exp(q . k_j / sqrt(d) - a (t - t_j))` over the last `context`
//! tokens: the last row of what attention over the whole series gives. The slope a of head h of H
//! is `4 * 0.02^(h / (H - 1))` 1/s: attention falls with the age of a token, in each head at
//! another rate. Source: O. Press, N. A. Smith, M. Lewis, "Train Short, Test Long: Attention with
//! Linear Biases", ICLR 2022.

/// Fall of attention with time, 1/s, a head: relative positions by time itself, so that the rate of
/// sampling does not matter.
pub fn time_bias_slope(head: usize, heads: usize) -> f32 {
    4.0 * 0.02_f32.powf(head as f32 / (heads.max(2) - 1) as f32)
}

/// What a stream remembers: keys and values by layer, and the tokens' times, s.
#[derive(Debug, Clone, Default)]
pub struct KvCache {
    kept: Vec<LayerCache>,
    times_s: Vec<f64>,
}

/// Keys and values of a layer, `[time, width]`; masked tokens lead them, and are dropped now and
/// then.
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

    /// Values of the last token, weighted over the tokens in the cache, from its queries, keys and
    /// values `[3 width]`.
    pub(super) fn attend(&mut self, layer: usize, qkv: &[f32], heads: usize) -> Vec<f32> {
        let width = qkv.len() / 3;
        if self.kept.len() <= layer {
            self.kept.resize_with(layer + 1, LayerCache::default);
        }
        let LayerCache { keys, values } = &mut self.kept[layer];
        let seen = self.times_s.len() * width;
        for (all, new) in [&mut *keys, &mut *values]
            .into_iter()
            .zip(qkv[width..].chunks_exact(width))
        {
            all.extend_from_slice(new);
            // Dropped at twice the need: one move of the memory for many tokens.
            if all.len() > 2 * seen.max(MIN_KEPT * width) {
                all.drain(..all.len() - seen);
            }
        }
        let now = self.times_s.last().copied().unwrap_or_default();
        let ages_s: Vec<f32> = self.times_s.iter().map(|t| (now - t) as f32).collect();
        let (keys, values) = (&keys[keys.len() - seen..], &values[values.len() - seen..]);
        let mut out = vec![0.0; width];
        let of_head = width / heads;
        for (head, out) in out.chunks_exact_mut(of_head).enumerate() {
            let part = head * of_head..(head + 1) * of_head;
            let (query, slope) = (&qkv[part.clone()], time_bias_slope(head, heads));
            // Scaled dot product, less the bias by the token's age.
            let score = |(key, age_s): (&[f32], &f32)| {
                let product: f32 = query
                    .iter()
                    .zip(&key[part.clone()])
                    .map(|(q, k)| q * k)
                    .sum();
                product / (of_head as f32).sqrt() - slope * age_s
            };
            let mut weights: Vec<f32> = keys.chunks_exact(width).zip(&ages_s).map(score).collect();
            // Softmax, the maximum subtracted against overflow.
            let largest = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            weights.iter_mut().for_each(|w| *w = (*w - largest).exp());
            let total: f32 = weights.iter().sum();
            for (weight, value) in weights.iter().zip(values.chunks_exact(width)) {
                out.iter_mut()
                    .zip(&value[part.clone()])
                    .for_each(|(o, v)| *o += weight / total * v);
            }
        }
        out
    }
}

/// Tokens below which nothing is dropped.
const MIN_KEPT: usize = 16;
