//! A Gaussian process of zero mean, conditioned on noisy values; its inputs are of any dimension.
//!
//! y = f(x) + e with cov(f(x), f(x')) = k(|x - x'|) and cov(e) = N: C = K + N = L L^T, weights a = C^-1 y. At another place with
//! k_i = k(|x_i - x|): mean k . a, variance k(0) - |L^-1 k|^2; log p(y) = -1/2 y . a - sum ln L_ii - n/2 ln 2 pi.
//! Source: C. Rasmussen & C. Williams, "Gaussian Processes for Machine Learning" (2006), alg. 2.1.
//!
//! Trend, leave-out errors and hyperparameters of a map stand above it ([`crate::Process`]).

use crate::error::MapError;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// A process conditioned on values.
#[derive(Debug, Clone)]
pub struct ConditionedProcess {
    factor: Cholesky<f64, Dyn>,
    values: DVector<f64>,
    /// a, one a value.
    pub weights: DVector<f64>,
}

impl ConditionedProcess {
    /// From C (n x n) and the values (n).
    ///
    /// # Errors
    /// [`MapError::NotPositiveDefinite`].
    pub fn new(covariance: DMatrix<f64>, values: DVector<f64>) -> Result<Self, MapError> {
        let readings = values.len();
        let factor = Cholesky::new(covariance).ok_or(MapError::NotPositiveDefinite { readings })?;
        let weights = factor.solve(&values);
        Ok(Self { factor, values, weights })
    }

    /// Mean where the covariances with the values are `k`.
    pub fn mean(&self, k: impl Iterator<Item = f64>) -> f64 {
        k.zip(self.weights.iter()).map(|(k, a)| k * a).sum()
    }

    /// What the values take off the prior variance where the covariances with them are `k`: k . C^-1 k.
    pub fn explained(&self, mut k: DVector<f64>) -> f64 {
        // Half of the solution is enough for its square.
        if self.factor.l_dirty().solve_lower_triangular_mut(&mut k) { k.norm_squared() } else { 0.0 }
    }

    /// y . C^-1 y.
    pub fn misfit(&self) -> f64 {
        self.values.dot(&self.weights)
    }

    /// ln det C.
    pub fn log_determinant(&self) -> f64 {
        2.0 * self.factor.l_dirty().diagonal().iter().map(|v| v.ln()).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kernel;

    fn at(k: usize) -> DVector<f64> {
        DVector::from_iterator(4, (0..4).map(|d| ((k * 4 + d) as f64 * 0.7).sin()))
    }

    /// Four dimensions: values come back where they were given, far away the prior does, and the evidence is the density's logarithm.
    #[test]
    fn what_is_told_is_known_there_and_nowhere_else() {
        let kernel = Kernel::Matern52 { length: 1.3 };
        let n = 12;
        let gram = DMatrix::from_fn(n, n, |i, j| {
            kernel.at((at(i) - at(j)).norm()) + if i == j { 1e-6 } else { 0.0 }
        });
        let values = DVector::from_fn(n, |k, _| at(k).sum());
        let process = ConditionedProcess::new(gram.clone(), values.clone()).unwrap();
        let near = |x: &DVector<f64>| DVector::from_fn(n, |k, _| kernel.at((at(k) - x).norm()));
        for k in 0..n {
            let of = near(&at(k));
            assert!((process.mean(of.iter().copied()) - values[k]).abs() < 1e-3, "{k}");
            assert!(1.0 - process.explained(of) < 1e-5, "{k}");
        }
        let far = near(&DVector::repeat(4, 50.0));
        assert!(process.mean(far.iter().copied()).abs() < 1e-9 && process.explained(far) < 1e-9);
        let inverse = gram.clone().try_inverse().unwrap();
        assert!((process.misfit() / (values.transpose() * inverse * &values)[0] - 1.0).abs() < 1e-6);
        assert!((process.log_determinant() - gram.determinant().ln()).abs() < 1e-6);
        // Control: a matrix that is no covariance is refused.
        assert!(ConditionedProcess::new(-gram, values).is_err());
    }
}
