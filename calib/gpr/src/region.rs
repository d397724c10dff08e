//! Where the map may be used.
//!
//! Valid where dist(s, hull) <= margin = share * max |s_i - s_j|: outside the hull the map
//! extrapolates, and its stated variance, which rests on the kernel alone, is no longer tested by
//! any left-out reading.

use crate::geometry::{convex_hull, diameter, distance_to_polygon};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Margin of the valid region as a share of the diameter of the readings.
const MARGIN: f64 = 0.1;

/// Convex hull of the readings (and of any declared domain) in the wavelength plane, grown by a
/// margin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ValidRegion {
    /// Always `hull`.
    #[schemars(extend("enum" = ["hull"]))]
    pub kind: String,
    /// Hull vertices, counter-clockwise, pm.
    pub vertices_pm: Vec<[f64; 2]>,
    /// A reading up to this far outside the hull is still valid, pm.
    pub margin_pm: f64,
}

impl ValidRegion {
    /// Hull of `readings` and `declared` (pm), grown by a share of its diameter.
    pub fn new(readings: &[[f64; 2]], declared: &[[f64; 2]]) -> Self {
        let vertices_pm = convex_hull(&[readings, declared].concat());
        Self {
            kind: "hull".into(),
            // In proportion to the cloud: wavelengths have no scale of their own here.
            margin_pm: MARGIN * diameter(&vertices_pm),
            vertices_pm,
        }
    }

    /// How far a reading lies outside the grown hull, pm; 0 inside. No allocation.
    pub fn outside_by_pm(&self, shift_pm: [f64; 2]) -> f64 {
        if !shift_pm.iter().all(|v| v.is_finite()) {
            return f64::INFINITY;
        }
        (distance_to_polygon(&self.vertices_pm, shift_pm) - self.margin_pm).max(0.0)
    }

    /// Largest distance between two valid readings, pm.
    pub(crate) fn diameter_pm(&self) -> f64 {
        // Two valid readings may lie a margin beyond opposite vertices.
        diameter(&self.vertices_pm) + 2.0 * self.margin_pm
    }
}
