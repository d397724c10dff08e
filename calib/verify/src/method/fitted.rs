//! A fitted model: coefficients, what remains of readings and second witness, and the derivatives
//! there.

use super::linear::stack_with;
use crate::effect::{Catalogue, EffectModel, EffectTerm};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;
use std::sync::Arc;

/// How a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The sum of squares no longer falls.
    Converged,
    /// It was still falling when the iterations ran out.
    NotConverged,
    /// Columns of the design depend on each other; the others were fitted.
    RankDeficient,
}

/// A fitted model.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Terms with fitted values.
    pub terms: Vec<EffectTerm>,
    /// Coefficients, design columns x channels.
    pub coefficients: DMatrix<f64>,
    /// Whitened residual, readings x channels.
    pub residual: DMatrix<f64>,
    /// Whitened design.
    pub design: DMatrix<f64>,
    /// Design as it is, readings x coefficients.
    pub raw_design: DMatrix<f64>,
    /// Residual as it is, of every reading, in the unit of the measured values.
    pub raw_residual: DMatrix<f64>,
    /// Sum of squares.
    pub ssr: f64,
    /// Readings x channels less coefficients and parameters.
    pub dof: f64,
    /// Tangent of the whole whitened prediction by each nonlinear parameter: readings channel by
    /// channel, then the second witness.
    pub tangents: Vec<DVector<f64>>,
    /// Those of the readings as they are, not whitened, readings x channels each.
    pub raw_tangents: Vec<DMatrix<f64>>,
    /// What the second witness leaves, whitened; empty without one.
    pub auxiliary_residual: DVector<f64>,
    /// Reading of each of its values.
    pub auxiliary_readings: Arc<Vec<usize>>,
    /// Values of the second witness that count.
    pub witness_count: usize,
    /// Which nonlinear parameters sit at an end of their range.
    pub at_bound: Vec<bool>,
    /// How it ended.
    pub status: Status,
}

/// Where a term stands in a fit.
pub struct TermSlots {
    /// Its columns of the design.
    pub columns: Range<usize>,
    /// Its values among the nonlinear ones.
    pub values: Range<usize>,
}

impl Fit {
    /// Where each term stands: columns follow the declared model's, values each other, both in the
    /// order of the terms.
    pub(crate) fn slots(&self, catalogue: &Catalogue) -> Vec<TermSlots> {
        let laws: Vec<&EffectModel> = self
            .terms
            .iter()
            .map(|t| catalogue[t.effect].law(t.law))
            .collect();
        let own: usize = laws.iter().map(|l| l.linear.len()).sum();
        // Columns of the declared model come first.
        let (mut column, mut value) = (self.design.ncols().saturating_sub(own), 0);
        let of = |law: &EffectModel| {
            let (columns, values) = (
                column..column + law.linear.len(),
                value..value + law.parameters.len(),
            );
            (column, value) = (columns.end, values.end);
            TermSlots { columns, values }
        };
        laws.into_iter().map(of).collect()
    }

    /// Residual variance.
    pub fn variance(&self) -> f64 {
        self.ssr / self.dof.max(1.0)
    }

    /// Degrees of freedom of the readings, where the second witness takes none of the parameters.
    pub(crate) fn readings_dof(&self) -> f64 {
        self.dof - self.witness_count as f64
    }

    /// Residual variance of the readings alone.
    pub fn readings_variance(&self) -> f64 {
        self.residual.norm_squared() / self.readings_dof().max(1.0)
    }

    /// The whole whitened residual: readings channel by channel, then the second witness.
    pub fn stacked(&self) -> DVector<f64> {
        stack_with(&self.residual, &self.auxiliary_residual)
    }

    /// Derivatives of the whole whitened prediction: by the coefficients channel by channel, then
    /// by the nonlinear values.
    pub fn jacobian(&self) -> DMatrix<f64> {
        let ((n, q), channels, m) = (
            self.design.shape(),
            self.residual.ncols(),
            self.tangents.len(),
        );
        let rows = self.residual.len() + self.auxiliary_residual.len();
        let mut jacobian = DMatrix::zeros(rows, q * channels + m);
        // Channels share the design, not its coefficients: a block each.
        for c in 0..channels {
            jacobian
                .view_mut((c * n, c * q), (n, q))
                .copy_from(&self.design);
        }
        for (j, t) in self.tangents.iter().enumerate() {
            jacobian.set_column(q * channels + j, t);
        }
        jacobian
    }

    /// Column `j` of the design in each channel, where its coefficient is free.
    pub(crate) fn column_directions(&self, j: usize) -> impl Iterator<Item = DVector<f64>> {
        let column: Vec<f64> = self.design.column(j).iter().copied().collect();
        (0..self.residual.ncols()).map(move |c| self.in_channel(&column, c))
    }

    /// A column of the readings in channel `channel`, zero elsewhere, in the same order.
    pub(crate) fn in_channel(&self, column: &[f64], channel: usize) -> DVector<f64> {
        let mut v = DVector::zeros(self.residual.len() + self.auxiliary_residual.len());
        v.rows_mut(channel * column.len(), column.len())
            .copy_from_slice(column);
        v
    }

    /// Everything of reading `i` by itself, one direction a value.
    pub(crate) fn directions_of(&self, i: usize) -> Vec<DVector<f64>> {
        let (n, size) = (self.residual.nrows(), self.residual.len());
        let own = (0..self.residual.ncols()).map(|c| c * n + i);
        let seen = (0..self.auxiliary_residual.len())
            .filter(|k| self.auxiliary_readings[*k] == i)
            .map(|k| size + k);
        let one = |at: usize| {
            let mut v = DVector::zeros(size + self.auxiliary_residual.len());
            v[at] = 1.0;
            v
        };
        own.chain(seen).map(one).collect()
    }
}
