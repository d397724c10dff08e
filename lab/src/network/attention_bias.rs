//! Bias of the attention: relative positions by time.
//!
//! `b_ij = a_h (t_j - t_i)` for the last `context` tokens j <= i, minus infinity for all others,
//! with the slope a_h of [`time_bias_slope`]. Source: O. Press, N. A. Smith, M. Lewis, "Train
//! Short, Test Long: Attention with Linear Biases", ICLR 2022.

use burn::tensor::{Device, Tensor, TensorData};
use wcal_network::network::time_bias_slope;

/// Bias of attention for series with these times (s): later tokens and those beyond the context are
/// masked.
pub fn attention_bias(
    times_s: &[Vec<f64>],
    heads: usize,
    context: usize,
    device: &Device,
) -> Tensor<4> {
    let (batch, n) = (times_s.len(), times_s.first().map_or(0, Vec::len));
    let mut bias = Vec::with_capacity(batch * heads * n * n);
    for times in times_s {
        for head in 0..heads {
            let slope = time_bias_slope(head, heads);
            for (i, now) in times.iter().enumerate() {
                bias.extend(times.iter().enumerate().map(|(j, then)| {
                    let seen = j <= i && i - j < context;
                    if seen {
                        slope * (then - now) as f32
                    } else {
                        MASKED
                    }
                }));
            }
        }
    }
    Tensor::from_data(TensorData::new(bias, [batch, heads, n, n]), device)
}

/// Bias of masked tokens: their weight is 0 in single precision.
const MASKED: f32 = -1e9;
