//! The least-squares problem of the crate `levenberg-marquardt`; a place where the rod has no solution has no residuals.
//!
//! Residuals d_ki / sd_ki of each point's two transverse distances, (L_k - L) / sd_Lk of each length; Jacobian by central differences
//! (f(x + h) - f(x - h)) / 2 h, error O(h^2): an exact one would have to go through each wire's equilibrium.

use super::lines::{GuessedShape, distances};
use super::model::RestModel;
use crate::RodError;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, Owned};
use wcal_core::observation::WhiskerSpec;

/// Standard deviation of the length that a pair states, where it states none, mm.
const LENGTH_SD_MM: f64 = 0.05;

struct Problem<'a> {
    nominal: &'a WhiskerSpec,
    model: RestModel,
    difference_steps: Vec<f64>,
    shapes: &'a [GuessedShape<'a>],
    values: DVector<f64>,
}

impl Problem<'_> {
    fn residuals_at(&self, v: &DVector<f64>) -> Option<DVector<f64>> {
        if !self.model.is_admissible(v) {
            return None;
        }
        let mut all = Vec::new();
        for held in self.shapes {
            let (shape, across) = (held.shape, distances(self.nominal, self.model, v, held).ok()?);
            for ((_, d), sd) in across.iter().zip(&shape.sd_mm) {
                all.extend(d.map(|d| d / sd));
            }
            let sd = if shape.length_mm[1] > 0.0 { shape.length_mm[1] } else { LENGTH_SD_MM };
            all.push((shape.length_mm[0] - v[self.model.shape_unknowns() - 1]) / sd);
        }
        Some(DVector::from_vec(all))
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.values = x.clone();
    }

    fn params(&self) -> DVector<f64> {
        self.values.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        self.residuals_at(&self.values)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut columns = Vec::with_capacity(self.difference_steps.len());
        for (k, step) in self.difference_steps.iter().enumerate() {
            let mut up = self.values.clone();
            up[k] += step;
            let mut down = self.values.clone();
            down[k] -= step;
            columns.push((self.residuals_at(&up)? - self.residuals_at(&down)?) / (2.0 * step));
        }
        Some(DMatrix::from_columns(&columns))
    }
}

/// Best values, and the sum of squares there.
pub(super) fn solve(
    nominal: &WhiskerSpec,
    model: RestModel,
    start: &DVector<f64>,
    shapes: &[GuessedShape<'_>],
) -> Result<(DVector<f64>, f64), RodError> {
    let problem =
        Problem { nominal, model, difference_steps: model.difference_steps(), shapes, values: start.clone() };
    // Steps far below the standard deviations are not worth a Jacobian.
    let method = LevenbergMarquardt::new().with_patience(20).with_ftol(1e-9).with_xtol(1e-8);
    let (problem, report) = method.minimize(problem);
    if !report.termination.was_successful() {
        return Err(RodError::RestFit(format!(
            "the fit of a {} did not converge: {:?}",
            model.name(),
            report.termination
        )));
    }
    // The library's objective is half the sum.
    Ok((problem.values, 2.0 * report.objective_function))
}
