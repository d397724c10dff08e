//! The network's layers, for whole series and for streams.

use super::config::NetworkConfig;
use super::kv_cache::KvCache;
use crate::error::TrackError;
use burn::module::Module;
use burn::nn::{Dropout, DropoutConfig, Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::gelu;
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Device, Tensor, TensorData};

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
    /// Probability of several contacts, where there is contact.
    pub several: f32,
    /// Mean place, base frame, mm.
    pub point_mm: [f32; 3],
    /// Covariance before calibration, mm^2.
    pub covariance_mm2: [[f32; 3]; 3],
    /// Weights of the nodes.
    pub weights: Vec<f32>,
    /// Direction of the force on the wire, the object's outward normal; 0 where the network's head does not state it.
    pub normal: [f32; 3],
}

impl Prediction {
    /// Of a contact of which nothing but that it is there is known.
    #[must_use]
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

    /// A batch of series: inputs `[batch, time, inputs]`, bias of attention `[batch, heads, time, time]` (`attention_bias`).
    #[must_use]
    pub fn forward(&self, inputs: Tensor<3>, bias: Tensor<4>) -> Output {
        let mut x = self.encoded(inputs);
        for block in &self.blocks {
            let [batch, time, width] = x.dims();
            let qkv = block.query_key_value.forward(block.before_attention.forward(x.clone()));
            let (q, k, v) = self.split(qkv);
            let attended = attention(q, k, v, None, Some(bias.clone()), AttentionModuleOptions::default());
            let attended = attended.swap_dims(1, 2).reshape([batch, time, width]);
            x = x + self.dropout.forward(block.out.forward(attended));
            x = x.clone() + self.dropout.forward(block.feed(x));
        }
        self.head.forward(self.norm.forward(x))
    }

    /// One token of a stream, inputs `[1, 1, inputs]`; keys and values are cached for up to `context` tokens.
    pub fn step(&self, inputs: Tensor<3>, t_s: f64, context: usize, cache: &mut KvCache) -> Output {
        let device = inputs.device();
        cache.advance(t_s, context);
        let mut x = self.encoded(inputs);
        for (layer, block) in self.blocks.iter().enumerate() {
            let qkv = block.query_key_value.forward(block.before_attention.forward(x.clone()));
            let attended = cache.attend(layer, &to_vec(qkv), self.heads);
            let attended = Tensor::from_data(TensorData::new(attended, x.dims()), &device);
            x = x + block.out.forward(attended);
            x = x.clone() + block.feed(x);
        }
        self.head.forward(self.norm.forward(x))
    }

    fn encoded(&self, inputs: Tensor<3>) -> Tensor<3> {
        self.encode_out.forward(gelu(self.encode.forward(inputs)))
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
        self.narrow.forward(gelu(self.widen.forward(self.before_feed.forward(x))))
    }
}

/// A tensor's numbers in order.
pub(crate) fn to_vec<const D: usize>(out: Tensor<D>) -> Vec<f32> {
    out.into_data().try_into_vec().unwrap_or_default()
}
