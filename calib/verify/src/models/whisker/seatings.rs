//! Several seatings of one sensor: what differs between them beyond the zero.

use super::system::WhiskerSystem;
use crate::MeasurementModel;
use crate::levels::REMARK;
use crate::method::{Fit, f_test, linear, sd_interval95};
use nalgebra::{DMatrix, DVector};
use wcal_core::verify_document::NoisePart;

/// Variation between seatings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeatingVariation {
    /// Seatings.
    pub count: u32,
    /// Standard deviation of the zeros, pm, per channel.
    pub zero_sd_pm: [f64; 2],
    /// The same over both channels with its 95 % interval, pm; the zeros' own errors are in it.
    pub session: NoisePart,
    /// p-value of one K for all seatings against one K a seating (F test, every effect of the
    /// accepted model kept).
    pub sensitivity_p: f64,
    /// Root mean square of the seatings' changes of K over the norm of K.
    pub sensitivity_change: f64,
}

/// Compares the seatings under `fit`; none with one seating, or where a K a seating cannot be
/// fitted.
pub fn spread_of_zeros(system: &WhiskerSystem, fit: &Fit) -> Option<SeatingVariation> {
    let count = system.seatings;
    let later = count as usize - 1;
    if later == 0 || fit.design.ncols() < 3 + later {
        return None;
    }
    let pm = system.channels_pm();
    let fitted_pm = &fit.coefficients * &pm;
    // Columns: constant, two moments, then the zeros of the later seatings (System::design).
    let zero_sd_pm = [0, 1].map(|c| {
        // The constant is the zero of the first seating: the others are differences from it.
        let zero = |k: usize, _| if k == 0 { 0.0 } else { fitted_pm[(2 + k, c)] };
        let zeros = DVector::from_fn(later + 1, zero);
        zeros.add_scalar(-zeros.mean()).norm() / (later as f64).sqrt()
    });
    let (n, q) = (fit.design.nrows(), fit.design.ncols());
    // Each later seating gets changes of both columns of K; F tests whether they lower the misfit.
    let own = 2 * later;
    let extended = DMatrix::from_fn(n, q + own, |i, j| {
        if j < q {
            fit.design[(i, j)]
        } else {
            let (k, m) = (1 + (j - q) / 2, 1 + (j - q) % 2);
            let own = system.path.readings[i].seating as usize == k;
            f64::from(u8::from(own)) * fit.design[(i, m)]
        }
    });
    let fitted = &fit.design * &fit.coefficients;
    let measured = &fit.residual + fitted;
    let (coefficients, residual, full_rank) = linear(&extended, &measured);
    if !full_rank {
        return None;
    }
    let channels = fit.residual.ncols();
    let sensitivity_p = f_test(
        fit.ssr - residual.norm_squared(),
        fit.ssr,
        fit.dof,
        own * channels,
    )?;
    let coefficients = coefficients * pm;
    let size = coefficients.rows(1, 2).norm();
    let changes = coefficients.rows(q, own).norm_squared() / later as f64;
    // Both channels' zeros as one: two seatings say little, and the interval shows it.
    let value = (0.5 * (zero_sd_pm[0].powi(2) + zero_sd_pm[1].powi(2))).sqrt();
    let session = NoisePart {
        value,
        interval95: sd_interval95(value, 2.0 * later as f64)?,
    };
    Some(SeatingVariation {
        count,
        zero_sd_pm,
        session,
        sensitivity_p,
        sensitivity_change: changes.sqrt() / size,
    })
}

impl SeatingVariation {
    /// One line for the notes.
    pub fn note(&self) -> String {
        let [a, b] = self.zero_sd_pm;
        let share = 100.0 * self.sensitivity_change;
        let verdict = if self.sensitivity_p < REMARK {
            format!(
                "their K differ by {share:.2} % (p = {:.1e}): the stated intervals of K hold within a seating only",
                self.sensitivity_p
            )
        } else {
            format!(
                "one K serves all (difference {share:.2} %, p = {:.2})",
                self.sensitivity_p
            )
        };
        format!(
            "{} seatings: their zeros vary by {a:.2} and {b:.2} pm (sd); {verdict}.",
            self.count
        )
    }
}
