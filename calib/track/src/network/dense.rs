//! Layers and dropout by the products of `product`, as operations of burn, with their gradients.

use super::fused::{from_vec, into_vec, on_cpu, shape, to_slice};
use super::product::{self, Kept};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, backend_extension};
use burn::nn::{Dropout, Linear};
use burn::tensor::{Distribution, Tensor};

/// The operations.
#[backend_extension(Flex, Autodiff)]
pub(crate) trait Dense: Backend {
    fn dense_linear(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
    fn dense_dropout(
        onto: FloatTensor<Self>,
        x: FloatTensor<Self>,
        share: f32,
        seed: u32,
    ) -> FloatTensor<Self>;
}

/// A layer.
pub(super) fn linear(layer: &Linear, x: Tensor<3>) -> Tensor<3> {
    let Some(bias) = layer.bias.as_ref().filter(|_| on_cpu(&x)) else { return layer.forward(x) };
    let (weight, bias) = (layer.weight.val(), bias.val());
    Tensor::from_dispatch(Dispatch::dense_linear(
        x.into_dispatch(),
        weight.into_dispatch(),
        bias.into_dispatch(),
    ))
}

/// `onto + x`, x under dropout where a network is trained.
pub(super) fn dropout(dropout: &Dropout, onto: Tensor<3>, x: Tensor<3>) -> Tensor<3> {
    let share = 1.0 - dropout.prob;
    if dropout.prob == 0.0 || !x.device().is_autodiff() || !on_cpu(&x) {
        return onto + dropout.forward(x);
    }
    // From the device's seed, as burn's own.
    let drawn = Tensor::<1>::random([1], Distribution::Uniform(0.0, 16_777_216.0), &x.device());
    let seed = (drawn.into_scalar::<f32>() as u32).wrapping_mul(0x9e37_79b9);
    Tensor::from_dispatch(Dispatch::dense_dropout(
        onto.into_dispatch(),
        x.into_dispatch(),
        share as f32,
        seed,
    ))
}

impl Dense for Flex {
    fn dense_linear(x: FlexTensor, weight: FlexTensor, bias: FlexTensor) -> FlexTensor {
        let (x, weight, bias) = (x.to_contiguous(), weight.to_contiguous(), bias.to_contiguous());
        let mut to = shape(&x);
        if let Some(last) = to.last_mut() {
            *last = to_slice(&bias).len();
        }
        from_vec(product::linear(to_slice(&x), to_slice(&weight), to_slice(&bias)), to)
    }

    fn dense_dropout(onto: FlexTensor, x: FlexTensor, share: f32, seed: u32) -> FlexTensor {
        let (onto, x) = (onto.to_contiguous(), x.to_contiguous());
        let to = shape(&x);
        from_vec(product::dropout(into_vec(x), Some(to_slice(&onto)), Kept { share, seed }), to)
    }
}

#[derive(Debug)]
struct LinearBack;

impl Backward<Flex, 3> for LinearBack {
    type State = (FlexTensor, FlexTensor, FlexTensor);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node).to_contiguous();
        let (x, weight, bias) = ops.state;
        let width = to_slice(&bias).len();
        let by = product::linear_back(to_slice(&x), to_slice(&weight), width, to_slice(&grad));
        for ((node, by), like) in ops.parents.into_iter().zip(by).zip([&x, &weight, &bias]) {
            if let Some(node) = node {
                grads.register::<Flex>(node.id, from_vec(by, shape(like)));
            }
        }
    }
}

#[derive(Debug)]
struct DropoutBack;

impl Backward<Flex, 2> for DropoutBack {
    type State = Kept;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<Flex>(&ops.node).to_contiguous();
        let [onto, x] = ops.parents;
        if let Some(x) = x {
            grads.register::<Flex>(
                x.id,
                from_vec(product::dropout(to_slice(&grad).to_vec(), None, ops.state), shape(&grad)),
            );
        }
        if let Some(onto) = onto {
            grads.register::<Flex>(onto.id, grad);
        }
    }
}

