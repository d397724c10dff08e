//! Normal equations of a chain of unknowns with a few that all share: a band and a border, by
//! Cholesky's factorisation.
//!
//! ```text
//! [ A  C ] [x]   [g]         A = L L' (banded),   S = D - C' A^-1 C
//! [ C' D ] [c] = [h]         (A C; C' D)^-1 = A^-1 + A^-1 C S^-1 C' A^-1  for the chain
//! ```

use nalgebra::{DMatrix, DVector};

/// Sums of squares of a linearised problem.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    /// Lower triangle of A.
    band: Band,
    border: DMatrix<f64>,
    corner: DMatrix<f64>,
    right: DVector<f64>,
    right_common: DVector<f64>,
}

/// A lower triangle of which each row has as many entries as it is wide, up to the diagonal.
#[derive(Debug, Clone)]
struct Band {
    width: usize,
    entries: Vec<f64>,
}

impl Band {
    fn len(&self) -> usize {
        self.entries.len() / self.width
    }

    /// Least column of a row.
    fn first(&self, i: usize) -> usize {
        i.saturating_sub(self.width - 1)
    }

    /// Columns `from .. to` of row i.
    fn row(&self, i: usize, from: usize, to: usize) -> &[f64] {
        let start = (i + 1) * (self.width - 1);
        &self.entries[start + from..start + to]
    }

    fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.entries[(i + 1) * (self.width - 1) + j]
    }

    /// Entries `from ..` of `(L L')^-1 x` into x, where x has nothing before.
    fn solve(&self, x: &mut [f64], from: usize) {
        let n = self.len();
        for i in from..n {
            let first = self.first(i).max(from);
            let row = self.row(i, first, i + 1);
            let sum: f64 = row.iter().zip(&x[first..i]).map(|(l, x)| l * x).sum();
            x[i] = (x[i] - sum) / row[i - first];
        }
        for i in (from..n).rev() {
            let first = self.first(i).max(from);
            let row = self.row(i, first, i + 1);
            let value = x[i] / row[i - first];
            x[i] = value;
            row.iter()
                .zip(&mut x[first..i])
                .for_each(|(l, x)| *x -= l * value);
        }
    }
}

/// The factors of a [`Normal`].
pub(super) struct Factored {
    /// L.
    band: Band,
    /// A^-1 C and S^-1.
    solved: DMatrix<f64>,
    corner: DMatrix<f64>,
}

impl Normal {
    /// Without any equation.
    pub(crate) fn new(unknowns: usize, common: usize, width: usize) -> Self {
        Self {
            band: Band {
                width,
                entries: vec![0.0; width * unknowns],
            },
            border: DMatrix::zeros(unknowns, common),
            corner: DMatrix::zeros(common, common),
            right: DVector::zeros(unknowns),
            right_common: DVector::zeros(common),
        }
    }

    /// Adds `weight (r + J dx + K dc)^2` to the sum; J of the unknowns from `first` on, K of the
    /// first common ones.
    pub(crate) fn add(&mut self, weight: f64, r: f64, first: usize, j: &[f64], k: &[f64]) {
        // Gauss-Newton: J' w J and -J' w r; the chain's matrix is symmetric, so that its lower
        // triangle is enough.
        for (a, va) in j.iter().enumerate() {
            self.right[first + a] -= weight * va * r;
            for (b, vb) in j[..=a].iter().enumerate() {
                *self.band.at(first + a, first + b) += weight * va * vb;
            }
            k.iter()
                .enumerate()
                .for_each(|(b, vb)| self.border[(first + a, b)] += weight * va * vb);
        }
        for (a, va) in k.iter().enumerate() {
            self.right_common[a] -= weight * va * r;
            k.iter()
                .enumerate()
                .for_each(|(b, vb)| self.corner[(a, b)] += weight * va * vb);
        }
    }

    /// Adds `weight (r + dc)^2` of one common unknown.
    pub(crate) fn add_common(&mut self, weight: f64, r: f64, at: usize) {
        self.right_common[at] -= weight * r;
        self.corner[(at, at)] += weight;
    }

    /// With the diagonal raised by a share of itself; none where it is not positive.
    pub(crate) fn factor(&self, damping: f64) -> Option<Factored> {
        let mut band = self.band.clone();
        let n = band.len();
        for i in 0..n {
            // Marquardt's scaling: damping relative to the diagonal does not depend on the
            // unknowns' units.
            *band.at(i, i) = *band.at(i, i) * (1.0 + damping) + 1e-12;
            // Cholesky's factor of a band has no fill outside the band: O(n width^2).
            for j in band.first(i)..=i {
                let from = band.first(i);
                let sum: f64 = band
                    .row(i, from, j)
                    .iter()
                    .zip(band.row(j, from, j))
                    .map(|(a, b)| a * b)
                    .sum();
                let value = *band.at(i, j) - sum;
                *band.at(i, j) = if j < i {
                    value / *band.at(j, j)
                } else if value > 0.0 {
                    value.sqrt()
                } else {
                    return None;
                };
            }
        }
        let mut made = Factored {
            band,
            solved: self.border.clone(),
            corner: DMatrix::zeros(0, 0),
        };
        for mut column in made.solved.column_iter_mut() {
            made.band.solve(column.as_mut_slice(), 0);
        }
        // Schur's complement of the chain: what the common unknowns know once it is eliminated.
        let mut corner = &self.corner - self.border.tr_mul(&made.solved);
        (0..corner.nrows()).for_each(|k| corner[(k, k)] += damping * self.corner[(k, k)] + 1e-12);
        made.corner = corner.try_inverse()?;
        Some(made)
    }

