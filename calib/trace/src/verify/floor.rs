//! Stage 1: the noise floor, from replicates or from differences of neighbours.

use crate::candidate::System;
use crate::engine::search::Hypothesis;
use crate::whisker::WhiskerSystem;
use std::collections::BTreeMap;

/// Floor of the wavelengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// Standard deviation of one reading, pm.
    pub sd_pm: f64,
    /// `replicates` or `difference`.
    pub source: &'static str,
    /// Degrees of freedom behind it.
    pub dof: f64,
}

/// Fewer degrees of freedom than this do not make a floor.
const LEAST_DOF: f64 = 10.0;

/// Pure error of the explanation's residuals: within groups of one pose, direction and speed, else between neighbours of a sweep.
/// Taking residuals rather than readings keeps accepted drifts and temperature out of it.
#[must_use]
pub fn noise_floor(system: &WhiskerSystem, h: &Hypothesis) -> Option<Floor> {
    let path = &system.path;
    let residual = &h.fit.raw_residual * system.channels_pm();
    let rows: Vec<usize> = (0..path.readings.len()).filter(|&i| h.weights.counts(i)).collect();
    let mut groups: BTreeMap<(u32, u32, i64, i64, i64), Vec<usize>> = BTreeMap::new();
    for &i in &rows {
        let r = &path.readings[i];
        let direction = if r.rest { 0 } else { r.direction as i64 };
        let key =
            (r.seating, r.group, (r.x_mm * 1e4).round() as i64, direction, (r.velocity_mm_s * 10.0) as i64);
        groups.entry(key).or_default().push(i);
    }
    let (mut sum, mut dof) = (0.0, 0.0);
    for members in groups.values().filter(|m| m.len() > 1) {
        for c in 0..residual.ncols() {
            let mean = members.iter().map(|&i| residual[(i, c)]).sum::<f64>() / members.len() as f64;
            sum += members.iter().map(|&i| (residual[(i, c)] - mean).powi(2)).sum::<f64>();
            dof += members.len() as f64 - 1.0;
        }
    }
    if dof >= LEAST_DOF {
        return Some(Floor { sd_pm: (sum / dof).sqrt(), source: "replicates", dof });
    }
    let (mut sum, mut dof) = (0.0, 0.0);
    for pair in rows.windows(2).filter(|p| path.readings[p[0]].group == path.readings[p[1]].group) {
        for c in 0..residual.ncols() {
            sum += (residual[(pair[1], c)] - residual[(pair[0], c)]).powi(2) / 2.0;
            // Overlapping differences of white noise carry two thirds of the information of separate ones.
            dof += 2.0 / 3.0;
        }
    }
    let count = dof * 1.5;
    (dof >= LEAST_DOF).then(|| Floor { sd_pm: (sum / count).sqrt(), source: "difference", dof })
}
