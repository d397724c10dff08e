//! The noise floor: pure error of replicates, else differences of neighbours.

use super::frame::{Declared, Frame, ways};
use crate::method::hypothesis::Hypothesis;

/// Floor of the response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// Standard deviation of one reading (of the geometric-mean spread where it varies).
    pub sd: f64,
    /// `replicates` or `difference`.
    pub source: &'static str,
}

/// Fewer degrees of freedom than this do not make a floor.
const MIN_DOF: usize = 8;

/// One key for readings that ought to agree: same stimulus, same direction.
#[must_use]
pub fn replicate_keys(frame: &Frame) -> Vec<u64> {
    keys(frame, frame.direction.as_deref())
}

/// The same by the way of the stimulus in the order of the table, where that is known: what repeats with the protocol.
#[must_use]
pub fn protocol_keys(frame: &Frame) -> Vec<u64> {
    let by_order = (frame.direction.is_none() && frame.ordered).then(|| ways(&frame.rows));
    keys(frame, by_order.as_deref().or(frame.direction.as_deref()))
}

fn keys(frame: &Frame, direction: Option<&[f64]>) -> Vec<u64> {
    let mut seen: Vec<(u64, bool)> = Vec::new();
    (0..frame.rows.len())
        .map(|i| {
            // + 0.0 turns -0 into 0.
            let down = direction.is_some_and(|d| d[i] < 0.0);
            let key = ((frame.rows[i].x + 0.0).to_bits(), down);
            match seen.iter().position(|s| *s == key) {
                Some(k) => k as u64,
                None => {
                    seen.push(key);
                    seen.len() as u64 - 1
                }
            }
        })
        .collect()
}

/// Floor from the residuals of the accepted explanation, so that drifts and temperature are out of it.
#[must_use]
pub fn noise_floor(frame: &Frame, h: &Hypothesis, shared: f64) -> Option<Floor> {
    // Residuals are whitened: what readings share is no part of their scatter, but of a new reading's.
    let whole = (1.0 + shared).sqrt();
    let residual: Vec<f64> = h.fit.residual.column(0).iter().copied().collect();
    let keys = replicate_keys(frame);
    let mut rows: Vec<usize> = (0..residual.len()).filter(|&i| h.weights.counts(i)).collect();
    if let Some(l) = crate::method::lack_of_fit::lack_of_fit(&residual, &keys, h.weights.relative(), 0)
        && l.pure_dof >= MIN_DOF as f64
    {
        return Some(Floor { sd: l.pure_sd * whole, source: "replicates" });
    }
    if frame.declared != Declared::Polynomial(0) {
        rows.sort_by(|&a, &b| frame.u[a].total_cmp(&frame.u[b]));
    }
    let pairs = rows.len().saturating_sub(1);
    let sum: f64 = rows.windows(2).map(|p| (residual[p[1]] - residual[p[0]]).powi(2) / 2.0).sum();
    (pairs >= MIN_DOF).then(|| Floor { sd: (sum / pairs as f64).sqrt() * whole, source: "difference" })
}
