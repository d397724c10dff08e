//! The network as it is trained: the layers of `wcal_network::network::model` as tensors with
//! gradients.

mod attention_bias;
mod model;

pub use attention_bias::attention_bias;
pub use model::{Output, TrainableNet};
