//! The kernels as operations of burn, with their gradients.

use super::attention::{self, MAX_HEAD, Sizes};
use super::kernels;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, backend_extension};
use burn::nn::LayerNorm;
use burn::tensor::{Device, Tensor, TensorData};

/// The kernels.
#[backend_extension(Flex, Autodiff)]
pub(crate) trait Fused: Backend {
    fn fused_attend(qkv: FloatTensor<Self>, bias: FloatTensor<Self>, heads: usize) -> FloatTensor<Self>;
    fn fused_norm(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
    fn fused_gelu(x: FloatTensor<Self>) -> FloatTensor<Self>;
}

/// Whether the kernels, which are the processor's, take this tensor.
pub(super) fn on_cpu<const D: usize>(x: &Tensor<D>) -> bool {
    cfg!(not(feature = "gpu")) || x.device() == Device::flex()
}

/// Whether they take heads of this width.
pub(super) fn supports(qkv: &Tensor<3>, width: usize, heads: usize) -> bool {
    width / heads <= MAX_HEAD && on_cpu(qkv)
}

/// Causal attention over `[batch, time, 3 width]`, as `attention::attend`.
pub(super) fn attend(qkv: Tensor<3>, bias: Tensor<4>, heads: usize) -> Tensor<3> {
    Tensor::from_dispatch(Dispatch::fused_attend(qkv.into_dispatch(), bias.into_dispatch(), heads))
}

/// A layer's normalisation.
pub(super) fn norm(layer: &LayerNorm, x: Tensor<3>) -> Tensor<3> {
    let Some(beta) = layer.beta.as_ref().filter(|_| on_cpu(&x)) else { return layer.forward(x) };
    let (gamma, beta) = (layer.gamma.val(), beta.val());
    Tensor::from_dispatch(Dispatch::fused_norm(
        x.into_dispatch(),
        gamma.into_dispatch(),
        beta.into_dispatch(),
    ))
}

/// x times the normal distribution function.
pub(super) fn gelu(x: Tensor<3>) -> Tensor<3> {
    if !on_cpu(&x) {
        return burn::tensor::activation::gelu(x);
    }
    Tensor::from_dispatch(Dispatch::fused_gelu(x.into_dispatch()))
}

pub(super) fn shape(tensor: &FlexTensor) -> Vec<usize> {
    tensor.layout().shape().iter().copied().collect()
}

pub(super) fn from_vec(values: Vec<f32>, shape: Vec<usize>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}

fn sizes(qkv: &FlexTensor, heads: usize) -> Sizes {
    let shape = shape(qkv);
    Sizes { heads, time: shape[1], width: shape[2] / 3 }
}

/// The values themselves where nobody else holds them, else a copy.
pub(super) fn into_vec(tensor: FlexTensor) -> Vec<f32> {
    if tensor.is_unique() {
        tensor.into_data().try_into_vec().unwrap_or_default()
    } else {
        to_slice(&tensor).to_vec()
    }
}

pub(super) fn to_slice(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice::<f32>().unwrap_or_default()
}

impl Fused for Flex {
    fn fused_attend(qkv: FlexTensor, bias: FlexTensor, heads: usize) -> FlexTensor {
        let (qkv, bias) = (qkv.to_contiguous(), bias.to_contiguous());
        let sizes = sizes(&qkv, heads);
        let shape = vec![shape(&qkv)[0], sizes.time, sizes.width];
        from_vec(attention::attend(sizes, to_slice(&qkv), to_slice(&bias)), shape)
    }

    fn fused_norm(x: FlexTensor, gamma: FlexTensor, beta: FlexTensor) -> FlexTensor {
        let (x, gamma, beta) = (x.to_contiguous(), gamma.to_contiguous(), beta.to_contiguous());
        from_vec(kernels::layer_norm(to_slice(&x), to_slice(&gamma), to_slice(&beta)), shape(&x))
    }

