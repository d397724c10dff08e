//! The noise floor: pure error of replicates, else differences of neighbours. Readings that share
//! part of their noise differ by less than they scatter, and how much less depends on how far apart
//! in time they were taken:
//!
//! ```text
//! sum over sets of (r - mean)^2 = s^2 sum over sets of (tr C - 1'C 1 / n),      floor^2 = s^2 (1 + shared)
//! ```
//!
//! with C the covariance of a set's readings in units of the repeat noise s^2
//! (`method::noise::whitening`).

use super::frame::Frame;
use super::sequence::ways;
use super::system::ScalarSystem;
use crate::MeasurementModel;
use crate::method::{Hypothesis, Noise, Weights, members, settings};
use nalgebra::DVector;
use std::collections::BTreeMap;

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

/// One key for readings that ought to agree: every input is set alike (stimulus, further columns
/// that were set, direction).
pub(crate) fn replicate_keys(frame: &Frame) -> Vec<u64> {
    keys(frame, frame.direction.as_deref())
}

/// Keys of readings that repeat each other: set alike, or, where none is, at one place on either
/// way.
pub(crate) fn repeat_keys(frame: &Frame) -> Vec<u64> {
    let keys = replicate_keys(frame);
    let settings = keys.iter().max().map_or(0, |k| 1 + *k as usize);
    if keys.len() < settings + MIN_DOF {
        place_keys(frame)
    } else {
        keys
    }
}

/// The same by the way of the stimulus in the order of the table, where that is known: what repeats
/// with the protocol.
pub(crate) fn protocol_keys(frame: &Frame) -> Vec<u64> {
    let by_order = (frame.direction.is_none() && frame.ordered).then(|| ways(&frame.setting));
    keys(frame, by_order.as_deref().or(frame.direction.as_deref()))
}

/// One key for readings at the same place: every input is set alike but for the direction.
pub(crate) fn place_keys(frame: &Frame) -> Vec<u64> {
    keys(frame, None)
}

/// One key a setting of the stimulus, or of the further column `column`.
pub(crate) fn level_keys(frame: &Frame, column: Option<usize>) -> Vec<u64> {
    let of_column = column.and_then(|k| Some(settings(frame.covariates.get(k)?.as_ref()?)));
    let settings = of_column.as_ref().unwrap_or(&frame.setting);
    settings.iter().map(|k| *k as u64).collect()
}

fn keys(frame: &Frame, direction: Option<&[f64]>) -> Vec<u64> {
    let n = frame.rows.len();
    // A column that is another at every reading is watched, not set: it says nothing of what ought
    // to agree.
    let set = |of: &Vec<usize>| 2 * (of.iter().max().map_or(0, |m| m + 1)) <= n;
    let columns = frame.covariates.iter().flatten().map(|c| settings(c));
    let columns: Vec<Vec<usize>> = columns.filter(set).collect();
    let mut seen: BTreeMap<Vec<usize>, u64> = BTreeMap::new();
    let key = |i: usize| {
        let down = usize::from(direction.is_some_and(|d| d[i] < 0.0));
        let mut inputs = vec![frame.setting[i], down];
        inputs.extend(columns.iter().map(|c| c[i]));
        let next = seen.len() as u64;
        *seen.entry(inputs).or_insert(next)
    };
    (0..n).map(key).collect()
}

/// Floor from the residuals of the accepted explanation, so that drifts and temperature are out of
/// it.
pub fn noise_floor(system: &ScalarSystem, h: &Hypothesis, noise: &Noise) -> Option<Floor> {
    let frame = &system.frame;
    let shape = noise.weights_of(&system.noise_inputs());
    let counts = |i: &usize| h.weights.counts(*i);
    let scatter = Scatter { h, shape };
    // Readings of one stimulus and direction: n - 1 degrees of freedom a cell.
    let mut cells = members(&repeat_keys(frame), h.weights.relative());
    cells.retain(|cell| cell.len() > 1);
    let dof: usize = cells.iter().map(|cell| cell.len() - 1).sum();
    // Repeats do not show what they share: it is added again.
    let whole = (1.0 + noise.shared_variance()).sqrt();
    // Repeats of a coarse read-out may all be equal: they are as good as its rounding (GUM
    // F.2.2.1).
    let step = system.step();
    let floor = |sd: f64, source| Floor {
        sd: (sd * whole).max(step / 12f64.sqrt()),
        source,
    };
    if dof >= MIN_DOF {
        return Some(floor(
            scatter.repeat_sd(cells.iter().map(Vec::as_slice))?,
            "replicates",
        ));
    }
    // Neighbours in time differ by their noise; where the order is not known, neighbours in the
    // stimulus.
    let mut rows: Vec<usize> = (0..frame.u.len()).filter(counts).collect();
    if !frame.ordered {
        rows.sort_by(|&a, &b| frame.u[a].total_cmp(&frame.u[b]));
    }
    if rows.len() <= MIN_DOF {
        return None;
    }
    Some(floor(scatter.repeat_sd(rows.windows(2))?, "difference"))
}

/// How much readings of a set differ, and how much the noise lets them.
struct Scatter<'a> {
    h: &'a Hypothesis,
    /// Covariance of the readings' noise, repeat noise 1.
    shape: Weights,
}

impl Scatter<'_> {
    /// Repeat noise from the squares within sets; what readings of a set share is in neither side.
    fn repeat_sd<'b>(&self, sets: impl Iterator<Item = &'b [usize]>) -> Option<f64> {
        let (mut found, mut expected) = (0.0, 0.0);
        for set in sets {
            let weights = DVector::from_fn(set.len(), |k, _| self.h.weights.of(set[k]));
            let left = |k: usize, _| weights[k] * self.h.fit.raw_residual[(set[k], 0)];
            let weighted = DVector::from_fn(set.len(), left);
            found += weighted.add_scalar(-weighted.mean()).norm_squared();
            // E sum (r - mean)^2 = tr C - 1'C 1 / n.
            let c = self.shape.covariance(set);
            let c = c.component_mul(&(&weights * weights.transpose()));
            expected += c.trace() - c.sum() / set.len() as f64;
        }
        (expected > 0.0).then(|| (found / expected).sqrt())
    }
}
