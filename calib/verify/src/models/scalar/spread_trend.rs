//! A spread of the readings that follows the stimulus: tested on the search's residuals, and the
//! search made again with it.

use super::stationarity::{UNSTEADY, stationarity};
use super::system::{ScalarSystem, relative_sd_at};
use crate::MeasurementModel;
use crate::levels::{REMARK, SPREAD};
use crate::method::{Hypothesis, Spread, heteroscedasticity_test, nuisance_basis};

/// Permutations of the test of the spread.
const PERMUTATIONS: usize = 4999;

/// Largest share of rounding in the variance.
const MAX_ROUNDING: f64 = 0.1;

/// Residuals of a fit, each divided by the share of its variance that the fit leaves; weighed by
/// stated uncertainties alone.
fn standardised(system: &ScalarSystem, h: &Hypothesis) -> Vec<f64> {
    let law = system.noise_inputs().known;
    let basis = nuisance_basis(&h.fit);
    (0..h.fit.residual.nrows())
        .map(|i| {
            // What neighbours share is taken out, the law of the spread is not.
            h.fit.residual[(i, 0)] / law[i].max(1e-300) / basis.unexplained_sd(i)
        })
        .collect()
}

/// Trend of the spread along the stimulus.
pub(super) fn test_spread(system: &ScalarSystem, h: &Hypothesis, seed: u64) -> Option<Spread> {
    let frame = &system.frame;
    // Rounding is a function of the value: where it is much of the noise, readings are near or far
    // as their marks lie, and no order is as likely.
    let step = system.step();
    if step.powi(2) / 12.0 > MAX_ROUNDING * h.fit.raw_residual.norm_squared() / h.fit.dof.max(1.0) {
        return None;
    }
    let kept: Vec<usize> = (0..frame.rows.len())
        .filter(|&i| h.weights.counts(i))
        .collect();
    let residual = standardised(system, h);
    let pick = |f: &dyn Fn(usize) -> f64| kept.iter().map(|&i| f(i)).collect::<Vec<f64>>();
    let x = pick(&|i| frame.rows[i].x);
    let mut spread = heteroscedasticity_test(
        &pick(&|i| residual[i]),
        Some(&x),
        &pick(&|i| frame.u[i]),
        PERMUTATIONS,
        seed,
    )?;
    // The law holds for readings that do not count, too.
    // Relative to the mean on the law's own scale: the geometric mean spread is one.
    let scale = spread.law.scale(frame);
    let centre = kept.iter().map(|&i| scale[i]).sum::<f64>() / kept.len() as f64;
    spread.relative_sd = relative_sd_at(frame, spread.law, spread.exponent, centre);
    Some(spread)
}

/// The same readings with the spread that `accepted` leaves; none where that is what they have. A
/// spread that does not outlive the effects which a search with it adds is given up for good.
pub(super) fn with_spread_of(
    system: &ScalarSystem,
    accepted: &Hypothesis,
    seed: u64,
) -> Option<ScalarSystem> {
    // What a model leaves where repeats contradict it grows where it is wrong: that is no noise.
    let contradicted = system
        .pure_error(accepted)
        .is_some_and(|l| l.is_significant());
    // Nor is it that a period which is not steady leaves more toward the ends.
    let steady = || stationarity(system, accepted).is_none_or(|s| s.z <= UNSTEADY);
    let found = test_spread(system, accepted, seed)
        .filter(|s| s.p_value <= SPREAD && !contradicted && !system.given_up_spread && steady());
    match (system.spread.as_ref(), found) {
        (None, Some(spread)) => Some(system.clone().with_spread(spread)),
        (Some(_), None) => Some(system.clone().without_spread()),
        _ => None,
    }
}

/// A trend of the spread too weak to be called an effect, in words.
pub(super) fn heteroscedasticity_note(
    system: &ScalarSystem,
    h: &Hypothesis,
    seed: u64,
) -> Option<String> {
    let p = test_spread(system, h, seed)
        .filter(|s| s.p_value <= REMARK)?
        .p_value;
    Some(format!(
        "The spread of the readings may change with the stimulus (p = {p:.1e}): too weak to be named."
    ))
}
