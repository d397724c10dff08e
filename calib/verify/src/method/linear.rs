//! Orthonormal bases and projections in the space of all readings and channels.
//!
//! ```text
//! q = (I - Q Q') v / |(I - Q Q') v|            Gram-Schmidt, applied twice
//! D'D = R'R,   Q' v = R^-T D' v                pivoted Cholesky, on the independent directions
//! ```

use nalgebra::{DMatrix, DVector};

/// An orthonormal basis grown by modified Gram-Schmidt with re-orthogonalisation.
#[derive(Debug, Clone, Default)]
pub struct Basis {
    vectors: Vec<DVector<f64>>,
}

/// A direction counts as new if this share of it remains after projection.
const NEW_SHARE: f64 = 1e-6;

impl Basis {
    /// The span of `vectors`.
    pub fn of(vectors: impl IntoIterator<Item = DVector<f64>>) -> Self {
        let mut basis = Self::default();
        for v in vectors {
            basis.push(&v);
        }
        basis
    }

    /// Number of directions.
    pub fn rank(&self) -> usize {
        self.vectors.len()
    }

    /// `v` less its part in the basis.
    pub fn project_off(&self, v: &DVector<f64>) -> DVector<f64> {
        let mut out = v.clone();
        // Twice is enough: the second pass restores orthogonality to working precision (Kahan, in
        // Parlett 1980).
        for _ in 0..2 {
            for q in &self.vectors {
                let along = q.dot(&out);
                out.axpy(-along, q, 1.0);
            }
        }
        out
    }

    /// Adds the new part of `v`, if any; says whether there was one.
    pub fn push(&mut self, v: &DVector<f64>) -> bool {
        self.push_beside(v, v.norm())
    }

    /// The same where `v` is what remains of something of norm `size`: rounding of that is no
    /// direction.
    pub(crate) fn push_beside(&mut self, v: &DVector<f64>, size: f64) -> bool {
        let left = self.project_off(v);
        let norm = left.norm();
        if !(norm > NEW_SHARE * size && norm > 0.0 && norm.is_finite()) {
            return false;
        }
        self.vectors.push(left / norm);
        true
    }

    /// Coordinates of `v` in the basis.
    pub fn coordinates(&self, v: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(self.rank(), self.vectors.iter().map(|q| q.dot(v)))
    }

    /// Standard deviation that a fit of the basis leaves of value `k`, beside 1 before it: sqrt(1 -
    /// h_kk), h the hat matrix; floored where a value determines itself.
    pub(crate) fn unexplained_sd(&self, k: usize) -> f64 {
        let leverage: f64 = self.vectors.iter().map(|q| q[k] * q[k]).sum();
        (1.0 - leverage).max(0.05).sqrt()
    }

    /// The basis vectors.
    pub fn vectors(&self) -> &[DVector<f64>] {
        &self.vectors
    }
}

/// `a' b` as one blocked product: nalgebra's `tr_mul` goes column by column.
pub(crate) fn transposed_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    a.transpose() * b
}

/// The joint span of many directions by the pivoted Cholesky factor of their Gram matrix:
/// `D = Q R`, Q orthonormal.
pub(crate) struct JointSpan {
    directions: DMatrix<f64>,
    /// Directions that are new, in the order of the pivots.
    independent: Vec<usize>,
    /// Coordinates of every direction, rank x directions.
    factor: DMatrix<f64>,
}

/// A direction of unit length is new where this part of its square remains: its own rounding is a
/// thousandth of that.
const NEW_SQUARE: f64 = 1e-10;

/// Relative difference up to which two pivots are one.
const SAME_PIVOT: f64 = 1e-6;

