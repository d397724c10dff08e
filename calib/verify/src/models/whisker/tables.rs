//! Moments along one line on a grid of stage position: frictionless, and the slip branches beside
//! it.

use wcal_core::interpolation::cubic;

/// Values on a uniform grid of stage position.
#[derive(Debug, Clone, PartialEq)]
pub struct LineTable {
    /// First touch, mm; the moment is zero before it.
    pub touch_mm: f64,
    /// Grid spacing, mm.
    pub step_mm: f64,
    /// Moment components, N mm.
    pub moments_nmm: Vec<[f64; 2]>,
    /// Contact arc length, mm.
    pub arclength_mm: Vec<f64>,
    /// Last stage position of the branch, mm; beyond it the model has no answer.
    pub end_mm: f64,
}

fn bracket(x: f64, len: usize) -> (usize, [f64; 4]) {
    let j = (x.floor().max(0.0) as usize).clamp(1, len.saturating_sub(3).max(1));
    (j - 1, cubic(x - j as f64))
}

impl LineTable {
    /// Moment components at stage position `x_mm`, N mm; none past the end of the branch.
    pub fn moment(&self, x_mm: f64) -> Option<[f64; 2]> {
        if x_mm <= self.touch_mm {
            return Some([0.0; 2]);
        }
        if x_mm > self.end_mm + 1e-9 {
            return None;
        }
        // Cubic between the four nearest nodes: the error falls with the fourth power of the grid.
        let x = (x_mm - self.touch_mm) / self.step_mm;
        let (j, w) = bracket(x, self.moments_nmm.len());
        Some([0, 1].map(|c| (0..4).map(|k| w[k] * self.moments_nmm[j + k][c]).sum()))
    }

    /// Contact arc length at stage position `x_mm`, mm.
    pub fn arclength(&self, x_mm: f64) -> f64 {
        let x = x_mm.clamp(self.touch_mm, self.end_mm);
        let (j, w) = bracket((x - self.touch_mm) / self.step_mm, self.arclength_mm.len());
        (0..4).map(|k| w[k] * self.arclength_mm[j + k]).sum()
    }
}

/// Slip branches of one line: tables over (stage position, tangential over normal force).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SlipTable {
    pub(super) touch_mm: f64,
    pub(super) step_mm: f64,
    /// Ratios, ascending, symmetric about 0.
    pub(super) ratios: Vec<f64>,
    /// By stage position.
    pub(super) rows: Vec<SlipRow>,
}

/// Slip branches at one stage position, by ratio.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SlipRow {
    /// Arc length, mm.
    pub arclength_mm: Vec<f64>,
    /// Moments, N mm.
    pub moments_nmm: Vec<[f64; 2]>,
    /// Least and largest ratio with an equilibrium: friction beyond it lets the wire snap out of
    /// the groove.
    pub held: [f64; 2],
}

impl SlipRow {
    /// At first touch: no load at one place.
    pub(super) fn untouched(arclength_mm: f64, width: usize) -> Self {
        Self {
            arclength_mm: vec![arclength_mm; width],
            moments_nmm: vec![[0.0; 2]; width],
            held: [-MAX_RATIO, MAX_RATIO],
        }
    }
}

/// Friction coefficients up to 0.4, raised by 1/sin(45 deg) for the two walls of the groove, with
/// room to fit.
pub(super) const MAX_RATIO: f64 = 0.72;
pub(super) const RATIO_STEPS: usize = 4;

impl SlipTable {
    fn at(&self, x_mm: f64, pick: impl Fn(usize, usize) -> f64, ratio: f64) -> f64 {
        let x = (x_mm - self.touch_mm).max(0.0) / self.step_mm;
        let (j, w) = bracket(x, self.rows.len());
        let dr = self.ratios[1] - self.ratios[0];
        let (k, v) = bracket((ratio - self.ratios[0]) / dr, self.ratios.len());
        // Tensor product of four-point Lagrange weights: cubic in the stage's position and in the
        // ratio.
        let nodes = (0..4).flat_map(|a| (0..4).map(move |b| (a, b)));
        nodes.map(|(a, b)| pick(j + a, k + b) * (w[a] * v[b])).sum()
    }

    pub(super) fn arclength(&self, x_mm: f64, ratio: f64) -> f64 {
        self.at(x_mm, |i, k| self.rows[i].arclength_mm[k], ratio)
    }

    pub(super) fn moment(&self, x_mm: f64, ratio: f64) -> [f64; 2] {
        [0, 1].map(|c| self.at(x_mm, |i, k| self.rows[i].moments_nmm[k][c], ratio))
    }

    /// Whether there is an equilibrium with this ratio: at both neighbours in the table.
    pub(super) fn has_equilibrium(&self, x_mm: f64, ratio: f64) -> bool {
        let x = (x_mm - self.touch_mm).max(0.0) / self.step_mm;
        let row = |x: f64| &self.rows[(x as usize).min(self.rows.len() - 1)];
        [row(x.floor()), row(x.ceil())]
            .iter()
            .all(|r| (r.held[0]..=r.held[1]).contains(&ratio))
    }

    /// Ratio at which the contact sits at `s_mm`, by bisection inside +-`limit`; arc length is
    /// monotone in the ratio.
    pub(super) fn ratio_at(&self, x_mm: f64, s_mm: f64, limit: f64) -> f64 {
        // Which way the arc length goes with the ratio depends on the side of the groove.
        let rising = self.arclength(x_mm, limit) >= self.arclength(x_mm, -limit);
        let (mut lo, mut hi) = (-limit, limit);
        // 40 halvings leave 1e-12 of the bracket.
        for _ in 0..40 {
            let mid = 0.5 * (lo + hi);
            if (self.arclength(x_mm, mid) < s_mm) == rising {
                lo = mid
            } else {
                hi = mid
            }
        }
        0.5 * (lo + hi)
    }

    /// One move of the groove to `x_mm`: the contact sticks until the cone's edge, then slips along
    /// it.
    pub(super) fn advance(&self, x_mm: f64, friction: f64, contact_mm: &mut f64) {
        let (a, b) = (
            self.arclength(x_mm, -friction),
            self.arclength(x_mm, friction),
        );
        // Coulomb: inside the cone the contact stays, at its edge it slips with it.
        *contact_mm = contact_mm.clamp(a.min(b), a.max(b));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where friction lets the wire snap out of the groove at the deeper of two positions, no
    /// contact is held between them.
    #[test]
    fn a_lost_branch_holds_nothing() {
        let row = SlipRow::untouched(40.0, 2 * RATIO_STEPS + 1);
        let lost = SlipRow {
            held: [-0.54, MAX_RATIO],
            ..row.clone()
        };
        let ratios = (0..=2 * RATIO_STEPS)
            .map(|k| MAX_RATIO * (k as f64 / RATIO_STEPS as f64 - 1.0))
            .collect();
        let table = SlipTable {
            touch_mm: 10.0,
            step_mm: 2.0,
            ratios,
            rows: vec![row.clone(), row, lost.clone(), lost],
        };
        assert!(
            table.has_equilibrium(11.0, -0.7)
                && table.has_equilibrium(13.0, -0.5)
                && table.has_equilibrium(15.0, 0.7)
        );
        // Control: beyond what is held.
        assert!(!table.has_equilibrium(13.0, -0.6) && !table.has_equilibrium(15.0, -0.7));
    }
}