    fn fused_gelu(x: FlexTensor) -> FlexTensor {
        let x = x.to_contiguous();
        from_vec(kernels::gelu(to_slice(&x)), shape(&x))
    }
}

#[derive(Debug)]
struct AttendBack;

impl Backward<Flex, 1> for AttendBack {
    type State = (FlexTensor, FlexTensor, usize);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node).to_contiguous();
        let (qkv, bias, heads) = ops.state;
        let [node] = ops.parents;
        if let Some(node) = node {
            let back =
                attention::attend_back(sizes(&qkv, heads), to_slice(&qkv), to_slice(&bias), to_slice(&grad));
            grads.register::<Flex>(node.id, from_vec(back, shape(&qkv)));
        }
    }
}

#[derive(Debug)]
struct NormBack;

impl Backward<Flex, 3> for NormBack {
    type State = (FlexTensor, FlexTensor);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node).to_contiguous();
        let (x, gamma) = ops.state;
        let [by_x, by_gamma, by_beta] =
            kernels::layer_norm_back(to_slice(&x), to_slice(&gamma), to_slice(&grad));
        let [node_x, node_gamma, node_beta] = ops.parents;
        let all = [(node_x, by_x, &x), (node_gamma, by_gamma, &gamma), (node_beta, by_beta, &gamma)];
        for (node, by, like) in all {
            if let Some(node) = node {
                grads.register::<Flex>(node.id, from_vec(by, shape(like)));
            }
        }
    }
}

#[derive(Debug)]
struct GeluBack;

impl Backward<Flex, 1> for GeluBack {
    type State = FlexTensor;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node).to_contiguous();
        let [node] = ops.parents;
        if let Some(node) = node {
            let back = kernels::gelu_back(to_slice(&ops.state), into_vec(grad));
            grads.register::<Flex>(node.id, from_vec(back, shape(&ops.state)));
        }
    }
}

impl<C: CheckpointStrategy> Fused for Autodiff<Flex, C> {
    /// The bias is no parameter: it has no gradient.
    fn fused_attend(qkv: FloatTensor<Self>, bias: FloatTensor<Self>, heads: usize) -> FloatTensor<Self> {
        match AttendBack.prepare::<C>([qkv.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let (qkv, bias) =
                    (qkv.into_primitive().to_contiguous(), bias.into_primitive().to_contiguous());
                let out = Flex::fused_attend(qkv.clone(), bias.clone(), heads);
                prep.finish((qkv, bias, heads), out)
            }
            OpsKind::UnTracked(prep) => {
                prep.finish(Flex::fused_attend(qkv.into_primitive(), bias.into_primitive(), heads))
            }
        }
    }

