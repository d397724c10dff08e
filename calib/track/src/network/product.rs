//! Matrix products onto memory that is already there, and layers made of them.
//!
//! ```text
//! linear    Y = X W + 1 b^T;   dX = dY W^T,  dW = X^T dY,  db = column sums of dY
//! dropout   y = x k / q,  k = 1 with probability q (drawn by place and seed), else 0;   dx = dy k / q
//! ```
//!
//! By the crate gemm, which is burn's own on a processor: called through burn, each answer is made of zeros, copied and only then written.
//! One call here is not safe Rust; what it may touch is checked before it.

use super::widest::{Kernel, Simd, mul_add, widest};
use rayon::prelude::*;

/// Multiplications from which on a product is shared out among threads.
const SHARED: usize = 192 * 192 * 192;
/// Rows of one task.
const ROWS: usize = 256;

/// A matrix in a slice without gaps.
#[derive(Debug, Clone, Copy)]
struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    /// Steps from one row to the next, and from one column to the next.
    steps: [usize; 2],
}

impl<'a> Matrix<'a> {
    /// Row by row, `columns` wide.
    fn new(values: &'a [f32], columns: usize) -> Self {
        let rows = values.len().checked_div(columns).unwrap_or(0);
        Self { values, rows, columns, steps: [columns, 1] }
    }

    fn turned(self) -> Self {
        let [by_row, by_column] = self.steps;
        Self { rows: self.columns, columns: self.rows, steps: [by_column, by_row], ..self }
    }
}

/// Writes `a b` over `out`, row by row; with `onto` it is added to what is there.
#[allow(unsafe_code, reason = "gemm takes pointers; their extents are checked")]
fn product(out: &mut [f32], onto: bool, a: Matrix<'_>, b: Matrix<'_>) {
    let (m, n, k) = (a.rows, b.columns, a.columns);
    assert_eq!((b.rows, out.len()), (k, m * n), "sizes of a matrix product");
    assert!(a.values.len() == m * k && b.values.len() == k * n, "matrices without gaps");
    let threads = if m * n * k < SHARED { gemm::Parallelism::None } else { gemm::Parallelism::Rayon(0) };
    let [[a_row, a_column], [b_row, b_column]] = [a.steps, b.steps].map(|s| s.map(|x| x as isize));
    // SAFETY: every element of a, b and out that gemm reaches by these steps lies within its slice, as asserted; `out` is borrowed alone.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            n as isize,
            onto,
            a.values.as_ptr(),
            a_column,
            a_row,
            b.values.as_ptr(),
            b_column,
            b_row,
            1.0,
            1.0,
            false,
            false,
            false,
            threads,
        );
    }
}

/// `x weight + bias`, rows of x as wide as the weight is high.
pub(super) fn linear(x: &[f32], weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let (weight, x) = (Matrix::new(weight, bias.len()), Matrix::new(x, weight.len() / bias.len().max(1)));
    let mut out = Vec::with_capacity(x.rows * bias.len());
    for _ in 0..x.rows {
        out.extend_from_slice(bias);
    }
    if x.rows == 1 && !bias.is_empty() {
        // A stream's token: gemm would first pack the weight, which takes longer than the product.
        return widest(OneRow { x: x.values, weight: weight.values, out });
    }
    product(&mut out, true, x, weight);
    out
}

/// One row by a matrix, added to `out`: sums of the matrix's rows, four at a time.
struct OneRow<'a> {
    x: &'a [f32],
    weight: &'a [f32],
    out: Vec<f32>,
}

impl Kernel for OneRow<'_> {
    type Out = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> Vec<f32> {
        let Self { x, weight, mut out } = self;
        let width = out.len();
        let (fours, rest) = x.as_chunks::<4>();
        let (in_fours, in_rest) = weight.split_at(4 * fours.len() * width);
        for (x, rows) in fours.iter().zip(in_fours.chunks_exact(4 * width)) {
            let (low, high) = rows.split_at(2 * width);
            let ((a, b), (c, d)) = (low.split_at(width), high.split_at(width));
            for ((((o, a), b), c), d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                let sum = mul_add::<S>(*a, x[0], mul_add::<S>(*b, x[1], *o));
                *o = mul_add::<S>(*c, x[2], mul_add::<S>(*d, x[3], sum));
            }
        }
        for (x, row) in rest.iter().zip(in_rest.chunks_exact(width)) {
            out.iter_mut().zip(row).for_each(|(o, w)| *o = mul_add::<S>(*w, *x, *o));
        }
        out
    }
}

