//! The kinds of session: each with its forward model, its catalogue of effects and its words.

pub mod change;
mod relaxation;
pub mod scalar;
pub mod whisker;

use nalgebra::DMatrix;

/// Least and largest value.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| {
        [a.min(v), b.max(v)]
    })
}

/// A matrix as a document has it, row by row.
fn rows(m: &DMatrix<f64>) -> Vec<Vec<f64>> {
    m.row_iter().map(|r| r.iter().copied().collect()).collect()
}

/// F with F F' = `covariance`, found in units of the standard deviations: pixels and radians differ by
/// orders of magnitude.
fn root(covariance: &[Vec<f64>]) -> DMatrix<f64> {
    let n = covariance.len();
    let sd = |i: usize| covariance[i][i].max(0.0).sqrt();
    let unit = |i: usize, j: usize| {
        0.5 * (covariance[i][j] + covariance[j][i]) / (sd(i) * sd(j)).max(f64::MIN_POSITIVE)
    };
    let parts = DMatrix::from_fn(n, n, unit).symmetric_eigen();
    // What is exact or not identified has no part.
    let length = |k: usize| {
        Some(parts.eigenvalues[k])
            .filter(|v| *v > 1e-12)
            .map_or(0.0, f64::sqrt)
    };
    DMatrix::from_fn(n, n, |i, k| sd(i) * parts.eigenvectors[(i, k)] * length(k))
}
