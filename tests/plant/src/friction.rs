//! Dry friction of the contact: the wire sticks in the groove and slides, by the bench's table over
//! the drag (tangential over normal force).

use crate::table::Table;

/// Drags of a table that serves friction coefficients up to 0.48 (Chebyshev points).
pub fn friction_drags() -> Vec<f64> {
    let n = 7;
    (0..n)
        .map(|i| -0.5 * (std::f64::consts::PI * (i as f64 + 0.5) / n as f64).cos())
        .map(|d| if d.abs() < 1e-12 { 0.0 } else { d })
        .collect()
}

/// State of the contact with dry friction: the material point of the wire in the groove.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Grip {
    arclength_mm: Option<f64>,
}

impl Grip {
    /// Moves the groove to `stage_mm` and returns the moment (N mm) and the drag.
    ///
    /// The wire sticks while the drag lies inside the cone `mu` and else slides at its edge, so the
    /// contact's arc length is its old value clamped between those of the two slides.
    pub fn step(&mut self, table: &Table, stage_mm: f64, mu: f64) -> ([f64; 2], f64) {
        if stage_mm <= table.touch_mm() {
            self.arclength_mm = None;
            return ([0.0; 2], 0.0);
        }
        // More drag toward the tip leaves the contact nearer to the root.
        let (out, back) = (table.at(stage_mm, mu), table.at(stage_mm, -mu));
        let old = self.arclength_mm.unwrap_or(table.at(stage_mm, mu)[2]);
        let (at, drag) = if old <= out[2] {
            (out, mu)
        } else if old >= back[2] {
            (back, -mu)
        } else {
            let (mut low, mut high) = (-mu, mu);
            for _ in 0..40 {
                let mid = 0.5 * (low + high);
                if table.at(stage_mm, mid)[2] > old {
                    low = mid
                } else {
                    high = mid
                }
            }
            let drag = 0.5 * (low + high);
            (table.at(stage_mm, drag), drag)
        };
        self.arclength_mm = Some(if (drag - mu).abs() < 1e-9 || (drag + mu).abs() < 1e-9 {
            at[2]
        } else {
            old
        });
        ([at[0], at[1]], drag)
    }
}
