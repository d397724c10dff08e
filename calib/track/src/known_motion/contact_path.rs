//! The way of an episode's contact for one state (s, x, g) of it.
//!
//! ```text
//! touch       P_0 = r0(s) + g n,   n = t0(s) x u / |t0(s) x u|                 u: unit vector of the push
//! place       P_k = Q_k (P_0 - x u) + d_k                                      Q_k, d_k: motion since the first loaded reading
//! ```

use super::field::MomentField;
use super::{Episode, MotionRow};
use crate::reading::squares;
use nalgebra::{Rotation3, Vector3};

/// State of an episode's contact.
#[derive(Debug, Clone, Copy)]
pub struct State {
    /// Arc length s at which the object first touches the free wire, mm.
    pub s_mm: f64,
    /// Displacement x along the push at first touch, mm.
    pub onset_mm: f64,
    /// Gap g between the free wire and the object's point at first touch, mm.
    pub gap_mm: f64,
}

/// Moment beyond which a reading is no longer that of a free wire, in standard deviations.
pub(crate) const LOADED_SDS: f64 = 4.0;
/// Smallest sine of the angle between push and wire: a push along the wire has no gap direction.
pub(crate) const ACROSS: f64 = 0.1;
/// Range of the onset before the first reading, mm.
pub(crate) const BEFORE_MM: f64 = 20.0;

/// An episode with its push direction, ready for states.
pub struct ContactPath<'a> {
    /// Moments of the wire.
    pub field: &'a MomentField,
    /// Readings.
    pub rows: &'a [MotionRow],
    /// The reading from which displacements count: the first loaded one.
    pub reference: &'a MotionRow,
    /// Unit vector of the push.
    pub push: Vector3<f64>,
}

/// Whether a reading is loaded beyond its noise.
pub(crate) fn loaded(row: &MotionRow) -> bool {
    // What a free wire would show: noise and the common errors at no load.
    let shown = || row.noise_nmm2.trace() + squares(&row.shared_nmm);
    let variance = row.free_nmm2.map_or_else(shown, |free| free.trace());
    let size = squares(&[row.moment_nmm]).sqrt();
    !row.free && size > LOADED_SDS * variance.max(0.0).sqrt()
}

/// By how much one standard deviation of each of the two shares q moves the touched point of an
/// object that has gone on by `moved_mm`, mm.
pub(crate) fn creep_mm(
    push: &Vector3<f64>,
    turn: &Rotation3<f64>,
    moved_mm: &Vector3<f64>,
    creep_sd: f64,
) -> [Vector3<f64>; 2] {
    // Not before the first load, to where the point has not come from anywhere.
    let way_mm = if moved_mm.dot(push) > 0.0 {
        moved_mm.norm()
    } else {
        0.0
    };
    // Any two directions across the push: the prior of both shares is the same.
    let least = Vector3::ith(push.iamin(), 1.0);
    let first = push.cross(&least).normalize();
    [first, push.cross(&first)].map(|e| turn * e * (creep_sd * way_mm))
}

impl<'a> ContactPath<'a> {
    /// None where no reading is loaded, or the motion has no direction.
    pub fn new(field: &'a MomentField, episode: &'a Episode) -> Option<Self> {
        let rows = &episode.rows[..];
        let first = rows.iter().position(loaded)?;
        let mut own = Self {
            field,
            rows,
            reference: &rows[first],
            push: Vector3::zeros(),
        };
        let push = episode.push.or_else(|| own.push_direction(first))?;
        own.push = push.try_normalize(1e-9)?;
        Some(own)
    }

    /// Displacement of a reading from the reference, mm; under rotation that of the wire's middle.
    pub(crate) fn displacement(&self, row: &MotionRow) -> Vector3<f64> {
        row.displacement_mm(self.reference, &self.field.middle_mm())
    }

    /// Direction of motion when the object first loads the wire, over a tenth of its largest
    /// displacement so that jitter does not set it.
    fn push_direction(&self, first: usize) -> Option<Vector3<f64>> {
        const SHARE: f64 = 0.1;
        let displacements: Vec<Vector3<f64>> =
            self.rows.iter().map(|row| self.displacement(row)).collect();
        let farthest = displacements.iter().map(Vector3::norm).fold(0.0, f64::max);
        let jitter = 3.0 * self.rows.iter().map(|r| r.moved_sd_mm).fold(0.0, f64::max);
        let enough = |w: &Vector3<f64>| w.norm() >= (SHARE * farthest).max(jitter).max(1e-9);
        // A displacement before the reference points back to where the object came from.
        let before = displacements[..first].iter().rev().map(|w| -w).find(enough);
        before.or_else(|| displacements[first..].iter().copied().find(enough))
    }

    /// Place at first touch and the direction of the gap; none where the push runs along the wire.
    pub(crate) fn touch(&self, state: &State) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (wire, tangent) = self.field.free(state.s_mm);
        let across = tangent.cross(&self.push).try_normalize(ACROSS)?;
        Some((wire + across * state.gap_mm, across))
    }

    /// Place of the object's point at a reading, mm.
    pub(crate) fn place(&self, state: &State, row: usize) -> Option<Vector3<f64>> {
        let (turn, displacement) = self.rows[row].since(self.reference);
        Some(turn * (self.touch(state)?.0 - self.push * state.onset_mm) + displacement)
    }

    /// State of an episode whose point is at `place_mm` at a reading: the inverse of
    /// [`Self::place`], near an arc length where it is given.
    pub fn state_of(
        &self,
        place_mm: &Vector3<f64>,
        row: usize,
        near_mm: Option<f64>,
    ) -> Option<State> {
        // The line of the push through the point at the reference reading.
        let (turn, displacement) = self.rows[row].since(self.reference);
        let origin = turn.inverse() * (place_mm - displacement);
        let steps = 2 * self.field.length_mm().ceil() as usize;
        // Squared distance of the free wire from that line: each of its minima over s is a state.
        let gap2 = |s: f64| {
            let off = self.field.free(s).0 - origin;
            (off - self.push * off.dot(&self.push)).norm_squared()
        };
        let grid: Vec<f64> = (1..=steps)
            .map(|k| self.field.length_mm() * k as f64 / steps as f64)
            .collect();
        let minimum = |k: &usize| {
            let here = gap2(grid[*k]);
            (*k == 0 || gap2(grid[k - 1]) >= here) && (*k + 1 == steps || gap2(grid[k + 1]) > here)
        };
        // Golden-section search.
        let refined = |k: usize| {
            let (mut a, mut b) = (grid[k.saturating_sub(1)], grid[(k + 1).min(steps - 1)]);
            for _ in 0..60 {
                let (c, d) = (b - 0.618_034 * (b - a), a + 0.618_034 * (b - a));
                if gap2(c) < gap2(d) { b = d } else { a = c }
            }
            0.5 * (a + b)
        };
        let found = (0..steps).filter(minimum).map(refined);
        let off = |s: f64| near_mm.map_or_else(|| gap2(s), |near| (s - near).abs());
        let s_mm = found.min_by(|a, b| off(*a).total_cmp(&off(*b)))?;
        let state = State {
            s_mm,
            onset_mm: 0.0,
            gap_mm: 0.0,
        };
        let (wire, across) = self.touch(&state)?;
        // Along the push and across it, off the free wire.
        // The origin is P_0 - x u = r0(s) + g n - x u, with n across u.
        let off = origin - wire;
        Some(State {
            s_mm,
            onset_mm: -off.dot(&self.push),
            gap_mm: off.dot(&across),
        })
    }
}
