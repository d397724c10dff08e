//! Loops compiled for the widest vectors that the processor has (`pulp`), with its fused multiply-add where it has one.
//!
//! A kernel owns what it works on: a closure that borrows it would be called through a shim, which stays outside and is compiled for the
//! oldest processor.

pub(super) use pulp::Simd;
use std::any::TypeId;

/// What runs on vectors; `run` and all that it calls are inlined.
pub(super) trait Kernel {
    type Out;

    fn run<S: Simd>(self, simd: S) -> Self::Out;
}

struct OnVectors<K>(K);

impl<K: Kernel> pulp::WithSimd for OnVectors<K> {
    type Output = K::Out;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> K::Out {
        self.0.run(simd)
    }
}

/// Runs a kernel.
pub(super) fn widest<K: Kernel>(kernel: K) -> K::Out {
    pulp::Arch::new().dispatch(OnVectors(kernel))
}

/// Product and sum, rounded once where the processor can: elsewhere `mul_add` is a slow call.
#[inline(always)]
pub(super) fn mul_add<S: Simd>(x: f32, factor: f32, summand: f32) -> f32 {
    // All but the plain one can.
    if TypeId::of::<S>() == TypeId::of::<pulp::Scalar>() {
        x * factor + summand
    } else {
        x.mul_add(factor, summand)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Product([f32; 3]);

    impl Kernel for Product {
        type Out = f32;

        fn run<S: Simd>(self, _: S) -> f32 {
            let [x, factor, summand] = self.0;
            mul_add::<S>(x, factor, summand)
        }
    }

    #[test]
    fn with_and_without_fused_products_answers_differ_by_rounding_only() {
        let numbers = || Product([1.0 + f32::EPSILON, 1.0 - f32::EPSILON, -1.0]);
        let (exact, apart) = (-f32::EPSILON * f32::EPSILON, numbers().run(pulp::Scalar::new()));
        let found = widest(numbers());
        assert!((exact - apart).abs() < f32::EPSILON && (found == exact || found == apart), "{found}");
    }
}
