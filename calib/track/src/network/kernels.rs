//! Normalisation and GELU in one pass each, with their gradients, on plain slices.
//!
//! ```text
//! layer norm   y = g (x - mean) r + b,  r = 1 / sqrt(var + eps);   with z = (x - mean) r and u = g dy:
//!              dx = r (u - mean u - z mean(u z)),  dg = sum dy z,  db = sum dy
//! GELU         y = x Phi(x),  dx = dy (Phi(x) + x phi(x))
//! ```
//!
//! Sources: J. L. Ba, J. R. Kiros, G. E. Hinton, "Layer Normalization", 2016; D. Hendrycks, K. Gimpel, "Gaussian Error Linear Units", 2016.
//! Written out of small tensor operations these and attention move some twenty times the memory that they need.

use super::widest::{Kernel, Simd, mul_add, widest};
use rayon::prelude::*;

/// As in `LayerNormConfig`.
pub(super) const EPSILON: f32 = 1e-5;
/// Rows of one task.
const ROWS: usize = 256;

/// Added and taken off again, it leaves a whole number.
const ROUNDS: f32 = 12_582_912.0;

/// exp(x) to two units in the last place; 0 below the range of single precision.
#[inline(always)]
pub(super) fn exp<S: Simd>(x: f32) -> f32 {
    let y = x.clamp(-87.3, 88.0);
    // Rounds to a whole number, which the last bits hold: single precision has no more digits up there.
    let rounded = y * std::f32::consts::LOG2_E + ROUNDS;
    let n = rounded - ROUNDS;
    let r = mul_add::<S>(n, -0.693_359_4, y);
    let r = mul_add::<S>(n, 2.121_944_4e-4, r);
    let mut p = 1.987_569_1e-4_f32;
    for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        p = mul_add::<S>(p, r, c);
    }
    let p = mul_add::<S>(p * r, r, r) + 1.0;
    let scaled = p * f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    if x < -87.3 { 0.0 } else { scaled }
}

/// Normal distribution function and density (M. Abramowitz, I. A. Stegun, 7.1.26: off by 1.5e-7 at most).
#[inline(always)]
fn normal<S: Simd>(x: f32) -> (f32, f32) {
    let bell = exp::<S>(-0.5 * x * x);
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / mul_add::<S>(z, 0.327_591_1, 1.0);
    let mut p = 1.061_405_4_f32;
    for c in [-1.453_152_1, 1.421_413_8, -0.284_496_72, 0.254_829_6] {
        p = mul_add::<S>(p, t, c);
    }
    let tail = 0.5 * p * t * bell;
    (if x < 0.0 { tail } else { 1.0 - tail }, 0.398_942_3 * bell)
}

/// A piece of `gelu`: answers and x.
struct Gelu<'a>(&'a mut [f32], &'a [f32]);

impl Kernel for Gelu<'_> {
    type Out = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        self.0.iter_mut().zip(self.1).for_each(|(o, x)| *o = x * normal::<S>(*x).0);
    }
}

/// x times the normal distribution function.
pub(super) fn gelu(x: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; x.len()];
    let pieces = out.par_chunks_mut(ROWS * ROWS).zip(x.par_chunks(ROWS * ROWS));
    pieces.for_each(|(out, x)| widest(Gelu(out, x)));
    out
}

/// A piece of `gelu_back`: gradients and x.
struct GeluBack<'a>(&'a mut [f32], &'a [f32]);

impl Kernel for GeluBack<'_> {
    type Out = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        self.0.iter_mut().zip(self.1).for_each(|(o, x)| {
            let (share, density) = normal::<S>(*x);
            *o *= mul_add::<S>(*x, density, share);
        });
    }
}

/// Gradient of `gelu` over that of its answer.
pub(super) fn gelu_back(x: &[f32], mut grad: Vec<f32>) -> Vec<f32> {
    let pieces = grad.par_chunks_mut(ROWS * ROWS).zip(x.par_chunks(ROWS * ROWS));
    pieces.for_each(|(out, x)| widest(GeluBack(out, x)));
    grad
}

/// Sum over a row of what is made of each pair of numbers in two rows of one length.
#[inline(always)]
pub(super) fn sum<S: Simd>(
    simd: S,
    [a, b]: [&[f32]; 2],
    vectors: impl Fn(S::f32s, S::f32s) -> S::f32s,
    rest: impl Fn(f32, f32) -> f32,
) -> f32 {
    let ([a, b], [a_rest, b_rest]) = {
        let (a, b) = (S::as_simd_f32s(a), S::as_simd_f32s(b));
        ([a.0, b.0], [a.1, b.1])
    };
    let mut sums = simd.splat_f32s(0.0);
    for (a, b) in a.iter().zip(b) {
        sums = simd.add_f32s(sums, vectors(*a, *b));
    }
    let mut total = simd.reduce_sum_f32s(sums);
    for (a, b) in a_rest.iter().zip(b_rest) {
        total += rest(*a, *b);
    }
    total
}

