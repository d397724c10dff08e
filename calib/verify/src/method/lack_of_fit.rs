//! Pure error from readings that agree in every setting, and the lack of fit of a model against it.
//! Readings that agree make a cell.
//!
//! ```text
//! S = S_between + S_within,   S_within = |(I - P_[M, D]) W r|^2        M: model's columns and tangents, D: one column a cell, W: whitening
//! d_within = n - cells - rank M within cells,    d_between = n - rank M - d_within
//! F = (S_between / d_between) / (S_within / d_within)
//! ```
//!
//! What a parameter says within cells (a zero of each series) costs the repeats a degree of
//! freedom, and the places none.

use super::distributions::f_tail;
use super::fit::{Fit, Weights};
use super::linear::Basis;
use crate::levels::REPLICATES;
use nalgebra::DVector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Pure error from readings of one stimulus, and lack of fit against it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LackOfFit {
    /// Standard deviation of readings of one stimulus.
    pub pure_sd: f64,
    /// Degrees of freedom of the pure error.
    pub pure_dof: f64,
    /// F of the rest of the misfit.
    pub f: f64,
    /// Its degrees of freedom.
    pub dof: f64,
    /// p-value; null where nothing remains to test.
    pub p_value: Option<f64>,
}

impl LackOfFit {
    /// Of what a fit leaves between and within settings; none without pure error.
    pub fn of(Split { between, within }: Split) -> Option<Self> {
        if within.dof < 1.0 || !(within.ss > 0.0) {
            return None;
        }
        // Readings of one setting differ by noise alone: no model is needed for their variance.
        let pure_variance = within.ss / within.dof;
        let (f, dof) = (
            (between.ss / between.dof.max(1.0)) / pure_variance,
            between.dof,
        );
        let p_value = f_tail(f, [dof, within.dof]);
        Some(Self {
            pure_sd: pure_variance.sqrt(),
            pure_dof: within.dof,
            f,
            dof,
            p_value,
        })
    }

    /// Repeats contradict the model.
    pub fn is_significant(&self) -> bool {
        self.p_value.is_some_and(|p| p < REPLICATES)
    }
}

/// A sum of squares with its degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Sum of squares.
    pub ss: f64,
    /// Degrees of freedom.
    pub dof: f64,
}

/// What a fit leaves, between cells and within.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split {
    /// Between cells.
    pub between: Part,
    /// Within cells.
    pub within: Part,
}

/// Rows that count, by cell.
pub fn members(cells: &[u64], weights: &[f64]) -> Vec<Vec<usize>> {
    let mut rows: Vec<usize> = (0..cells.len()).filter(|&i| weights[i] > 0.0).collect();
    rows.sort_by_key(|&i| cells[i]);
    rows.chunk_by(|&a, &b| cells[a] == cells[b])
        .map(<[usize]>::to_vec)
        .collect()
}

/// `values` weighted, less the weighted mean of each cell where `within`.
fn weighted(values: &[f64], weights: &[f64], cells: &[Vec<usize>], within: bool) -> DVector<f64> {
    let mut out = DVector::from_fn(values.len(), |i, _| weights[i] * values[i]);
    for cell in cells.iter().filter(|_| within) {
        // The mean with the least variance: weights are reciprocal standard deviations.
        let square: f64 = cell.iter().map(|&i| weights[i].powi(2)).sum();
        let mean = cell
            .iter()
            .map(|&i| weights[i].powi(2) * values[i])
            .sum::<f64>()
            / square;
        cell.iter().for_each(|&i| out[i] -= weights[i] * mean);
    }
    out
}

/// Share within cells, in that of the stimulus, below which a column is one of the cell alone:
/// thirty waves over the range change 54 times as much.
const OF_STIMULUS: f64 = 100.0;

/// Splits what `fit` leaves by `cells`, a key a reading; columns weighted by the readings' relative
/// spread. Of a stimulus `x` that is read with scatter within cells, what follows it says nothing
/// there.
pub fn split(fit: &Fit, weights: &Weights, cells: &[u64], x: &[f64]) -> Split {
    split_of(fit.residual.column(0).as_slice(), fit, weights, cells, x)
}

/// The same of any whitened values, off what `fit` takes up.
pub(crate) fn split_of(
    values: &[f64],
    fit: &Fit,
    weights: &Weights,
    cells: &[u64],
    x: &[f64],
) -> Split {
    let w = weights.relative();
    let cells = members(cells, w);
    let norms =
        |column: &[f64]| [true, false].map(|within| weighted(column, w, &cells, within).norm());
    let [scatter, size] = norms(x);
    let negligible = OF_STIMULUS * scatter / size.max(1e-300);
    // Whitened, so that a part of the noise that neighbours share is no lack of fit.
    let left: Vec<f64> = (0..w.len())
        .map(|i| if w[i] > 0.0 { values[i] / w[i] } else { 0.0 })
        .collect();
    let of = |within: bool| {
        let mut basis = Basis::default();
        let tangents = fit.raw_tangents.iter().map(|t| t.column(0).clone_owned());
        for column in fit
            .raw_design
            .column_iter()
            .map(|c| c.clone_owned())
            .chain(tangents)
        {
            let [inside, whole] = norms(column.as_slice());
            if !within || inside > negligible * whole {
                basis.push_beside(&weighted(column.as_slice(), w, &cells, within), whole);
            }
        }
        (
            basis
                .project_off(&weighted(&left, w, &cells, within))
                .norm_squared(),
            basis.rank() as f64,
        )
    };
    let readings = cells.iter().map(Vec::len).sum::<usize>() as f64;
    let ((whole, rank), (inside, rank_inside)) = (of(false), of(true));
    // Every cell costs one degree of freedom, and every column that moves readings within one.
    let within = Part {
        ss: inside,
        dof: readings - cells.len() as f64 - rank_inside,
    };
    let between = Part {
        ss: (whole - inside).max(0.0),
        dof: readings - rank - within.dof,
    };
    Split { between, within }
}

/// Chance of a fall from `without` to `with` beside what remains; none where nothing more is asked
/// or nothing remains to compare with.
pub(crate) fn extra_sum_of_squares_p(without: Part, with: Part) -> Option<f64> {
    // Extra sum of squares over what the larger model leaves: F of nested models.
    let (gain, extra) = (without.ss - with.ss, without.dof - with.dof);
    let f = gain / extra / (with.ss / with.dof).max(1e-300);
    f_tail(f, [extra, with.dof])
}