/// Gradients of `linear` by x, weight and bias.
pub(super) fn linear_back(x: &[f32], weight: &[f32], width: usize, grad: &[f32]) -> [Vec<f32>; 3] {
    let (weight, grad) = (Matrix::new(weight, width), Matrix::new(grad, width));
    let mut by_x = vec![0.0; x.len()];
    product(&mut by_x, false, grad, weight.turned());
    let mut by_weight = vec![0.0; weight.values.len()];
    product(&mut by_weight, false, Matrix::new(x, weight.rows).turned(), grad);
    [by_x, by_weight, column_sums(grad.values, width)]
}

/// Sums of some rows' columns.
struct ColumnSums<'a> {
    rows: &'a [f32],
    sums: Vec<f32>,
}

impl Kernel for ColumnSums<'_> {
    type Out = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> Vec<f32> {
        let Self { rows, mut sums } = self;
        for row in rows.chunks_exact(sums.len()) {
            sums.iter_mut().zip(row).for_each(|(s, x)| *s += x);
        }
        sums
    }
}

/// Sums of the columns.
fn column_sums(values: &[f32], width: usize) -> Vec<f32> {
    let of_rows = |rows| widest(ColumnSums { rows, sums: vec![0.0; width] });
    let parts: Vec<Vec<f32>> = values.par_chunks(ROWS * width).map(of_rows).collect();
    let mut sums = vec![0.0; width];
    parts.iter().for_each(|part| sums.iter_mut().zip(part).for_each(|(s, x)| *s += x));
    sums
}

/// The numbers that dropout keeps: drawn by their place, so that the gradient draws the same ones again.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kept {
    /// Share that is kept.
    pub share: f32,
    /// Seed of the draw.
    pub seed: u32,
}

impl Kept {
    /// Factor on the number at `place`: 0, or what keeps the mean. The mixing is Steele, Lea and Flood's (OOPSLA 2014) in 32 bits.
    #[inline(always)]
    fn factor(self, place: u32) -> f32 {
        let mut h = place.wrapping_mul(0x9e37_79b9) ^ self.seed;
        h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
        h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
        h ^= h >> 16;
        // Single precision has 24 bits.
        if ((h >> 8) as f32) < self.share * 16_777_216.0 { 1.0 / self.share } else { 0.0 }
    }
}

/// A piece of `dropout`, from the place `first` on.
struct Dropout<'a> {
    x: &'a mut [f32],
    onto: Option<&'a [f32]>,
    kept: Kept,
    first: usize,
}

impl Kernel for Dropout<'_> {
    type Out = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Self { x, onto, kept, first } = self;
        let places = x.iter_mut().enumerate().map(|(k, x)| (x, (first + k) as u32));
        match onto {
            Some(onto) => places.zip(onto).for_each(|((x, at), o)| *x = *x * kept.factor(at) + o),
            None => places.for_each(|(x, at)| *x *= kept.factor(at)),
        }
    }
}

