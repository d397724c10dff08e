//! The stage's clock against the interrogator's: in motion a reading belongs to x + v delta, delta
//! the same for the whole session.
//!
//! A stage answers with its position, and the answer is stamped when it arrives: 1 to 3 ms after
//! the position was taken (some 25 characters at 115,200 baud; none on a network). A delta within
//! that is how the session was recorded, no effect: it is fitted beside K and the zero, and what it
//! leaves open is in the interval of a time lag.

use super::system::WhiskerSystem;
use crate::MeasurementModel;
use crate::levels::{NEGLIGIBLE, z};
use crate::method::{Fit, Hypothesis, nuisance_basis, stack_with};

/// Alignments beyond this are no matter of stamps, s: the answer's characters and what a unit takes
/// for them.
const MAX_CLOCK_S: f64 = 3e-3;
/// Standard deviation of the alignment of both clocks, s: root mean square of a delay that is
/// uniform up to the largest, sqrt(1/3).
pub(super) const CLOCK_SD_S: f64 = 0.577_350_269_189_625_8 * MAX_CLOCK_S;
/// Step of the derivative, s.
const STEP_S: f64 = 1e-3;

/// The alignment that `h` leaves in the readings, added to the system's own; the system's own where
/// nothing more is known or it is no alignment. `lagged`: the explanation has a time lag, which
/// takes up any alignment.
pub(super) fn estimate_alignment(system: &WhiskerSystem, h: &Hypothesis, lagged: bool) -> f64 {
    let before_s = system.stage_clock_s;
    if lagged || !system.is_read_in_motion() {
        return if lagged { 0.0 } else { before_s };
    }
    let Some((more_s, sd_s)) = residual_alignment(system, &h.fit, h) else {
        return before_s;
    };
    // More than stamps can explain is a lag, which the search has to name.
    let significant =
        more_s.abs() > z(NEGLIGIBLE) * sd_s && (before_s + more_s).abs() <= MAX_CLOCK_S;
    if significant {
        before_s + more_s
    } else {
        before_s
    }
}

/// Least-squares estimate of what remains, and its standard error, s.
fn residual_alignment(system: &WhiskerSystem, fit: &Fit, h: &Hypothesis) -> Option<(f64, f64)> {
    let moved = system
        .clone()
        .with_stage_clock(system.stage_clock_s + STEP_S);
    // One Gauss-Newton step along the clock: tangent, off what the fit takes up, then least squares.
    let change = (moved.design(&fit.terms)? - &fit.raw_design) * &fit.coefficients / STEP_S;
    let mut tangent = stack_with(&h.weights.apply(&change), &fit.auxiliary_residual);
    tangent
        .rows_mut(change.len(), fit.auxiliary_residual.len())
        .fill(0.0);
    let own = nuisance_basis(fit).project_off(&tangent);
    let size = own.norm_squared();
    (size > 0.0).then(|| {
        (
            own.dot(&fit.stacked()) / size,
            (fit.variance() / size).sqrt(),
        )
    })
}
