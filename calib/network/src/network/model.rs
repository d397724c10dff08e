//! The network's layers on a stream, row by row; the weights are those that `wcal-lab train`
//! writes.
//!
//! ```text
//! linear      y = W^T x + b,  W [inputs, outputs]
//! norm        y = (x - mean x) / sqrt(var x + 1e-5) gamma + beta
//! GELU        x Phi(x),  Phi the normal distribution
//! block       x += out(attend(qkv(norm x)));  x += narrow(gelu(widen(norm x)))
//! network     head(norm(blocks(encode_out(gelu(encode x)))))
//! ```
//!
//! Sources: arXiv 2410.14005, section III; J. L. Ba et al., arXiv 1607.06450 (norm); D. Hendrycks,
//! K. Gimpel, arXiv 1606.08415 (GELU).

use super::config::NetworkConfig;
use super::kv_cache::KvCache;
use crate::error::NetworkError;
use safetensors::{Dtype, SafeTensors};
use statrs::function::erf::erf;

/// Added to the variance of a norm, as in training.
const NORM_EPSILON: f32 = 1e-5;

/// Weights `[inputs, outputs]`, row by row, and biases.
#[derive(Debug, Clone)]
struct Linear {
    weights: Vec<f32>,
    bias: Vec<f32>,
}

/// Scale and shift of a norm.
#[derive(Debug, Clone)]
struct LayerNorm {
    gamma: Vec<f32>,
    beta: Vec<f32>,
}

/// One layer: attention and feed-forward part, each after a normalisation.
#[derive(Debug, Clone)]
struct Block {
    before_attention: LayerNorm,
    query_key_value: Linear,
    out: Linear,
    before_feed: LayerNorm,
    widen: Linear,
    narrow: Linear,
}

/// The network.
#[derive(Debug, Clone)]
pub struct WhiskerNet {
    encode: Linear,
    encode_out: Linear,
    blocks: Vec<Block>,
    norm: LayerNorm,
    head: Linear,
    heads: usize,
}

/// An answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Probability of contact.
    pub contact: f32,
    /// Probability of several contacts, where there is contact.
    pub several: f32,
    /// Mean place, base frame, mm.
    pub point_mm: [f32; 3],
    /// Covariance, mm^2.
    pub covariance_mm2: [[f32; 3]; 3],
    /// Weights of the nodes.
    pub weights: Vec<f32>,
    /// Direction of the force on the wire, the object's outward normal; 0 where the network's head
    /// does not state it.
    pub normal: [f32; 3],
}

impl Prediction {
    /// Of a contact of which nothing but that it is there is known.
    pub fn unknown() -> Self {
        Self {
            contact: 1.0,
            several: 0.0,
            point_mm: [0.0; 3],
            covariance_mm2: [[0.0; 3]; 3],
            weights: Vec::new(),
            normal: [0.0; 3],
        }
    }
}

impl WhiskerNet {
    /// Of the bytes of `model.safetensors`.
    ///
    /// # Errors
    /// Names the tensor that is missing, of another type or size, or not finite.
    pub fn read(config: &NetworkConfig, bytes: &[u8]) -> Result<Self, NetworkError> {
        config.check()?;
        let weights = SafeTensors::deserialize(bytes).map_err(|e| {
            NetworkError::value("weights", "a file in the safetensors format", e.to_string())
        })?;
        let weights = Weights(&weights);
        let c = config;
        let block = |k: usize| {
            let name = |part: &str| format!("blocks.{k}.{part}");
            Ok(Block {
                before_attention: weights.norm(&name("before_attention"), c.width)?,
                query_key_value: weights.linear(&name("query_key_value"), c.width, 3 * c.width)?,
                out: weights.linear(&name("out"), c.width, c.width)?,
                before_feed: weights.norm(&name("before_feed"), c.width)?,
                widen: weights.linear(&name("widen"), c.width, c.feed_forward)?,
                narrow: weights.linear(&name("narrow"), c.feed_forward, c.width)?,
            })
        };
        Ok(Self {
            encode: weights.linear("encode", c.inputs, c.encoder)?,
            encode_out: weights.linear("encode_out", c.encoder, c.width)?,
            blocks: (0..c.layers)
                .map(block)
                .collect::<Result<_, NetworkError>>()?,
            norm: weights.norm("norm", c.width)?,
            head: weights.linear("head", c.width, c.outputs())?,
            heads: c.heads,
        })
    }

    /// Outputs for the next token of a stream; keys and values are cached for up to `context`
    /// tokens.
    pub fn step(&self, inputs: &[f32], t_s: f64, context: usize, cache: &mut KvCache) -> Vec<f32> {
        cache.advance(t_s, context);
        let mut x = self.encode_out.forward(&gelu(self.encode.forward(inputs)));
        for (layer, block) in self.blocks.iter().enumerate() {
            let qkv = block
                .query_key_value
                .forward(&block.before_attention.forward(&x));
            add(
                &mut x,
                &block.out.forward(&cache.attend(layer, &qkv, self.heads)),
            );
            let widened = gelu(block.widen.forward(&block.before_feed.forward(&x)));
            add(&mut x, &block.narrow.forward(&widened));
        }
        self.head.forward(&self.norm.forward(&x))
    }
}

