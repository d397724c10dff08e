//! Forward-mode derivatives by the three components of the contact force.
//!
//! a + b e_i with e_i e_j = 0: (f g)' = f' g + f g', f(a)' = f'(a) a'. Source: A. Griewank & A.
//! Walther, "Evaluating Derivatives" (2008), ch. 3.

use std::ops::{Add, Mul, Sub};

/// What the integrator needs of a number: plain `f64`, or `f64` with three partial derivatives.
pub trait Scalar: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// A constant.
    fn constant(value: f64) -> Self;
    /// The value without derivatives.
    fn value(self) -> f64;
    /// Multiplication by a constant.
    fn scale(self, factor: f64) -> Self;
    /// `f(self)` for a function of known value and slope at this point.
    fn chain(self, value: f64, slope: f64) -> Self;
}

impl Scalar for f64 {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn value(self) -> f64 {
        self
    }
    #[inline(always)]
    fn scale(self, factor: f64) -> Self {
        self * factor
    }
    #[inline(always)]
    fn chain(self, value: f64, _slope: f64) -> Self {
        value
    }
}

/// Value and three partial derivatives, kept as one lane of four.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Dual3(pub [f64; 4]);

impl Dual3 {
    /// Independent variable number `index` (0..3).
    pub(crate) fn variable(value: f64, index: usize) -> Self {
        let mut lanes = [value, 0.0, 0.0, 0.0];
        lanes[index + 1] = 1.0;
        Self(lanes)
    }

    /// Partial derivative number `index`.
    pub(crate) fn partial(self, index: usize) -> f64 {
        self.0[index + 1]
    }
}

impl Add for Dual3 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]])
    }
}

impl Sub for Dual3 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]])
    }
}

impl Mul for Dual3 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([
            a[0] * b[0],
            a[0] * b[1] + b[0] * a[1],
            a[0] * b[2] + b[0] * a[2],
            a[0] * b[3] + b[0] * a[3],
        ])
    }
}

impl Scalar for Dual3 {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self([value, 0.0, 0.0, 0.0])
    }
    #[inline(always)]
    fn value(self) -> f64 {
        self.0[0]
    }
    #[inline(always)]
    fn scale(self, factor: f64) -> Self {
        let a = self.0;
        Self([a[0] * factor, a[1] * factor, a[2] * factor, a[3] * factor])
    }
    #[inline(always)]
    fn chain(self, value: f64, slope: f64) -> Self {
        let a = self.0;
        Self([value, a[1] * slope, a[2] * slope, a[3] * slope])
    }
}

/// Three components.
pub type V3<T> = [T; 3];

/// Row-major rotation matrix.
pub type M3<T> = [[T; 3]; 3];

/// Cross product.
#[inline(always)]
pub fn cross<T: Scalar>(a: &V3<T>, b: &V3<T>) -> V3<T> {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Scalar product.
#[inline(always)]
pub fn dot<T: Scalar>(a: &V3<T>, b: &V3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Sum.
#[inline(always)]
pub fn add<T: Scalar>(a: &V3<T>, b: &V3<T>) -> V3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference.
#[inline(always)]
pub fn sub<T: Scalar>(a: &V3<T>, b: &V3<T>) -> V3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Product with a constant.
#[inline(always)]
pub fn scaled<T: Scalar>(a: &V3<T>, factor: f64) -> V3<T> {
    [a[0].scale(factor), a[1].scale(factor), a[2].scale(factor)]
}

/// `M v`.
#[inline(always)]
pub(crate) fn mat_vec<T: Scalar>(m: &M3<T>, v: &V3<T>) -> V3<T> {
    [dot(&m[0], v), dot(&m[1], v), dot(&m[2], v)]
}

/// `M^T v`.
#[inline(always)]
pub(crate) fn mat_t_vec<T: Scalar>(m: &M3<T>, v: &V3<T>) -> V3<T> {
    [
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    ]
}

/// `A B`.
#[inline(always)]
pub(crate) fn mat_mat<T: Scalar>(a: &M3<T>, b: &M3<T>) -> M3<T> {
    let column = |j: usize| [b[0][j], b[1][j], b[2][j]];
    let (c0, c1, c2) = (column(0), column(1), column(2));
    [
        [dot(&a[0], &c0), dot(&a[0], &c1), dot(&a[0], &c2)],
        [dot(&a[1], &c0), dot(&a[1], &c1), dot(&a[1], &c2)],
        [dot(&a[2], &c0), dot(&a[2], &c1), dot(&a[2], &c2)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn product_rule() {
        let x = Dual3::variable(3.0, 0);
        let y = Dual3::variable(-2.0, 2);
        let p = x * y + x.scale(2.0);
        assert_eq!(p.value(), 0.0);
        assert_eq!((p.partial(0), p.partial(1), p.partial(2)), (0.0, 0.0, 3.0));
    }
}
