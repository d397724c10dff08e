//! The rest geometry as a least-squares problem; a place where the rod has no solution has no
//! residuals.
//!
//! Residuals d_ki / sd_ki of each point's two transverse distances, (L_k - L) / sd_Lk of each
//! length; Jacobian by central differences (f(x + h) - f(x - h)) / 2 h, error O(h^2): an exact one
//! would have to go through each wire's equilibrium.

use super::lines::{GuessedShape, distances};
use super::model::RestModel;
use crate::RodError;
use nalgebra::{DMatrix, DVector, Dyn};
use std::cell::OnceCell;
use wcal_core::least_squares::{Damping, Ending, Linearised, NormalEquations, minimise};
use wcal_core::observation::WhiskerSpec;

/// Standard deviation of the length that a pair states, where it states none, mm.
const LENGTH_SD_MM: f64 = 0.05;
/// Share of the sum of squares below which a further step is not worth a Jacobian: far below the
/// standard deviations.
const LEAST_DECREASE: f64 = 1e-9;

#[derive(Clone, Copy)]
struct Problem<'a> {
    nominal: &'a WhiskerSpec,
    model: RestModel,
    shapes: &'a [GuessedShape<'a>],
}

impl<'a> Problem<'a> {
    fn residuals(&self, v: &DVector<f64>) -> Option<DVector<f64>> {
        if !self.model.is_admissible(v) {
            return None;
        }
        let mut all = Vec::new();
        for held in self.shapes {
            let (shape, across) = (
                held.shape,
                distances(self.nominal, self.model, v, held).ok()?,
            );
            // In standard deviations: a point counts by how well it was seen.
            for ((_, d), sd) in across.iter().zip(&shape.sd_mm) {
                all.extend(d.map(|d| d / sd));
            }
            // Distances across the line do not see where it ends: the length is observed, too.
            let sd = if shape.length_mm[1] > 0.0 {
                shape.length_mm[1]
            } else {
                LENGTH_SD_MM
            };
            all.push((shape.length_mm[0] - v[self.model.shape_unknowns() - 1]) / sd);
        }
        Some(DVector::from_vec(all))
    }

    fn jacobian(&self, v: &DVector<f64>) -> Option<DMatrix<f64>> {
        let moved = |k: usize, step: f64| {
            let mut moved = v.clone();
            moved[k] += step;
            self.residuals(&moved)
        };
        let column =
            |(k, step): (usize, f64)| Some((moved(k, step)? - moved(k, -step)?) / (2.0 * step));
        let steps = self.model.difference_steps().into_iter().enumerate();
        let columns: Vec<DVector<f64>> = steps.map(column).collect::<Option<_>>()?;
        Some(DMatrix::from_columns(&columns))
    }

    fn at(self, v: &DVector<f64>) -> Option<FitPoint<'a>> {
        let residuals = self.residuals(v)?;
        Some(FitPoint {
            problem: self,
            values: v.clone(),
            residuals,
            normal: OnceCell::new(),
        })
    }
}

/// Residuals at a place; the Jacobian, which costs two solutions an unknown, only where a step
/// starts from it.
struct FitPoint<'a> {
    problem: Problem<'a>,
    values: DVector<f64>,
    residuals: DVector<f64>,
    normal: OnceCell<Option<NormalEquations<Dyn>>>,
}

impl Linearised for FitPoint<'_> {
    type Step = DVector<f64>;

    fn cost(&self) -> f64 {
        self.residuals.norm_squared()
    }

    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let normal = || {
            let jacobian = self.problem.jacobian(&self.values)?;
            // Gauss-Newton: second derivatives are left out.
            let (matrix, descent) = (
                jacobian.tr_mul(&jacobian),
                -jacobian.tr_mul(&self.residuals),
            );
            Some(NormalEquations {
                cost: self.cost(),
                matrix,
                descent,
            })
        };
        self.normal.get_or_init(normal).as_ref()?.step(damping)
    }
}

/// Best values, and the sum of squares there.
pub(super) fn solve(
    nominal: &WhiskerSpec,
    model: RestModel,
    start: &DVector<f64>,
    shapes: &[GuessedShape<'_>],
) -> Result<(DVector<f64>, f64), RodError> {
    let problem = Problem {
        nominal,
        model,
        shapes,
    };
    let failed = |why: &str| {
        RodError::RestFit(format!(
            "the fit of a {} did not converge: {why}",
            model.name()
        ))
    };
    let first = problem
        .at(start)
        .ok_or_else(|| failed("the rod has no solution at its start"))?;
    let small =
        |_: &DVector<f64>, [before, after]: [f64; 2]| before - after <= LEAST_DECREASE * before;
    let damping = Damping {
        max_steps: 100,
        ..Damping::default()
    };
    let found = minimise(
        (start.clone(), first),
        &damping,
        |v| problem.at(v),
        |v, _, step| v + step,
        small,
    );
    match found.ending {
        Ending::Converged | Ending::Stalled => Ok((found.place, found.at.cost())),
        Ending::Singular => Err(failed("the lines do not determine its unknowns")),
        Ending::Exhausted => Err(failed("its steps ran out")),
    }
}
