//! The network's layers, for whole courses and for streams.

use super::{Attended, dense, fused};
use crate::TrackError;
use crate::bayes::Filters;
use burn::module::Module;
use burn::nn::{Dropout, DropoutConfig, Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};

/// Size and kind of the network.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Inputs of a token.
    pub inputs: usize,
    /// Knots on the static inverse's curve; 0: the place itself comes out (the paper's head).
    pub nodes: usize,
    /// Hidden width of the encoder.
    pub encoder: usize,
    /// Layers, heads, width and hidden width of the feed-forward part.
    pub layers: usize,
    /// See `layers`.
    pub heads: usize,
    /// See `layers`.
    pub width: usize,
    /// See `layers`.
    pub feed_forward: usize,
    /// Dropout.
    pub dropout: f64,
    /// Tokens that an answer may look back on, its own included.
    pub context: usize,
    /// Whether there is a second filter below it, which it weighs against the first.
    #[serde(default)]
    pub two_filters: bool,
}

impl NetworkConfig {
    /// The paper's network (six layers, eight heads, width 128, 512, encoder 64, dropout 0.1).
    #[must_use]
    pub fn paper(inputs: usize) -> Self {
        Self {
            inputs,
            nodes: 0,
            encoder: 64,
            layers: 6,
            heads: 8,
            width: 128,
            feed_forward: 512,
            dropout: 0.1,
            context: 128,
            two_filters: false,
        }
    }

    /// The default network on a curve of `nodes` knots, by one filter or two.
    #[must_use]
    pub fn small(inputs: usize, nodes: usize, two_filters: bool) -> Self {
        Self {
            inputs,
            nodes,
            encoder: 128,
            layers: 3,
            heads: 6,
            width: 96,
            feed_forward: 256,
            dropout: 0.0,
            context: 128,
            two_filters,
        }
    }

    /// A transformer of 40 thousand parameters that sees moments, their rates, time step and the base's speed, and nothing of the rod.
    #[must_use]
    pub fn baseline() -> Self {
        Self {
            inputs: super::features::COMMON,
            nodes: 0,
            encoder: 32,
            layers: 2,
            heads: 4,
            width: 48,
            feed_forward: 96,
            dropout: 0.0,
            context: 128,
            two_filters: false,
        }
    }

    /// Whether it takes nothing of the rod's curve and the filter.
    #[must_use]
    pub fn plain(&self) -> bool {
        self.nodes == 0 && self.inputs <= super::features::COMMON
    }

    /// # Errors
    /// Where the sizes do not fit each other.
    pub fn check(&self) -> Result<(), TrackError> {
        let sizes = [self.inputs, self.encoder, self.layers, self.heads, self.width, self.feed_forward];
        if sizes.contains(&0) || self.context < 2 || !self.width.is_multiple_of(self.heads) {
            return Err(TrackError::value(
                "network",
                "sizes above 0, width a multiple of heads",
                format!("{self:?}"),
            ));
        }
        Ok(())
    }

    /// # Errors
    /// Where it weighs two filters and there is one, or the other way round.
    pub fn check_filters(&self, filters: &Filters) -> Result<(), TrackError> {
        if self.two_filters != filters.beside.is_some() {
            let found = if self.two_filters { "one" } else { "two" };
            return Err(TrackError::value("filters below the network", "as many as it weighs", found));
        }
        Ok(())
    }

    /// Numbers that come out for a token: logarithms of factors at the knots, a place (or what is off it), contact, several contacts, and
    /// with knots the doubt in the filter, and with two of them the logarithm of the odds of the second.
    #[must_use]
    pub fn outputs(&self) -> usize {
        let with_knots = if self.nodes > 0 { 1 + usize::from(self.two_filters) } else { 0 };
        self.nodes + 3 + 2 + with_knots
    }
}

/// One layer: attention and feed-forward part, each after a normalisation.
#[derive(Module, Debug)]
pub struct Block {
    before_attention: LayerNorm,
    query_key_value: Linear,
    out: Linear,
    before_feed: LayerNorm,
    widen: Linear,
    narrow: Linear,
}

/// The network.
#[derive(Module, Debug)]
pub struct WhiskerNet {
    encode: Linear,
    encode_out: Linear,
    blocks: Vec<Block>,
    norm: LayerNorm,
    head: Linear,
    dropout: Dropout,
    heads: usize,
}

/// Outputs of a batch: `[batch, time, outputs]`.
pub type Output = Tensor<3>;

/// An answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Probability of contact.
    pub contact: f32,
    /// Probability of several, where there is one.
    pub several: f32,
    /// Mean place, base frame, mm.
    pub point_mm: [f32; 3],
    /// Covariance before calibration, mm^2.
    pub covariance_mm2: [[f32; 3]; 3],
    /// Weights of the nodes.
    pub weights: Vec<f32>,
    /// Direction of the force on the wire, the object's outward normal; 0 where the network's head does not tell.
    pub normal: [f32; 3],
}