impl Linear {
    fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut y = self.bias.clone();
        let outputs = y.len();
        // Four inputs at a time: the sum is read and written a quarter as often.
        let (fours, rest) = (x.chunks_exact(4), x.chunks_exact(4).remainder());
        let (rows, last) = self.weights.split_at((x.len() - rest.len()) * outputs);
        for (x, rows) in fours.zip(rows.chunks_exact(4 * outputs)) {
            let (first, second) = rows.split_at(2 * outputs);
            let ((a, b), (c, d)) = (first.split_at(outputs), second.split_at(outputs));
            let columns = a.iter().zip(b).zip(c.iter().zip(d));
            for (y, ((a, b), (c, d))) in y.iter_mut().zip(columns) {
                *y += (x[0] * a + x[1] * b) + (x[2] * c + x[3] * d);
            }
        }
        for (x, row) in rest.iter().zip(last.chunks_exact(outputs)) {
            y.iter_mut().zip(row).for_each(|(y, w)| *y += x * w);
        }
        y
    }
}

impl LayerNorm {
    fn forward(&self, x: &[f32]) -> Vec<f32> {
        let n = x.len() as f32;
        let mean = x.iter().sum::<f32>() / n;
        // Biased variance, as in training.
        let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / n;
        let scale = (variance + NORM_EPSILON).sqrt().recip();
        let each = x.iter().zip(self.gamma.iter().zip(&self.beta));
        each.map(|(x, (gamma, beta))| (x - mean) * scale * gamma + beta)
            .collect()
    }
}

fn gelu(mut x: Vec<f32>) -> Vec<f32> {
    for x in &mut x {
        *x *= 0.5 * (1.0 + erf(f64::from(*x) * std::f64::consts::FRAC_1_SQRT_2)) as f32;
    }
    x
}

fn add(x: &mut [f32], more: &[f32]) {
    x.iter_mut().zip(more).for_each(|(x, more)| *x += more);
}

/// Tensors of a file by name.
struct Weights<'a>(&'a SafeTensors<'a>);

impl Weights<'_> {
    fn linear(&self, name: &str, inputs: usize, outputs: usize) -> Result<Linear, NetworkError> {
        Ok(Linear {
            weights: self.numbers(&format!("{name}.weight"), &[inputs, outputs])?,
            bias: self.numbers(&format!("{name}.bias"), &[outputs])?,
        })
    }

    fn norm(&self, name: &str, width: usize) -> Result<LayerNorm, NetworkError> {
        Ok(LayerNorm {
            gamma: self.numbers(&format!("{name}.gamma"), &[width])?,
            beta: self.numbers(&format!("{name}.beta"), &[width])?,
        })
    }

    /// Numbers of a tensor, row by row; one that is no number would make every answer none.
    fn numbers(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, NetworkError> {
        let refused = |found: String| {
            let expected = format!("finite numbers of type F32 and sizes {shape:?}");
            NetworkError::value(format!("weights {name}"), expected, found)
        };
        let there = self.0.tensor(name).map_err(|e| refused(e.to_string()))?;
        if there.dtype() != Dtype::F32 || there.shape() != shape {
            return Err(refused(format!("{} {:?}", there.dtype(), there.shape())));
        }
        let (numbers, _) = there.data().as_chunks::<4>();
        let numbers: Vec<f32> = numbers
            .iter()
            .map(|four| f32::from_le_bytes(*four))
            .collect();
        match numbers.iter().position(|x| !x.is_finite()) {
            Some(k) => Err(refused(format!("NaN or infinity (number {})", k + 1))),
            None => Ok(numbers),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_layer_is_the_sum_over_its_inputs() {
        // Six inputs: one group of four and a rest of two.
        let weights: Vec<f32> = (0..18).map(|k| 0.1 * k as f32).collect();
        let layer = Linear {
            weights: weights.clone(),
            bias: vec![1.0, -1.0, 0.5],
        };
        let x = [0.3, -0.2, 0.7, 1.1, -0.9, 0.4];
        let found = layer.forward(&x);
        for (k, found) in found.iter().enumerate() {
            let sum: f32 = x
                .iter()
                .enumerate()
                .map(|(i, x)| x * weights[3 * i + k])
                .sum();
            assert!((found - (sum + layer.bias[k])).abs() < 1e-6, "{k}: {found}");
        }
    }

    #[test]
    fn a_norm_has_mean_and_spread_of_its_parameters_and_gelu_its_known_values() {
        let norm = LayerNorm {
            gamma: vec![2.0; 4],
            beta: vec![1.0; 4],
        };
        let y = norm.forward(&[3.0, 5.0, 7.0, 9.0]);
        let mean = y.iter().sum::<f32>() / 4.0;
        let sd = (y.iter().map(|y| (y - mean).powi(2)).sum::<f32>() / 4.0).sqrt();
        assert!(
            (mean - 1.0).abs() < 1e-6 && (sd - 2.0).abs() < 1e-5,
            "{y:?}"
        );
        // Phi(1) = 0.841345, Phi(-2) = 0.022750 (tables of the normal distribution).
        let y = gelu(vec![1.0, -2.0, 0.0]);
        assert!(
            (y[0] - 0.841_345).abs() < 1e-6 && (y[1] + 0.045_500).abs() < 1e-6 && y[2] == 0.0,
            "{y:?}"
        );
    }
}
