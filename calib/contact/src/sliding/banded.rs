//! Normal equations of a chain of unknowns with a few that all share: a band and a border, by Cholesky's factorisation.
//!
//! ```text
//! [ A  C ] [x]   [g]         A = L L' (banded),   S = D - C' A^-1 C
//! [ C' D ] [c] = [h]         (A C; C' D)^-1 = A^-1 + A^-1 C S^-1 C' A^-1  for the chain
//! ```

use nalgebra::{DMatrix, DVector};

/// Sums of squares of a linearised problem.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    width: usize,
    /// Row i of the lower band: columns i - width + 1 ..= i.
    band: Vec<Vec<f64>>,
    border: DMatrix<f64>,
    corner: DMatrix<f64>,
    right: DVector<f64>,
    right_common: DVector<f64>,
}

/// The factors of a [`Normal`].
pub(super) struct Factored {
    width: usize,
    band: Vec<Vec<f64>>,
    /// A^-1 C and S^-1.
    solved: DMatrix<f64>,
    corner: DMatrix<f64>,
}

impl Normal {
    /// Without any equation.
    pub fn new(unknowns: usize, common: usize, width: usize) -> Self {
        Self {
            width,
            band: vec![vec![0.0; width]; unknowns],
            border: DMatrix::zeros(unknowns, common),
            corner: DMatrix::zeros(common, common),
            right: DVector::zeros(unknowns),
            right_common: DVector::zeros(common),
        }
    }

    /// Adds `weight (r + J dx + K dc)^2` to the sum; entries of a row as pairs of index and value.
    pub fn add(&mut self, weight: f64, r: f64, j: &[(usize, f64)], k: &[(usize, f64)]) {
        for &(a, va) in j {
            self.right[a] -= weight * va * r;
            for &(b, vb) in j.iter().filter(|(b, _)| *b <= a) {
                self.band[a][b + self.width - 1 - a] += weight * va * vb;
            }
            k.iter().for_each(|&(b, vb)| self.border[(a, b)] += weight * va * vb);
        }
        for &(a, va) in k {
            self.right_common[a] -= weight * va * r;
            k.iter().for_each(|&(b, vb)| self.corner[(a, b)] += weight * va * vb);
        }
    }

    /// With the diagonal raised by a share of itself; none where it is not positive.
    pub fn factor(&self, damping: f64) -> Option<Factored> {
        let (n, w) = (self.band.len(), self.width);
        let mut band = self.band.clone();
        for i in 0..n {
            band[i][w - 1] = band[i][w - 1] * (1.0 + damping) + 1e-12;
            for j in i.saturating_sub(w - 1)..=i {
                let from = i.saturating_sub(w - 1).max(j.saturating_sub(w - 1));
                let sum: f64 = (from..j).map(|k| band[i][k + w - 1 - i] * band[j][k + w - 1 - j]).sum();
                let value = band[i][j + w - 1 - i] - sum;
                band[i][j + w - 1 - i] = if j < i {
                    value / band[j][w - 1]
                } else if value > 0.0 {
                    value.sqrt()
                } else {
                    return None;
                };
            }
        }
        let mut made = Factored {
            width: w,
            band,
            solved: DMatrix::zeros(n, self.corner.nrows()),
            corner: DMatrix::zeros(0, 0),
        };
        for k in 0..self.corner.nrows() {
            let column = made.chain(&self.border.column(k).into_owned());
            made.solved.set_column(k, &column);
        }
        let mut corner = &self.corner - self.border.tr_mul(&made.solved);
        (0..corner.nrows()).for_each(|k| corner[(k, k)] += damping * self.corner[(k, k)] + 1e-12);
        made.corner = corner.try_inverse()?;
        Some(made)
    }

    /// The step to the least sum.
    pub fn step(&self, by: &Factored) -> (DVector<f64>, DVector<f64>) {
        let free = by.chain(&self.right);
        let common = &by.corner * (&self.right_common - self.border.tr_mul(&free));
        (free - &by.solved * &common, common)
    }
}

impl Factored {
    /// A^-1 times a vector.
    fn chain(&self, right: &DVector<f64>) -> DVector<f64> {
        let (n, w) = (self.band.len(), self.width);
        let mut x = right.clone();
        for i in 0..n {
            let sum: f64 = (i.saturating_sub(w - 1)..i).map(|k| self.band[i][k + w - 1 - i] * x[k]).sum();
            x[i] = (x[i] - sum) / self.band[i][w - 1];
        }
        for i in (0..n).rev() {
            let sum: f64 = (i + 1..(i + w).min(n)).map(|k| self.band[k][i + w - 1 - k] * x[k]).sum();
            x[i] = (x[i] - sum) / self.band[i][w - 1];
        }
        x
    }

    /// Covariance of unknowns `from .. from + count`, what is common included.
    pub fn covariance(&self, from: usize, count: usize) -> DMatrix<f64> {
        let n = self.band.len();
        let mut all = DMatrix::zeros(count, count);
        for k in 0..count {
            let mut unit = DVector::zeros(n);
            unit[from + k] = 1.0;
            all.set_column(k, &self.chain(&unit).rows(from, count));
        }
        let share = self.solved.rows(from, count);
        all + share * &self.corner * share.transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of six unknowns with two that all share: steps and covariances are those of the dense inverse.
    #[test]
    fn band_and_border_solve_what_the_dense_matrix_does() {
        let (n, m) = (6, 2);
        let mut normal = Normal::new(n, m, 3);
        let (mut dense, mut right) = (DMatrix::<f64>::zeros(n + m, n + m), DVector::<f64>::zeros(n + m));
        let value = |i: usize| ((37 * i + 11) % 17) as f64 / 7.0 - 1.0;
        for k in 0..n {
            for part in 0..4 {
                let from = k.saturating_sub(2);
                let j: Vec<(usize, f64)> = (from..=k).map(|a| (a, value(a + 5 * k + 13 * part))).collect();
                let c: Vec<(usize, f64)> = (0..m).map(|a| (a, value(7 * a + k + 3 * part))).collect();
                let (weight, r) = (1.0 + 0.1 * k as f64, value(k + 29 * part));
                normal.add(weight, r, &j, &c);
                let row: Vec<(usize, f64)> =
                    j.into_iter().chain(c.into_iter().map(|(a, v)| (n + a, v))).collect();
                for (a, va) in &row {
                    right[*a] -= weight * va * r;
                    row.iter().for_each(|(b, vb)| dense[(*a, *b)] += weight * va * vb);
                }
            }
        }
        let factored = normal.factor(0.0).unwrap();
        let inverse = dense.try_inverse().unwrap();
        let (step, common) = normal.step(&factored);
        let expected = &inverse * &right;
        assert!((step - expected.rows(0, n)).amax() < 1e-8 && (common - expected.rows(n, m)).amax() < 1e-8);
        let block = factored.covariance(2, 3);
        assert!((&block - inverse.view((2, 2), (3, 3))).amax() < 1e-8);
        // Control: the chain alone, without what is common, has another covariance.
        assert!((block - inverse.view((1, 1), (3, 3))).amax() > 1e-3);
    }
}