impl JointSpan {
    /// Span of directions of unit length, up to `limit` of them independent.
    pub(crate) fn of<'a>(directions: impl Iterator<Item = &'a DVector<f64>>, limit: usize) -> Self {
        let columns: Vec<&DVector<f64>> = directions.collect();
        let size = columns.first().map_or(0, |c| c.len());
        let mut matrix = DMatrix::zeros(size, columns.len());
        for (mut to, from) in matrix.column_iter_mut().zip(&columns) {
            to.copy_from(from);
        }
        let gram = transposed_product(&matrix, &matrix);
        let limit = limit.min(columns.len());
        // A direction a row, a basis vector a column.
        let mut factor = DMatrix::zeros(columns.len(), limit);
        let (mut left, mut independent) = (gram.diagonal(), Vec::new());
        // The largest first: rounding that a small pivot would magnify never meets what is still
        // large (Higham, "Accuracy and Stability of Numerical Algorithms", 2nd ed., 10.3).
        while independent.len() < limit {
            // Of pivots that only rounding tells apart the first: what is drawn along them must not
            // depend on rounding.
            let near = (1.0 - SAME_PIVOT) * left.max();
            let Some(k) = left.iter().position(|left| *left >= near) else {
                break;
            };
            let pivot = left[k];
            if !(pivot > NEW_SQUARE) {
                break;
            }
            // Left-looking Cholesky: a direction's products with all others, less what the basis
            // vectors before it hold of them.
            let before = factor.columns(0, independent.len());
            let mut along = gram.column(k).clone_owned();
            along.gemv(-1.0, &before, &before.row(k).transpose(), 1.0);
            along /= pivot.sqrt();
            left.zip_apply(&along, |left, along| *left -= along * along);
            left[k] = 0.0;
            factor.set_column(independent.len(), &along);
            independent.push(k);
        }
        Self {
            directions: matrix,
            factor: factor.columns(0, independent.len()).transpose(),
            independent,
        }
    }

    /// Independent directions.
    pub(crate) fn rank(&self) -> usize {
        self.independent.len()
    }

    /// Length of a direction.
    pub(crate) fn size(&self) -> usize {
        self.directions.nrows()
    }

    /// What vectors of the span, columns of `coordinates`, have along every direction.
    pub(crate) fn along(&self, coordinates: &DMatrix<f64>) -> DMatrix<f64> {
        transposed_product(&self.factor, coordinates)
    }

    /// Coordinates of the parts of `vectors` in the span.
    pub(crate) fn coordinates(&self, vectors: &DMatrix<f64>) -> DMatrix<f64> {
        // With D = Q R on the pivots, Q' v = R^-T D' v: Q itself is never formed.
        let along = transposed_product(&self.directions, vectors).select_rows(&self.independent);
        let triangle = self.factor.select_columns(&self.independent);
        triangle
            .transpose()
            .solve_lower_triangular(&along)
            .unwrap_or(along)
    }
}

/// Stacks the columns of readings x channels into one vector.
pub fn stack(m: &DMatrix<f64>) -> DVector<f64> {
    DVector::from_column_slice(m.as_slice())
}

/// Values of the readings, stacked, with those of the second witness below.
pub(crate) fn stack_with(
    readings: &DMatrix<f64>,
    auxiliary_residual: &DVector<f64>,
) -> DVector<f64> {
    let (n, m) = (readings.len(), auxiliary_residual.len());
    let mut v = DVector::zeros(n + m);
    v.rows_mut(0, n).copy_from_slice(readings.as_slice());
    v.rows_mut(n, m).copy_from(auxiliary_residual);
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smooth functions of eleven settings on a fine grid of rates: each is nearly a combination of
    /// its neighbours, as laws over few settings are.
    fn nearly_dependent() -> Vec<DVector<f64>> {
        let smooth = |rate: f64| DVector::from_fn(44, |i, _| (rate * (i % 11) as f64 / 10.0).exp());
        let rough = |k: usize| DVector::from_fn(44, |i, _| ((i * (k + 3)) as f64).sin());
        let all = (0..120).flat_map(|k| [smooth(0.01 * k as f64), rough(k / 8)]);
        all.map(|v| v.clone() / v.norm()).collect()
    }

    #[test]
    fn a_joint_span_keeps_the_directions_lengths_and_angles() {
        let directions = nearly_dependent();
        let span = JointSpan::of(directions.iter(), 42);
        let rebuilt = transposed_product(&span.factor, &span.factor);
        for (a, v) in directions.iter().enumerate() {
            for (b, w) in directions.iter().enumerate() {
                assert!(
                    (rebuilt[(a, b)] - v.dot(w)).abs() < 1e-8,
                    "{a} {b}: {}",
                    rebuilt[(a, b)]
                );
            }
        }
        // What lies in the span comes back from its coordinates.
        let whole = DMatrix::from_columns(&directions);
        let again = span.along(&span.coordinates(&whole));
        assert!((again - transposed_product(&whole, &whole)).amax() < 1e-6);
        // Control: a span cut short does not hold them.
        let short = JointSpan::of(directions.iter(), 3);
        let rebuilt = transposed_product(&short.factor, &short.factor);
        assert!(
            directions
                .iter()
                .enumerate()
                .any(|(a, v)| rebuilt[(a, a)] < 0.9 * v.norm_squared())
        );
    }
}
