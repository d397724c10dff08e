//! Inverse solutions of one sample, and their derivatives from node to node.
//!
//! With `p_k` and `n_k` the point and the direction of the force at node k, a contact at offset x
//! within the node is at
//!
//! ```text
//! p(x) = p_k + x p'_k,   n(x) = n_k + x n'_k,   p'_k = (p_{k+1} - p_{k-1}) / 2,   n'_k likewise
//! ```
//!
//! (central differences; one-sided at the end of the wire, where the curve bends).

use super::grid_cell::GridCell;
use crate::inverse::InverseSolution;
use nalgebra::Vector3;

/// Inverse solutions of a sample with the derivatives of point and force by the node.
pub(super) struct SampleGeometry<'a> {
    pub solutions: &'a [InverseSolution],
    /// Derivative of the point by the node, mm.
    pub point_slopes: Vec<Vector3<f64>>,
    /// Derivative of the direction of the force by the node.
    pub normal_slopes: Vec<Vector3<f64>>,
    /// Its size, rad, and the sum over the tip's nodes.
    pub turns: Vec<f64>,
    /// See `turns`.
    pub tip_turn: f64,
    /// Axis about which a force at the node cannot turn without moments that turn: across the curve
    /// and the force.
    pub turn_axes: Vec<Option<Vector3<f64>>>,
}

/// A contact at an offset within a node.
pub(super) struct ContactState<'c> {
    pub point_mm: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub point_slope: Vector3<f64>,
    pub normal_slope: Vector3<f64>,
    pub cell: &'c GridCell,
    pub node: usize,
    pub compliance_mm_per_nmm: f64,
    pub turn_rad_per_nmm: f64,
}

impl ContactState<'_> {
    /// The same point of the object after the base's travel along its +z, mm.
    pub(crate) fn carried(self, travel_mm: f64) -> Self {
        Self {
            point_mm: self.point_mm - Vector3::z() * travel_mm,
            ..self
        }
    }
}

/// Half the difference between a node's neighbours; not over the end of the wire, where the curve
/// bends.
fn central_difference(
    all: &[InverseSolution],
    k: usize,
    first_tip: usize,
    of: fn(&InverseSolution) -> Vector3<f64>,
) -> Vector3<f64> {
    let (mut low, mut high) = (k.saturating_sub(1), (k + 1).min(all.len() - 1));
    if k + 1 == first_tip {
        high = k;
    } else if k == first_tip {
        low = k;
    }
    (of(&all[high]) - of(&all[low])) / (high - low).max(1) as f64
}

impl<'a> SampleGeometry<'a> {
    pub(crate) fn new(solutions: &'a [InverseSolution], first_tip: usize) -> Self {
        let slopes = |of: fn(&InverseSolution) -> Vector3<f64>| -> Vec<Vector3<f64>> {
            (0..solutions.len())
                .map(|k| central_difference(solutions, k, first_tip, of))
                .collect()
        };
        let (point_slopes, normal_slopes) = (slopes(|c| c.point_mm), slopes(|c| c.normal));
        let turns: Vec<f64> = normal_slopes.iter().map(Vector3::norm).collect();
        let tip_turn = turns[first_tip.min(turns.len())..].iter().sum();
        let turn_axis = |(k, c): (usize, &InverseSolution)| {
            // At the tip the force tilts in the plane of r and n: this axis is across it.
            let along = if k < first_tip {
                &point_slopes[k]
            } else {
                &c.point_mm
            };
            along.cross(&c.normal).try_normalize(1e-12)
        };
        let turn_axes = solutions.iter().enumerate().map(turn_axis).collect();
        Self {
            solutions,
            point_slopes,
            normal_slopes,
            turns,
            tip_turn,
            turn_axes,
        }
    }

    /// The contact that a cell of node `k` means.
    pub(crate) fn contact<'c>(&self, k: usize, cell: &'c GridCell) -> ContactState<'c> {
        let c = &self.solutions[k];
        ContactState {
            point_mm: c.point_mm + self.point_slopes[k] * cell.offset,
            normal: c.normal + self.normal_slopes[k] * cell.offset,
            point_slope: self.point_slopes[k],
            normal_slope: self.normal_slopes[k],
            cell,
            node: k,
            compliance_mm_per_nmm: c.compliance_mm_per_nmm,
            turn_rad_per_nmm: c.turn_rad_per_nmm,
        }
    }
}