    fn fused_norm(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        match NormBack.prepare::<C>([x.node(), gamma.node(), beta.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let (x, gamma) = (x.into_primitive().to_contiguous(), gamma.into_primitive().to_contiguous());
                let out = Flex::fused_norm(x.clone(), gamma.clone(), beta.into_primitive());
                prep.finish((x, gamma), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(Flex::fused_norm(
                x.into_primitive(),
                gamma.into_primitive(),
                beta.into_primitive(),
            )),
        }
    }

    fn fused_gelu(x: FloatTensor<Self>) -> FloatTensor<Self> {
        match GeluBack.prepare::<C>([x.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let x = x.into_primitive().to_contiguous();
                let out = Flex::fused_gelu(x.clone());
                prep.finish(x, out)
            }
            OpsKind::UnTracked(prep) => prep.finish(Flex::fused_gelu(x.into_primitive())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::attention_bias;
    use burn::nn::LayerNormConfig;
    use burn::tensor::activation::softmax;
    use burn::tensor::{Device, Distribution};

    const BATCH: usize = 3;
    const TIME: usize = 21;
    const WIDTH: usize = 24;
    const HEADS: usize = 2;

    fn device() -> Device {
        let device = Device::flex().autodiff();
        device.seed(3);
        device
    }

    fn most(off: Tensor<3>) -> f32 {
        off.abs().max().into_scalar::<f32>()
    }

    /// Answers and gradients (by the input, under an uneven pull) of an operation.
    fn both(op: impl Fn(Tensor<3>) -> Tensor<3>, input: &Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let input = input.clone().detach().require_grad();
        let out = op(input.clone());
        let pull = (out.clone().detach() * 1.7).sin() + 0.3;
        let gradients = (out.clone() * pull).sum().backward();
        (out.inner(), input.grad(&gradients).unwrap())
    }

    fn agree(ours: impl Fn(Tensor<3>) -> Tensor<3>, plain: impl Fn(Tensor<3>) -> Tensor<3>, last: usize) {
        let input = Tensor::<3>::random([BATCH, TIME, last], Distribution::Normal(0.0, 1.5), &device());
        let ((a, by_a), (b, by_b)) = (both(ours, &input), both(plain, &input));
        assert!(most(a - b) < 1e-5);
        assert!(most(by_b.clone()) > 0.1 && most(by_a - by_b) < 3e-5);
    }

    #[test]
    fn attention_is_that_of_plain_tensors_and_so_is_its_gradient() {
        let times: Vec<f64> = (0..TIME).map(|k| 0.1 * k as f64).collect();
        let bias = attention_bias(&vec![times; BATCH], HEADS, 9, &device());
        // Heads narrower than a vector, and as wide.
        for width in [WIDTH, 2 * MAX_HEAD] {
            let plain = |qkv: Tensor<3>| {
                let part = |k: usize| {
                    let part = qkv.clone().narrow(2, k * width, width);
                    part.reshape([BATCH, TIME, HEADS, width / HEADS]).swap_dims(1, 2)
                };
                let scores = part(0).matmul(part(1).swap_dims(2, 3)) / ((width / HEADS) as f64).sqrt();
                let mixed = softmax(scores + bias.clone(), 3).matmul(part(2));
                mixed.swap_dims(1, 2).reshape([BATCH, TIME, width])
            };
            agree(|qkv| attend(qkv, bias.clone(), HEADS), plain, 3 * width);
        }
    }

    #[test]
    fn gelu_is_that_of_plain_tensors_and_so_is_its_gradient() {
        agree(gelu, burn::tensor::activation::gelu, WIDTH);
        // At the ends of single precision too.
        let far = Tensor::<3>::from_floats([[[-90.0, -20.0, 0.0, 20.0, 90.0]]], &Device::flex());
        let out: Vec<f32> = gelu(far).into_data().try_to_vec().unwrap();
        assert!(out[0] == 0.0 && out[1].abs() < 1e-6 && out[2..] == [0.0, 20.0, 90.0], "{out:?}");
    }

    #[test]
    fn normalisation_is_that_of_the_layer_and_so_are_its_three_gradients() {
        let device = device();
        let random = || Tensor::<1>::random([WIDTH], Distribution::Normal(1.0, 0.5), &device);
        let mut layer = LayerNormConfig::new(WIDTH).init(&device);
        layer.gamma = layer.gamma.map(|_| random().require_grad());
        layer.beta = layer.beta.map(|b| b.map(|_| random().require_grad()));
        agree(|x| norm(&layer, x), |x| layer.forward(x), WIDTH);
        let input = Tensor::<3>::random([BATCH, TIME, WIDTH], Distribution::Normal(2.0, 3.0), &device);
        let by = |out: Tensor<3>| {
            let pull = (out.clone().detach() * 1.7).sin();
            let gradients = (out * pull).sum().backward();
            let beta = layer.beta.as_ref().unwrap().val();
            (layer.gamma.val().grad(&gradients).unwrap(), beta.grad(&gradients).unwrap())
        };
        let (ours, plain) = (by(norm(&layer, input.clone())), by(layer.forward(input)));
        let off = |a: Tensor<1>, b: Tensor<1>| (a - b).abs().max().into_scalar::<f32>();
        assert!(off(ours.0, plain.0) < 1e-4 && off(ours.1, plain.1) < 1e-4);
    }
}
