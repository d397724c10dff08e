//! How fine the table of an inverse is.

use crate::error::NetworkError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::ranges::Range;

/// Touched point and normal of an entry, and whether a force there can give the moments.
pub(super) type TableEntry = ([f32; 6], bool);

/// How fine the table is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct InverseGrid {
    /// First arc length and distance of the nodes, mm; the last is the tip.
    pub first_mm: f64,
    /// Distance of the nodes, mm.
    pub step_mm: f64,
    /// Nodes for each one at which the rod is solved; those between are interpolated.
    pub refine: usize,
    /// Tilts of the force at the tip: equal steps from perpendicular to the wire to straight at the
    /// root, without the last one.
    pub tilts: usize,
    /// Directions of the moment around the root.
    pub directions: usize,
    /// Largest moment, N mm, and its steps.
    pub max_nmm: f64,
    /// Its steps.
    pub steps: usize,
    /// Links of the wire.
    pub links: usize,
}

impl Default for InverseGrid {
    fn default() -> Self {
        Self {
            first_mm: 4.0,
            step_mm: 1.0,
            refine: 4,
            tilts: 9,
            directions: 48,
            max_nmm: 3.2,
            steps: 32,
            links: 40,
        }
    }
}

/// Numbers that a grid may state.
pub const GRID_RANGES: &[Range] = &[
    Range::real("inverse.first_mm", 0.1, 1000.0),
    Range::real("inverse.step_mm", 0.01, 1000.0),
    Range::whole("inverse.refine", 1.0, 64.0),
    Range::whole("inverse.tilts", 0.0, 64.0),
    Range::whole("inverse.directions", 4.0, 720.0),
    Range::real("inverse.max_nmm", 1e-6, 1e4),
    Range::whole("inverse.steps", 2.0, 1024.0),
    Range::whole("inverse.links", 2.0, 1000.0),
];
/// Equilibria of links that a table may ask for; the default one asks for 4 million.
const MAX_LINK_SOLUTIONS: f64 = 1e8;
/// Entries of a table, 28 bytes each.
const MAX_ENTRIES: f64 = 2e7;

impl InverseGrid {
    /// # Errors
    /// Where the table of a wire of this length would take hours or gigabytes.
    pub(super) fn check(&self, length_mm: f64) -> Result<(), NetworkError> {
        let places = (length_mm / self.step_mm).max(1.0) + self.tilts as f64;
        let solutions = places * (self.directions * (self.steps + 1)) as f64;
        // The rod is solved at the coarse nodes alone; refined ones are entries without a solution.
        let (work, entries) = (
            solutions * self.links as f64,
            solutions * self.refine as f64,
        );
        if work <= MAX_LINK_SOLUTIONS && entries <= MAX_ENTRIES {
            return Ok(());
        }
        let expected = format!(
            "at most {MAX_ENTRIES:e} entries and {MAX_LINK_SOLUTIONS:e} times a link (step_mm, refine, tilts, directions, steps, links)"
        );
        Err(NetworkError::value(
            "inverse",
            expected,
            format!("{entries:.1e} and {work:.1e}"),
        ))
    }

    /// A table that is built in a quarter of the time: 19 of 20 places are within
    /// 0.08 mm of the default's (tests of `arc`), enough for regions of millimetres.
    pub fn coarse() -> Self {
        Self {
            step_mm: 2.0,
            refine: 8,
            tilts: 4,
            directions: 24,
            ..Self::default()
        }
    }
}