/// `onto + x`, x under dropout, written over x; without `onto` it alone.
pub(super) fn dropout(mut x: Vec<f32>, onto: Option<&[f32]>, kept: Kept) -> Vec<f32> {
    const TASK: usize = ROWS * ROWS;
    x.par_chunks_mut(TASK).enumerate().for_each(|(k, x)| {
        let first = k * TASK;
        let onto = onto.map(|onto| &onto[first..first + x.len()]);
        widest(Dropout { x, onto, kept, first });
    });
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_is_the_sum_of_products_turned_or_not() {
        let a: Vec<f32> = (0..6).map(|k| k as f32 - 2.0).collect();
        let b: Vec<f32> = (0..12).map(|k| 0.5 * k as f32).collect();
        // a is 2 x 3, b is 3 x 4; both are given turned, too.
        let plain = |i: usize, j: usize| (0..3).map(|k| a[i * 3 + k] * b[k * 4 + j]).sum::<f32>();
        let turn = |v: &[f32], columns: usize| -> Vec<f32> {
            let rows = v.len() / columns;
            (0..v.len()).map(|k| v[k % rows * columns + k / rows]).collect()
        };
        let (a_turned, b_turned) = (turn(&a, 3), turn(&b, 4));
        let both = [Matrix::new(&a, 3), Matrix::new(&a_turned, 2).turned()];
        for first in both {
            for second in [Matrix::new(&b, 4), Matrix::new(&b_turned, 3).turned()] {
                let mut out = vec![1.0; 8];
                product(&mut out, true, first, second);
                assert!((0..8).all(|k| out[k] == 1.0 + plain(k / 4, k % 4)), "{out:?}");
                product(&mut out, false, first, second);
                assert!((0..8).all(|k| out[k] == plain(k / 4, k % 4)), "{out:?}");
            }
        }
    }

    /// A row by itself goes another way than the same row among others.
    #[test]
    fn one_row_is_as_among_others() {
        for (high, width) in [(276, 80), (7, 3), (4, 16), (1, 40)] {
            let number = |k: usize| ((k * 7919) % 1013) as f32 / 1013.0 - 0.5;
            let weight: Vec<f32> = (0..high * width).map(number).collect();
            let bias: Vec<f32> = (0..width).map(|k| number(k + 5)).collect();
            let rows: Vec<f32> = (0..2 * high).map(|k| number(k + 11)).collect();
            let (one, two) = (linear(&rows[..high], &weight, &bias), linear(&rows, &weight, &bias));
            let off = one.iter().zip(&two).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            // Sums of up to 276 products below a quarter, in another order.
            assert!(one.len() == width && off < 1e-4, "{high} x {width}: {off}");
            assert!(
                two[width..].iter().zip(&one).any(|(a, b)| (a - b).abs() > 1e-3),
                "the other row is another"
            );
        }
    }

    #[test]
    #[should_panic(expected = "sizes of a matrix product")]
    fn sizes_that_do_not_fit_stop() {
        product(&mut [0.0; 4], false, Matrix::new(&[0.0; 4], 2), Matrix::new(&[0.0; 6], 2));
    }

    #[test]
    fn dropout_keeps_its_share_everywhere_and_draws_anew_with_each_seed() {
        const N: usize = 1 << 18;
        let of = |seed: u32| dropout(vec![1.0; N], None, Kept { share: 0.9, seed });
        let (one, other) = (of(1), of(2));
        let share = |v: &[f32]| v.iter().filter(|x| **x > 0.0).count() as f64 / v.len() as f64;
        // Six standard deviations of a share.
        let largest = |n: usize| 6.0 * (0.09 / n as f64).sqrt();
        assert!(one.iter().all(|x| *x == 0.0 || *x == 1.0 / 0.9));
        assert!((share(&one) - 0.9).abs() < largest(N), "{}", share(&one));
        for part in one.chunks(N / 64) {
            assert!((share(part) - 0.9).abs() < largest(N / 64), "{}", share(part));
        }
        // Neighbours, places a row of the network apart, and seeds: dropped together no more often than by chance.
        let together = |a: &[f32], b: &[f32]| {
            a.iter().zip(b).filter(|(a, b)| **a == 0.0 && **b == 0.0).count() as f64 / b.len() as f64
        };
        let chance = 6.0 * (0.01 * 0.99 / N as f64).sqrt();
        for pair in [together(&one, &one[1..]), together(&one, &one[128..]), together(&one, &other)] {
            assert!((pair - 0.01).abs() < chance, "{pair}");
        }
        assert_eq!(dropout(vec![1.0; 4], Some(&[2.0; 4]), Kept { share: 1.0, seed: 3 }), [3.0; 4]);
    }
}
