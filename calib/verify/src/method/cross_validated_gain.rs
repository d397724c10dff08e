//! Does an effect earn its name on readings that were left out? With thousands of rows every small
//! misfit of the model of the recording itself is significant: what lowers the left-out error by
//! less than that gain scatters from group to group is within the model's error.
//!
//! ```text
//! e_g = r_g + J_g (J'J - J_g'J_g)^-1 J_g' r_g                residuals of group g from a fit without it (tangent model)
//! G = sum_g (|e_g without|^2 - |e_g with|^2) / s^2,          an effect is kept where G >= sd(G), from the spread over the groups
//! ```
//!
//! R. D. Cook, S. Weisberg, "Residuals and Influence in Regression" (1982), 2.2: deletion of
//! several cases.

use super::fit::Fit;
use super::hypothesis::Hypothesis;
use super::linear::transposed_product;
use crate::measurement_model::MeasurementModel;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// Fewest groups whose spread is an uncertainty.
const MIN_GROUPS: usize = 4;
/// Guards columns that a group alone shows.
const RIDGE: f64 = 1e-9;

/// Squares of what each group's readings leave when the group is not in the fit.
fn left_out_squares(system: &dyn MeasurementModel, fit: &Fit) -> Option<BTreeMap<u32, f64>> {
    let (n, channels) = fit.residual.shape();
    let (residual, mut jacobian) = (fit.stacked(), fit.jacobian());
    // Columns of one length: the ridge means the same to all.
    for mut column in jacobian.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    // The normal equations of all groups, from which one at a time is taken off.
    let whole = transposed_product(&jacobian, &jacobian)
        + DMatrix::identity(jacobian.ncols(), jacobian.ncols()) * RIDGE;
    let mut members: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (i, group) in system.groups().iter().enumerate() {
        members
            .entry(*group)
            .or_default()
            .extend((0..channels).map(|c| c * n + i));
    }
    // What a second witness saw belongs to the group of its reading.
    for (k, i) in system
        .auxiliary_readings()
        .iter()
        .enumerate()
        .take(residual.len() - n * channels)
    {
        members
            .entry(system.groups()[*i])
            .or_default()
            .push(n * channels + k);
    }
    let of_group = |(group, rows): (&u32, &Vec<usize>)| {
        let (own, r) = (jacobian.select_rows(rows), residual.select_rows(rows));
        let without = (&whole - transposed_product(&own, &own)).cholesky()?;
        // e_g of the module's head: no refit is needed, which is exact for the tangent model.
        let left_out = &r + &own * without.solve(&own.tr_mul(&r));
        Some((*group, left_out.norm_squared()))
    };
    members.iter().map(of_group).collect()
}

/// Fall of the left-out squares by an effect, in units of the variance, and its standard deviation;
/// none where it cannot be determined.
fn gain(system: &dyn MeasurementModel, with: &Fit, without: &Fit) -> Option<(f64, f64)> {
    let (a, b) = (
        left_out_squares(system, without)?,
        left_out_squares(system, with)?,
    );
    if a.len() < MIN_GROUPS {
        return None;
    }
    let each: Vec<f64> = a
        .iter()
        .zip(&b)
        .map(|(x, y)| (x.1 - y.1) / with.variance())
        .collect();
    let (count, sum) = (each.len() as f64, each.iter().sum::<f64>());
    // Groups count as independent: the variance of their sum is their number times the sample
    // variance.
    let spread = each.iter().map(|g| (g - sum / count).powi(2)).sum::<f64>() / (count - 1.0);
    Some((sum, (count * spread).sqrt()))
}

/// The effects of `h` that earn their names, and those that do not.
pub(crate) fn retain_cross_validated(
    system: &dyn MeasurementModel,
    h: &Hypothesis,
) -> (Hypothesis, Vec<usize>) {
    h.eliminate(system, |kept, dropped| {
        let ratio = |without: &Hypothesis| {
            let (sum, sd) = gain(system, &kept.fit, &without.fit)?;
            Some(sum / sd.max(1e-300))
        };
        let judged = dropped.into_iter().filter_map(|d| Some((ratio(&d.1)?, d)));
        // Less than one standard error of the gain between groups (Breiman et al. 1984).
        judged
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(ratio, _)| *ratio < 1.0)
            .map(|(_, d)| d)
    })
}

#[cfg(test)]
mod tests {
    use super::super::columns_system_test::ColumnsSystem;
    use super::super::fit::Weights;
    use super::*;

    /// Effects that are kept and dropped where `slope` of each group acts, ten groups of ten
    /// readings.
    fn judged(seed: u64, slope: impl Fn(usize) -> f64) -> (usize, Vec<usize>) {
        let x: Vec<f64> = (0..100).map(|i| (i % 10) as f64 / 4.5 - 1.0).collect();
        let clean: Vec<f64> = x
            .iter()
            .enumerate()
            .map(|(i, x)| slope(i / 10) * x)
            .collect();
        let system = ColumnsSystem::new(seed, vec![x], &clean);
        let h = Hypothesis::fitted(&system, &[ColumnsSystem::term(0)], &Weights::equal(100), 5)
            .unwrap();
        let (kept, within) = retain_cross_validated(&system, &h);
        (kept.fit.terms.len(), within)
    }

    #[test]
    fn a_name_is_earned_in_every_group_and_not_in_one() {
        for seed in 0..10 {
            assert_eq!(judged(seed, |_| 1.0), (1, Vec::new()), "{seed}");
            // The same sum of squares from one group alone: the others are predicted worse with it.
            assert_eq!(
                judged(seed, |group| if group == 3 { 5.0 } else { 0.0 }),
                (0, vec![0]),
                "{seed}"
            );
        }
    }
}
