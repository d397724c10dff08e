//! Orthonormal bases and projections in the space of all readings and channels.

use nalgebra::{DMatrix, DVector};

/// An orthonormal basis grown by modified Gram-Schmidt with re-orthogonalisation.
#[derive(Debug, Clone, Default)]
pub struct Basis {
    vectors: Vec<DVector<f64>>,
}

/// A direction counts as new if this share of it is left after projection.
const NEW_SHARE: f64 = 1e-6;

impl Basis {
    /// Number of directions.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.vectors.len()
    }

    /// `v` less its part in the basis.
    #[must_use]
    pub fn project_off(&self, v: &DVector<f64>) -> DVector<f64> {
        let mut out = v.clone();
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

    /// The same where `v` is what is left of something of norm `size`: rounding of that is no direction.
    pub fn push_beside(&mut self, v: &DVector<f64>, size: f64) -> bool {
        let left = self.project_off(v);
        let norm = left.norm();
        if !(norm > NEW_SHARE * size && norm > 0.0 && norm.is_finite()) {
            return false;
        }
        self.vectors.push(left / norm);
        true
    }

    /// Coordinates of `v` in the basis.
    #[must_use]
    pub fn coordinates(&self, v: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(self.rank(), self.vectors.iter().map(|q| q.dot(v)))
    }

    /// The basis vectors.
    #[must_use]
    pub fn vectors(&self) -> &[DVector<f64>] {
        &self.vectors
    }
}

/// Stacks the columns of readings x channels into one vector.
#[must_use]
pub fn stack(m: &DMatrix<f64>) -> DVector<f64> {
    DVector::from_column_slice(m.as_slice())
}

/// Values of the readings, stacked, with those of the second witness below.
#[must_use]
pub fn stack_with(readings: &DMatrix<f64>, witness: &DVector<f64>) -> DVector<f64> {
    let (n, m) = (readings.len(), witness.len());
    let mut v = DVector::zeros(n + m);
    v.rows_mut(0, n).copy_from_slice(readings.as_slice());
    v.rows_mut(n, m).copy_from(witness);
    v
}

/// `column` in channel `channel` of `channels`, zero in the others.
#[must_use]
pub fn in_channel(column: &[f64], channel: usize, channels: usize) -> DVector<f64> {
    let n = column.len();
    let mut v = DVector::zeros(n * channels);
    v.rows_mut(channel * n, n).copy_from_slice(column);
    v
}