impl<C: CheckpointStrategy> Dense for Autodiff<Flex, C> {
    fn dense_linear(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        match LinearBack.prepare::<C>([x.node(), weight.node(), bias.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let [x, weight, bias] = [x, weight, bias].map(|t| t.into_primitive().to_contiguous());
                let out = Flex::dense_linear(x.clone(), weight.clone(), bias.clone());
                prep.finish((x, weight, bias), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(Flex::dense_linear(
                x.into_primitive(),
                weight.into_primitive(),
                bias.into_primitive(),
            )),
        }
    }

    fn dense_dropout(
        onto: FloatTensor<Self>,
        x: FloatTensor<Self>,
        share: f32,
        seed: u32,
    ) -> FloatTensor<Self> {
        let kept = Kept { share, seed };
        match DropoutBack.prepare::<C>([onto.node(), x.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let out = Flex::dense_dropout(onto.into_primitive(), x.into_primitive(), share, seed);
                prep.finish(kept, out)
            }
            OpsKind::UnTracked(prep) => {
                prep.finish(Flex::dense_dropout(onto.into_primitive(), x.into_primitive(), share, seed))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::nn::{DropoutConfig, LinearConfig};
    use burn::tensor::Device;

    fn device() -> Device {
        let device = Device::flex().autodiff();
        device.seed(5);
        device
    }

    fn random(shape: [usize; 3]) -> Tensor<3> {
        Tensor::random(shape, Distribution::Normal(0.0, 1.5), &device())
    }

    #[test]
    fn a_layer_is_that_of_burn_and_so_are_its_three_gradients() {
        let layer = LinearConfig::new(24, 40).init(&device());
        let input = random([3, 21, 24]);
        let by = |op: &dyn Fn(Tensor<3>) -> Tensor<3>| {
            let input = input.clone().detach().require_grad();
            let out = op(input.clone());
            let pull = (out.clone().detach() * 1.7).sin() + 0.3;
            let gradients = (out.clone() * pull).sum().backward();
            let bias = layer.bias.as_ref().unwrap().val().grad(&gradients).unwrap();
            let weight = layer.weight.val().grad(&gradients).unwrap();
            (out.inner(), input.grad(&gradients).unwrap(), weight, bias)
        };
        let (ours, burns) = (by(&|x| linear(&layer, x)), by(&|x| layer.forward(x)));
        let largest = |off: Tensor<3>| off.abs().max().into_scalar::<f32>();
        assert!(largest(ours.0 - burns.0) < 1e-5 && largest(ours.1 - burns.1.clone()) < 1e-5);
        assert!(largest(burns.1) > 0.1);
        assert!((ours.2 - burns.2).abs().max().into_scalar::<f32>() < 1e-4);
        assert!((ours.3 - burns.3).abs().max().into_scalar::<f32>() < 1e-4);
    }

    #[test]
    fn what_is_dropped_gets_no_gradient_and_what_it_is_added_to_gets_all() {
        let layer = DropoutConfig::new(0.25).init();
        let [onto, x] = [random([2, 30, 16]), random([2, 30, 16])].map(|t| t.detach().require_grad());
        let out = dropout(&layer, onto.clone(), x.clone());
        let gradients = (out.clone() * 2.0).sum().backward();
        let (by_onto, by_x) = (onto.grad(&gradients).unwrap(), x.grad(&gradients).unwrap());
        assert_eq!((by_onto - 2.0).abs().max().into_scalar::<f32>(), 0.0);
        // The answer is what the gradient says: linear in x, and nothing where it is 0.
        let added = (out - onto).inner();
        let off = (added - x.inner() * by_x.clone() / 2.0).abs().max().into_scalar::<f32>();
        assert!(off < 1e-5, "{off}");
        let kept = by_x.greater_elem(0.0).float().mean().into_scalar::<f32>();
        assert!((kept - 0.75).abs() < 0.1, "{kept}");
    }

    #[test]
    fn nothing_is_dropped_where_nothing_is_learnt() {
        let layer = DropoutConfig::new(0.25).init();
        let [onto, x] = [random([2, 3, 16]), random([2, 3, 16])].map(|t| t.inner());
        let off = dropout(&layer, onto.clone(), x.clone()) - (onto + x);
        assert_eq!(off.abs().max().into_scalar::<f32>(), 0.0);
    }
}