impl WhiskerNet {
    /// With weights drawn from the device's seed.
    ///
    /// # Errors
    /// Where the sizes do not fit each other.
    pub fn new(config: &NetworkConfig, device: &Device) -> Result<Self, TrackError> {
        config.check()?;
        let c = config;
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        let norm = || LayerNormConfig::new(c.width).init(device);
        let block = |_| Block {
            before_attention: norm(),
            query_key_value: linear(c.width, 3 * c.width),
            out: linear(c.width, c.width),
            before_feed: norm(),
            widen: linear(c.width, c.feed_forward),
            narrow: linear(c.feed_forward, c.width),
        };
        Ok(Self {
            encode: linear(c.inputs, c.encoder),
            encode_out: linear(c.encoder, c.width),
            blocks: (0..c.layers).map(block).collect(),
            norm: norm(),
            // Small: what comes out at first is the filter's own belief.
            head: LinearConfig::new(c.width, c.outputs())
                .with_initializer(Initializer::Normal { mean: 0.0, std: 0.01 })
                .init(device),
            dropout: DropoutConfig::new(c.dropout).init(),
            heads: c.heads,
        })
    }

    /// A batch of courses: inputs `[batch, time, inputs]`, bias of attention `[batch, heads, time, time]` (`attention_bias`).
    #[must_use]
    pub fn forward(&self, inputs: Tensor<3>, bias: Tensor<4>) -> Output {
        let mut x = dense::linear(&self.encode_out, fused::gelu(dense::linear(&self.encode, inputs)));
        for block in &self.blocks {
            let normed = fused::norm(&block.before_attention, x.clone());
            let qkv = dense::linear(&block.query_key_value, normed);
            let attended = if fused::fits(&qkv, self.width(), self.heads) {
                fused::attend(qkv, bias.clone(), self.heads)
            } else {
                let (q, k, v) = self.split(qkv);
                attend(q, k, v, bias.clone())
            };
            x = dense::dropped(&self.dropout, x, dense::linear(&block.out, attended));
            x = dense::dropped(&self.dropout, x.clone(), block.feed(x));
        }
        dense::linear(&self.head, fused::norm(&self.norm, x))
    }

    fn width(&self) -> usize {
        self.encode_out.weight.dims()[1]
    }

    /// One token of a stream, inputs `[1, 1, inputs]`; what was attended is remembered up to `context` tokens.
    pub fn step(&self, inputs: Tensor<3>, t_s: f64, context: usize, memory: &mut Attended) -> Output {
        let device = inputs.device();
        memory.arrive(t_s, context);
        let mut x = dense::linear(&self.encode_out, fused::gelu(dense::linear(&self.encode, inputs)));
        for (layer, block) in self.blocks.iter().enumerate() {
            let normed = fused::norm(&block.before_attention, x.clone());
            let qkv = numbers(dense::linear(&block.query_key_value, normed));
            let attended = memory.attend(layer, &qkv, self.heads);
            let attended = Tensor::from_data(TensorData::new(attended, [1, 1, self.width()]), &device);
            x = x + dense::linear(&block.out, attended);
            x = x.clone() + block.feed(x);
        }
        dense::linear(&self.head, fused::norm(&self.norm, x))
    }

    /// Queries, keys and values by head: `[batch, heads, time, width / heads]`.
    fn split(&self, x: Tensor<3>) -> (Tensor<4>, Tensor<4>, Tensor<4>) {
        let [batch, time, three] = x.dims();
        let width = three / 3;
        let part = |k: usize| {
            let part = x.clone().narrow(2, k * width, width);
            part.reshape([batch, time, self.heads, width / self.heads]).swap_dims(1, 2)
        };
        (part(0), part(1), part(2))
    }
}

impl Block {
    fn feed(&self, x: Tensor<3>) -> Tensor<3> {
        let widened = dense::linear(&self.widen, fused::norm(&self.before_feed, x));
        dense::linear(&self.narrow, fused::gelu(widened))
    }
}

/// Scaled dot products with a bias, `[batch, time, width]`.
fn attend(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>, bias: Tensor<4>) -> Tensor<3> {
    let [batch, heads, time, width] = q.dims();
    let scores = q.matmul(k.swap_dims(2, 3)) / (width as f64).sqrt() + bias;
    softmax(scores, 3).matmul(v).swap_dims(1, 2).reshape([batch, time, heads * width])
}

/// Fall of attention with time, 1/s, a head: relative positions by time itself, so that the rate of sampling does not matter
/// (linear biases: O. Press et al., ICLR 2022).
pub(super) fn slope(head: usize, heads: usize) -> f32 {
    4.0 * 0.02_f32.powf(head as f32 / (heads.max(2) - 1) as f32)
}

/// Bias of attention for courses with these times (s): later tokens and those beyond the context are out of sight.
#[must_use]
pub fn attention_bias(times_s: &[Vec<f64>], heads: usize, context: usize, device: &Device) -> Tensor<4> {
    let (batch, n) = (times_s.len(), times_s.first().map_or(0, Vec::len));
    let mut bias = Vec::with_capacity(batch * heads * n * n);
    for times in times_s {
        for head in 0..heads {
            let slope = slope(head, heads);
            for (i, now) in times.iter().enumerate() {
                bias.extend(times.iter().enumerate().map(|(j, then)| {
                    let seen = j <= i && i - j < context;
                    if seen { slope * (then - now) as f32 } else { HIDDEN }
                }));
            }
        }
    }
    Tensor::from_data(TensorData::new(bias, [batch, heads, n, n]), device)
}

/// Bias of what is out of sight: its weight is 0 in single precision.
const HIDDEN: f32 = -1e9;

/// A tensor's numbers in order.
pub(crate) fn numbers<const D: usize>(out: Tensor<D>) -> Vec<f32> {
    out.into_data().try_into_vec().unwrap_or_default()
}
