//! The network's layers for batches of whole series, with gradients.

use crate::LabError;
use burn::module::Module;
use burn::nn::{
    Dropout, DropoutConfig, Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig,
};
use burn::tensor::activation::gelu;
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Device, Tensor};
use wcal_network::network::NetworkConfig;

/// One layer: attention and feed-forward part, each after a normalisation.
#[derive(Module, Debug)]
pub(crate) struct Block {
    before_attention: LayerNorm,
    query_key_value: Linear,
    out: Linear,
    before_feed: LayerNorm,
    widen: Linear,
    narrow: Linear,
}

/// The network.
#[derive(Module, Debug)]
pub struct TrainableNet {
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

impl TrainableNet {
    /// With weights drawn from the device's seed.
    ///
    /// # Errors
    /// Where the sizes do not fit each other.
    pub fn new(config: &NetworkConfig, device: &Device) -> Result<Self, LabError> {
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
                .with_initializer(Initializer::Normal {
                    mean: 0.0,
                    std: 0.01,
                })
                .init(device),
            dropout: DropoutConfig::new(c.dropout).init(),
            heads: c.heads,
        })
    }

    /// A batch of series: inputs `[batch, time, inputs]`, bias of attention
    /// `[batch, heads, time, time]` (`attention_bias`).
    pub fn forward(&self, inputs: Tensor<3>, bias: Tensor<4>) -> Output {
        let mut x = self.encoded(inputs);
        for block in &self.blocks {
            let [batch, time, width] = x.dims();
            let qkv = block
                .query_key_value
                .forward(block.before_attention.forward(x.clone()));
            let (q, k, v) = self.split(qkv);
            let attended = attention(
                q,
                k,
                v,
                None,
                Some(bias.clone()),
                AttentionModuleOptions::default(),
            );
            let attended = attended.swap_dims(1, 2).reshape([batch, time, width]);
            x = x + self.dropout.forward(block.out.forward(attended));
            x = x.clone() + self.dropout.forward(block.feed(x));
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
            part.reshape([batch, time, self.heads, width / self.heads])
                .swap_dims(1, 2)
        };
        (part(0), part(1), part(2))
    }
}

impl Block {
    fn feed(&self, x: Tensor<3>) -> Tensor<3> {
        self.narrow
            .forward(gelu(self.widen.forward(self.before_feed.forward(x))))
    }
}
