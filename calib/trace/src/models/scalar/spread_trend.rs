//! A spread of the readings that follows the stimulus: tested on the search's residuals, and the search made again with it.

use super::frame::Frame;
use super::stationarity::{UNSTEADY, stationarity};
use super::system::ScalarSystem;
use super::table::in_place_of_laws;
use crate::method::explain::{Explained, explain};
use crate::method::hypothesis::Hypothesis;
use crate::method::noise::spread::{SPREAD_LEVEL, SPREAD_REMARK, Spread, spread_test};
use crate::method::omnibus::LACK_OF_FIT_LEVEL;
use crate::method::signature::nuisance;
use crate::verify::VerifyOptions;

/// Permutations of the test of the spread.
const PERMUTATIONS: usize = 4999;

/// Residuals of a fit, each divided by the share of its variance that the fit leaves; unweighted.
fn standardised(h: &Hypothesis) -> Vec<f64> {
    let basis = nuisance(&h.fit);
    (0..h.fit.residual.nrows())
        .map(|i| {
            let leverage: f64 = basis.vectors().iter().map(|q| q[i] * q[i]).sum();
            // What neighbours share is taken out, the law of the spread is not.
            let own = h.weights.of(i).max(1e-300);
            h.fit.residual[(i, 0)] / own / (1.0 - leverage).max(0.05).sqrt()
        })
        .collect()
}

/// Trend of the spread along the stimulus.
pub(super) fn test_spread(frame: &Frame, h: &Hypothesis, options: &VerifyOptions) -> Option<Spread> {
    let kept: Vec<usize> = (0..frame.rows.len()).filter(|&i| h.weights.counts(i)).collect();
    let residual = standardised(h);
    let pick = |f: &dyn Fn(usize) -> f64| kept.iter().map(|&i| f(i)).collect::<Vec<f64>>();
    let x = pick(&|i| frame.rows[i].x);
    let mut spread = spread_test(
        &pick(&|i| residual[i]),
        Some(&x),
        &pick(&|i| frame.u[i]),
        PERMUTATIONS,
        options.search.seed,
    )?;
    // Readings that do not count keep the mean spread.
    let mut relative = vec![1.0; frame.rows.len()];
    for (&i, sd) in kept.iter().zip(&spread.relative_sd) {
        relative[i] = *sd;
    }
    spread.relative_sd = relative;
    Some(spread)
}

/// The search with the spread that it shows, and a table of errors where the places of an axis ask for one.
pub(super) fn explain_session(
    system: ScalarSystem,
    options: &VerifyOptions,
) -> Option<(ScalarSystem, Explained)> {
    let mut plain = explain(&system, &options.search)?;
    // The spread that a wrong law leaves is no law of the noise: the table comes first.
    if in_place_of_laws(&system, &mut plain, options) {
        return Some((system, plain));
    }
    explain_with_spread(system, plain, options)
}

/// `plain` is the search with equal weights; where the spread turns out to follow the stimulus, again with the readings weighted by it.
fn explain_with_spread(
    system: ScalarSystem,
    plain: Explained,
    options: &VerifyOptions,
) -> Option<(ScalarSystem, Explained)> {
    // A period that is not steady leaves more toward the ends: that is no law of the noise.
    let of = |e: &Explained, system: &ScalarSystem| {
        test_spread(&system.frame, &e.found.best, options)
            .filter(|s| s.p_value <= SPREAD_LEVEL)
            .filter(|_| stationarity(system, &e.found.best).is_none_or(|s| s.z <= UNSTEADY))
    };
    // What a model leaves where repeats contradict it grows where it is wrong: that is no noise either.
    let contradicted = system.pure_error(&plain.found.best).is_some_and(|l| l.p_value < LACK_OF_FIT_LEVEL);
    let Some(spread) = of(&plain, &system).filter(|_| !plain.exact && !contradicted) else {
        return Some((system, plain));
    };
    let weighted_system = system.with_spread(spread.clone());
    let weighted = explain(&weighted_system, &options.search)?;
    // The trend must outlive the effects that the weighted search adds.
    match of(&weighted, &weighted_system) {
        Some(again) => {
            let spread = Spread { relative_sd: spread.relative_sd, ..again };
            Some((weighted_system.with_spread(spread), weighted))
        }
        None => Some((weighted_system.without_spread(), plain)),
    }
}

/// A trend of the spread too weak to be called an effect, in words.
pub(super) fn weak_trend(system: &ScalarSystem, h: &Hypothesis, options: &VerifyOptions) -> Option<String> {
    let p = test_spread(&system.frame, h, options).filter(|s| s.p_value <= SPREAD_REMARK)?.p_value;
    Some(format!(
        "The spread of the readings may change with the stimulus (p = {p:.1e}): too weak to be named."
    ))
}