    /// By how much the sum would fall in the step to its least.
    pub(crate) fn gain(&self, by: &Factored) -> f64 {
        // At the minimum of a quadratic form without damping the fall is g' A^-1 g.
        let (step, common) = self.step(by);
        self.right.dot(&step) + self.right_common.dot(&common)
    }

    /// The step to the least sum.
    pub(crate) fn step(&self, by: &Factored) -> (DVector<f64>, DVector<f64>) {
        let mut free = self.right.clone();
        by.band.solve(free.as_mut_slice(), 0);
        // Block elimination: common unknowns from the Schur complement, then the chain.
        let common = &by.corner * (&self.right_common - self.border.tr_mul(&free));
        (free - &by.solved * &common, common)
    }
}

impl Factored {
    /// Logarithm of the determinant.
    pub(crate) fn ln_determinant(&self) -> f64 {
        // det = det A det S; `corner` holds S^-1, hence the minus.
        let last = self.band.width - 1;
        let diagonal = (0..self.band.len()).map(|i| self.band.entries[(i + 1) * last + i]);
        2.0 * diagonal.map(f64::ln).sum::<f64>() - self.corner.determinant().ln()
    }

    /// Covariance of unknowns `from .. from + count`, what is common included.
    pub(crate) fn covariance(&self, from: usize, count: usize) -> DMatrix<f64> {
        let mut all = DMatrix::zeros(count, count);
        for k in 0..count {
            // A column of A^-1: its right-hand side is zero before `from`, where forward
            // substitution can start.
            let mut unit = vec![0.0; self.band.len()];
            unit[from + k] = 1.0;
            self.band.solve(&mut unit, from);
            all.column_mut(k).copy_from_slice(&unit[from..from + count]);
        }
        // The chain's own covariance, and what the common unknowns add.
        let share = self.solved.rows(from, count);
        all + share * &self.corner * share.transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of six unknowns with two that all share: steps and covariances are those of the
    /// dense inverse.
    #[test]
    fn band_and_border_solve_what_the_dense_matrix_does() {
        let (n, m) = (6, 2);
        let mut normal = Normal::new(n, m, 3);
        let (mut dense, mut right) = (
            DMatrix::<f64>::zeros(n + m, n + m),
            DVector::<f64>::zeros(n + m),
        );
        let value = |i: usize| ((37 * i + 11) % 17) as f64 / 7.0 - 1.0;
        for k in 0..n {
            for part in 0..4 {
                let from = k.saturating_sub(2);
                let j: Vec<f64> = (from..=k).map(|a| value(a + 5 * k + 13 * part)).collect();
                let c: Vec<f64> = (0..m).map(|a| value(7 * a + k + 3 * part)).collect();
                let (weight, r) = (1.0 + 0.1 * k as f64, value(k + 29 * part));
                normal.add(weight, r, from, &j, &c);
                let row: Vec<(usize, f64)> = (from..=k)
                    .chain(n..n + m)
                    .zip(j.into_iter().chain(c))
                    .collect();
                for (a, va) in &row {
                    right[*a] -= weight * va * r;
                    row.iter()
                        .for_each(|(b, vb)| dense[(*a, *b)] += weight * va * vb);
                }
            }
        }
        normal.add_common(0.5, 2.0, 1);
        right[n + 1] -= 0.5 * 2.0;
        dense[(n + 1, n + 1)] += 0.5;
        let factored = normal.factor(0.0).unwrap();
        let inverse = dense.try_inverse().unwrap();
        let (step, common) = normal.step(&factored);
        let expected = &inverse * &right;
        assert!(
            (step - expected.rows(0, n)).amax() < 1e-8
                && (common - expected.rows(n, m)).amax() < 1e-8
        );
        assert!((factored.ln_determinant() + inverse.determinant().ln()).abs() < 1e-6);
        assert!((normal.gain(&factored) - right.dot(&(&inverse * &right))).abs() < 1e-6);
        let block = factored.covariance(2, 3);
        assert!((&block - inverse.view((2, 2), (3, 3))).amax() < 1e-8);
        // Control: the chain alone, without what is common, has another covariance.
        assert!((block - inverse.view((1, 1), (3, 3))).amax() > 1e-3);
    }
}
