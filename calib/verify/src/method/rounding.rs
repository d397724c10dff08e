//! Readings in coarse steps: a model that passes within half a step of every reading is not
//! contradicted by any of them.
//!
//! ```text
//! least t with |y - X b| <= t  for all readings          (Chebyshev; a linear programme)
//! t <= h / 2 + 3 s:  the readings are the model's, rounded to the step h (GUM F.2.2.1)
//! v = 0.564 s h:     variance within settings of what a noise s << h moves over the next mark
//! ```
//!
//! 0.564 is the integral of Phi (1 - Phi). Where repeats scatter as widely as a step allows, noise
//! dithers the rounding away and the tests of white noise hold.

use super::fit::{Fit, Weights};
use super::range_check::minimise;
use crate::measurement_model::MeasurementModel;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// Integral of the chances of either side of a mark over its place, in noises.
const MOVED: f64 = 0.564;
/// Largest noise beyond half a step, in standard deviations.
const REACH: f64 = 3.0;

/// Mean square of what remains, beside that of rounding, from which on something else is most of
/// it.
const MAX_LEFT: f64 = 4.0;

/// The readings are those of the fitted model, rounded: of one channel, and where rounding is most
/// of their noise.
pub(crate) fn is_rounding(system: &dyn MeasurementModel, fit: &Fit, weights: &Weights) -> bool {
    let measured = system.measured();
    let Some(step) = system.noise_inputs().step.first().copied().flatten() else {
        return false;
    };
    let rows: Vec<usize> = (0..measured.nrows())
        .filter(|&i| weights.counts(i))
        .collect();
    // Variance of a uniform error within a step.
    let rounding = step * step / 12.0;
    let left: f64 = rows.iter().map(|&i| fit.raw_residual[(i, 0)].powi(2)).sum();
    if measured.ncols() != 1 || left > MAX_LEFT * rounding * rows.len() as f64 {
        return false;
    }
    let design = &fit.raw_design;
    // Readings of equal columns are repeats.
    let mut settings: BTreeMap<Vec<u64>, Vec<f64>> = BTreeMap::new();
    for &i in &rows {
        let key = design.row(i).iter().map(|v| v.to_bits()).collect();
        settings.entry(key).or_default().push(measured[(i, 0)]);
    }
    let within: f64 = settings
        .values()
        .map(|y| {
            let mean = y.iter().sum::<f64>() / y.len() as f64;
            y.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
        })
        .sum();
    let variance = within / ((rows.len() - settings.len()).max(1) as f64);
    // v = 0.564 s h solved for the noise s, which the repeats show only where it moves a digit.
    let noise = variance / (MOVED * step);
    variance < rounding
        && least_distance(fit, &rows)
            .is_some_and(|t| t <= 0.5 * step * (1.0 + 1e-6) + REACH * noise)
}

/// Largest distance of a reading from the model that comes nearest to all of them, by the free
/// coefficients.
fn least_distance(fit: &Fit, rows: &[usize]) -> Option<f64> {
    let design = &fit.raw_design;
    let residual = &fit.raw_residual;
    let largest = rows
        .iter()
        .map(|&i| residual[(i, 0)].abs())
        .fold(0.0, f64::max);
    if !(largest > 0.0) {
        return Some(0.0);
    }
    let count = design.ncols();
    let size: Vec<f64> = design.column_iter().map(|c| c.amax().max(1e-300)).collect();
    let (mut sides, mut bounds) = (Vec::new(), Vec::new());
    for &i in rows {
        for sign in [1.0, -1.0] {
            // Chebyshev: |y - X b| <= t as two sides a reading, t the last unknown.
            let column = |j: usize| (j, sign * design[(i, j)] / size[j]);
            sides.push((0..count).map(column).chain([(count, -1.0)]).collect());
            bounds.push(sign * residual[(i, 0)] / largest);
        }
    }
    let linear: Vec<f64> = (0..=count)
        .map(|j| f64::from(u8::from(j == count)))
        .collect();
    let found = minimise(
        &DMatrix::zeros(count + 1, count + 1),
        &linear,
        &sides,
        &bounds,
    )?;
    Some(found[count] * largest)
}
