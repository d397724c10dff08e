//! Symmetric block tridiagonal matrices with 3 x 3 blocks: the Hessian of the discrete rod.
//!
//! A = L D L^T with blocks A_jj and B_j = A_(j,j-1): C_j = B_j D_(j-1)^-1, D_j = A_jj - C_j B_j^T;
//! L has ones and the C_j. Solve: y_j = b_j - C_j y_(j-1), then x_j = D_j^-1 y_j - C_(j+1)^T
//! x_(j+1). The number of negative eigenvalues of A is that of all D_j (Sylvester's law of
//! inertia). Source: G. Golub & C. Van Loan, "Matrix Computations" (2013), sec. 4.5.

use nalgebra::{Matrix3, Vector3};

/// Factors of a symmetric block tridiagonal matrix.
pub(crate) struct BlockFactors {
    inverse: Vec<Matrix3<f64>>,
    /// Block to the one before times that one's inverse pivot; by its transpose the way back goes,
    /// as pivots are symmetric.
    carry: Vec<Matrix3<f64>>,
    /// Negative eigenvalues of the matrix (Sylvester's law on the pivots).
    pub(crate) negative: usize,
}

impl BlockFactors {
    /// Block LDL^T; `None` where a pivot is singular.
    pub(crate) fn new(diagonal: &[Matrix3<f64>], before: &[Matrix3<f64>]) -> Option<Self> {
        let mut inverse: Vec<Matrix3<f64>> = Vec::with_capacity(diagonal.len());
        let mut carry: Vec<Matrix3<f64>> = Vec::with_capacity(diagonal.len());
        let mut negative = 0;
        for (j, block) in diagonal.iter().enumerate() {
            let mut pivot = *block;
            carry.push(match inverse.last() {
                Some(last) => {
                    let carry = product(&before[j], last);
                    pivot -= product_transposed(&carry, &before[j]);
                    carry
                }
                None => Matrix3::zeros(),
            });
            let pivot = (pivot + pivot.transpose()) * 0.5;
            negative += negative_eigenvalues(&pivot);
            inverse.push(pivot.try_inverse()?);
        }
        Some(Self {
            inverse,
            carry,
            negative,
        })
    }

    /// Solves `A x = b` in place: forward substitution, then backward.
    pub(crate) fn solve(&self, x: &mut [Vector3<f64>]) {
        for j in 1..x.len() {
            let carried = times(&self.carry[j], &x[j - 1]);
            x[j] -= carried;
        }
        let mut beyond = Vector3::zeros();
        for j in (0..x.len()).rev() {
            x[j] = times(&self.inverse[j], &x[j]) - beyond;
            beyond = transposed_times(&self.carry[j], &x[j]);
        }
    }
}

/// Columns of `a b`.
#[inline(always)]
fn product(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[0, 1, 2].map(|k| times(a, &b.column(k).into())))
}

/// `a b^T`.
#[inline(always)]
fn product_transposed(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[0, 1, 2].map(|k| times(a, &b.row(k).transpose())))
}

/// Matrix times vector, written out: the library's general product is not inlined and took a
/// quarter of a sweep's time.
#[inline(always)]
fn times(m: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        m[(0, 0)] * v.x + m[(0, 1)] * v.y + m[(0, 2)] * v.z,
        m[(1, 0)] * v.x + m[(1, 1)] * v.y + m[(1, 2)] * v.z,
        m[(2, 0)] * v.x + m[(2, 1)] * v.y + m[(2, 2)] * v.z,
    )
}

#[inline(always)]
fn transposed_times(m: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        m[(0, 0)] * v.x + m[(1, 0)] * v.y + m[(2, 0)] * v.z,
        m[(0, 1)] * v.x + m[(1, 1)] * v.y + m[(2, 1)] * v.z,
        m[(0, 2)] * v.x + m[(1, 2)] * v.y + m[(2, 2)] * v.z,
    )
}

/// By the signs of the leading minors' ratios.
fn negative_eigenvalues(m: &Matrix3<f64>) -> usize {
    let first = m[(0, 0)];
    let second = m[(0, 0)] * m[(1, 1)] - m[(0, 1)] * m[(1, 0)];
    let minors = [1.0, first, second, m.determinant()];
    minors.windows(2).filter(|w| w[0] * w[1] < 0.0).count()
}

#[cfg(test)]
mod tests {
    use super::BlockFactors;
    use nalgebra::{Matrix3, Vector3};

    #[test]
    fn factors_solve_and_count_negative_eigenvalues() {
        let diagonal = vec![Matrix3::identity() * 4.0; 5];
        let before = vec![Matrix3::new(0.3, 0.1, 0.0, -0.2, 0.4, 0.1, 0.0, 0.2, 0.5); 5];
        let x: Vec<Vector3<f64>> = (0..5).map(|k| Vector3::new(1.0, k as f64, -2.0)).collect();
        let mut b: Vec<Vector3<f64>> = (0..5).map(|j| diagonal[j] * x[j]).collect();
        for j in 1..5 {
            b[j] += before[j] * x[j - 1];
            b[j - 1] += before[j].transpose() * x[j];
        }
        BlockFactors::new(&diagonal, &before).unwrap().solve(&mut b);
        assert!(b.iter().zip(&x).all(|(a, b)| (a - b).norm() < 1e-12));
        let factors =
            |diagonal: &[Matrix3<f64>]| BlockFactors::new(diagonal, &before).unwrap().negative;
        assert_eq!(
            [
                factors(&diagonal),
                factors(&vec![-Matrix3::identity() * 4.0; 5])
            ],
            [0, 15]
        );
    }
}
