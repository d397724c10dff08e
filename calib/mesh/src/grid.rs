//! Distances of a surface at the middles of a grid's cells, filled where they are asked for.
//!
//! |d(p) - d(q)| <= |p - q| (a distance is 1-Lipschitz), so d(middle) -+ |p - middle| bounds d(p): most questions about a wire that passes an object
//! are answered "far" by the cell, and the others are searched no farther than the cell allows.
//! Answers stay exact.

use nalgebra::Vector3;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Smallest cell, mm; most cells along the longest side; room around the object, mm.
const CELL_MM: f64 = 2.5;
const MAX_CELLS: f64 = 48.0;
const ROOM_MM: f64 = 10.0;
/// Single precision of a distance of some hundred millimetres, and rounding of the search, mm.
const ROUNDING_MM: f64 = 1e-3;

/// The grid; copies share what they found.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    low_mm: Vector3<f64>,
    cell_mm: f64,
    cells: [usize; 3],
    /// Bits of a single-precision distance; NaN: not asked for yet.
    distance_mm: Arc<[AtomicU32]>,
}

impl Grid {
    pub(crate) fn new(low_mm: &Vector3<f64>, high_mm: &Vector3<f64>) -> Self {
        let room = Vector3::repeat(ROOM_MM);
        let size = high_mm - low_mm + room * 2.0;
        let cell_mm = CELL_MM.max(size.max() / MAX_CELLS);
        let cells = [0, 1, 2].map(|k| (size[k] / cell_mm).ceil().max(1.0) as usize);
        let unknown = f32::NAN.to_bits();
        let distance_mm = (0..cells.iter().product())
            .map(|_| AtomicU32::new(unknown))
            .collect();
        Self {
            low_mm: low_mm - room,
            cell_mm,
            cells,
            distance_mm,
        }
    }

    /// Bounds of the signed distance at `p`: at least, and at most in size. `exact` tells it at a
    /// cell's middle. None outside the grid or where `exact` knows nothing.
    pub(crate) fn bounds_mm(
        &self,
        p: &Vector3<f64>,
        exact: impl Fn(&Vector3<f64>) -> Option<f64>,
    ) -> Option<[f64; 2]> {
        let at = (p - self.low_mm) / self.cell_mm;
        let mut index = 0;
        let mut middle = Vector3::zeros();
        for k in 0..3 {
            if !(at[k] >= 0.0 && at[k] < self.cells[k] as f64) {
                return None;
            }
            let cell = at[k] as usize;
            // Row-major, x slowest.
            index = index * self.cells[k] + cell;
            middle[k] = self.low_mm[k] + (cell as f64 + 0.5) * self.cell_mm;
        }
        // Whichever thread fills a cell finds the same distance: no order is needed.
        let known = f32::from_bits(self.distance_mm[index].load(Ordering::Relaxed));
        let distance_mm = if known.is_nan() {
            let found = exact(&middle)?;
            self.distance_mm[index].store((found as f32).to_bits(), Ordering::Relaxed);
            found as f32
        } else {
            known
        };
        let (distance_mm, way_mm) = (f64::from(distance_mm), (p - middle).norm() + ROUNDING_MM);
        Some([distance_mm - way_mm, distance_mm.abs() + way_mm])
    }
}
