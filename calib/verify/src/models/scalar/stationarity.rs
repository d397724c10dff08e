//! Is an accepted period the same in both halves of the session?

use super::effects::PERIODIC;
use super::system::ScalarSystem;
use crate::method::{Hypothesis, covariance, fit};
use crate::{EffectTerm, MeasurementModel};
use wcal_core::order_statistics::median;

/// Cycles over the whole range, fitted to each half of the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stationarity {
    /// Cycles over the whole range by the first and the second half.
    pub cycles: [f64; 2],
    /// Standard errors.
    pub standard_errors: [f64; 2],
    /// Difference in standard errors.
    pub z: f64,
}

/// Beyond this many standard errors the frequency is not steady.
pub(crate) const UNSTEADY: f64 = 3.0;
/// Readings in a half below which the comparison says nothing.
const MIN_HALF: usize = 15;

/// Refits the accepted explanation on each half, in the order of its variable. None without a
/// periodic effect.
pub fn stationarity(system: &ScalarSystem, h: &Hypothesis) -> Option<Stationarity> {
    let free = |t: &EffectTerm| system.catalogue()[t.effect].id == PERIODIC && !t.values.is_empty();
    let place = h.fit.terms.iter().position(free)?;
    let term = &h.fit.terms[place];
    let slot: usize = h.fit.terms[..place].iter().map(|t| t.values.len()).sum();
    let frame = &system.frame;
    let variable: &[f64] = match term.law {
        0 => &frame.u,
        1 => frame.time.as_deref()?,
        _ => &frame.order,
    };
    // Halves of equal information: as many readings on either side.
    let middle = median(variable.iter().copied())?;
    let half = |late: bool| {
        let kept = h.weights.masked(|i| (variable[i] >= middle) == late);
        if kept.active() < MIN_HALF {
            return None;
        }
        let fitted = fit(system, &h.fit.terms, &kept, 25)?;
        let at = fitted.design.ncols() + slot;
        let error = covariance(&fitted, fitted.variance())[(at, at)]
            .max(0.0)
            .sqrt();
        Some((fitted.terms[place].values[0], error))
    };
    let ((a, sa), (b, sb)) = (half(false)?, half(true)?);
    // The halves share no reading: their errors add in squares.
    let z = (b - a).abs() / sa.hypot(sb).max(1e-300);
    Some(Stationarity {
        cycles: [a, b],
        standard_errors: [sa, sb],
        z,
    })
}