/// Mean and inverse spread of a row.
#[inline(always)]
fn spread<S: Simd>(simd: S, row: &[f32]) -> (f32, f32) {
    let n = row.len() as f32;
    let mean = sum(simd, [row, row], |x, _| x, |x, _| x) / n;
    let off = simd.splat_f32s(mean);
    let square = |x, _| {
        let x = simd.sub_f32s(x, off);
        simd.mul_f32s(x, x)
    };
    let variance = sum(simd, [row, row], square, |x, _| (x - mean) * (x - mean)) / n;
    (mean, 1.0 / (variance + EPSILON).sqrt())
}

/// Some rows of `layer_norm`.
struct Norm<'a> {
    out: &'a mut [f32],
    x: &'a [f32],
    gamma: &'a [f32],
    beta: &'a [f32],
}

impl Kernel for Norm<'_> {
    type Out = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let width = self.gamma.len();
        for (out, x) in self.out.chunks_exact_mut(width).zip(self.x.chunks_exact(width)) {
            let (mean, rate) = spread(simd, x);
            for (((out, x), gamma), beta) in out.iter_mut().zip(x).zip(self.gamma).zip(self.beta) {
                *out = mul_add::<S>((x - mean) * rate, *gamma, *beta);
            }
        }
    }
}

/// Rows normalised, times `gamma`, plus `beta`.
pub(super) fn layer_norm(x: &[f32], gamma: &[f32], beta: &[f32]) -> Vec<f32> {
    let rows = ROWS * gamma.len();
    let mut out = vec![0.0; x.len()];
    let pieces = out.par_chunks_mut(rows).zip(x.par_chunks(rows));
    pieces.for_each(|(out, x)| widest(Norm { out, x, gamma, beta }));
    out
}

/// Some rows of `layer_norm_back`; gives their gradients by gamma and beta.
struct NormBack<'a> {
    by_x: &'a mut [f32],
    x: &'a [f32],
    gamma: &'a [f32],
    grad: &'a [f32],
    by: [Vec<f32>; 2],
    /// Room for a row.
    normed: Vec<f32>,
    pulled: Vec<f32>,
}

impl Kernel for NormBack<'_> {
    type Out = [Vec<f32>; 2];

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> [Vec<f32>; 2] {
        let Self { by_x, x, gamma, grad, mut by, mut normed, mut pulled } = self;
        let width = gamma.len();
        let [by_gamma, by_beta] = &mut by;
        let rows = by_x.chunks_exact_mut(width).zip(x.chunks_exact(width));
        for ((by_x, x), grad) in rows.zip(grad.chunks_exact(width)) {
            let (mean, rate) = spread(simd, x);
            for ((normed, x), (grad, by_gamma)) in
                normed.iter_mut().zip(x).zip(grad.iter().zip(&mut *by_gamma))
            {
                *normed = (x - mean) * rate;
                *by_gamma = mul_add::<S>(*grad, *normed, *by_gamma);
            }
            for ((pulled, gamma), (grad, by_beta)) in
                pulled.iter_mut().zip(gamma).zip(grad.iter().zip(&mut *by_beta))
            {
                *pulled = grad * gamma;
                *by_beta += grad;
            }
            let level = sum(simd, [&pulled, &pulled], |x, _| x, |x, _| x) / width as f32;
            let tilt = sum(simd, [&pulled, &normed], |a, b| simd.mul_f32s(a, b), |a, b| a * b) / width as f32;
            for ((by_x, pulled), normed) in by_x.iter_mut().zip(&pulled).zip(&normed) {
                *by_x = rate * (pulled - level - normed * tilt);
            }
        }
        by
    }
}

/// Gradients of `layer_norm` by x, gamma and beta.
pub(super) fn layer_norm_back(x: &[f32], gamma: &[f32], grad: &[f32]) -> [Vec<f32>; 3] {
    let width = gamma.len();
    let mut by_x = vec![0.0; x.len()];
    let room = || vec![0.0_f32; width];
    let piece = |((by_x, x), grad): ((&mut [f32], &[f32]), &[f32])| {
        widest(NormBack { by_x, x, gamma, grad, by: [room(), room()], normed: room(), pulled: room() })
    };
    let rows = ROWS * width;
    let pieces = by_x.par_chunks_mut(rows).zip(x.par_chunks(rows)).zip(grad.par_chunks(rows));
    let parts: Vec<[Vec<f32>; 2]> = pieces.map(piece).collect();
    let mut sums = [room(), room()];
    for (sum, part) in parts.iter().flat_map(|part| (0..2).zip(part)) {
        sums[sum].iter_mut().zip(part).for_each(|(s, x)| *s += x);
    }
    let [by_gamma, by_beta] = sums;
    [by_x, by_gamma, by_beta]
}
