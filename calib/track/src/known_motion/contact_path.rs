//! Moments along an episode for one state (s, x, g) of the contact.
//!
//! ```text
//! touch       P_0 = r0(s) + g n,   n = t0(s) x u / |t0(s) x u|                 u: unit vector of the push
//! place       P_k = Q_k (P_0 - x u) + d_k                                      Q_k, d_k: motion since the first loaded reading
//! contact     (P_k - P_0) . u > 0,   else the wire is free and m = 0
//! friction    s_c(k) = clamp(s_c(k-1), s(P_k, -mu), s(P_k, +mu))               stick, then slip: a play operator
//! ```
//!
//! Source of the play operator: M. A. Krasnosel'skii, A. V. Pokrovskii, "Systems with Hysteresis",
//! 1989.

use super::field::{ContactMoments, MomentField};
use super::{Episode, MotionRow};
use nalgebra::{Rotation3, Vector3};

/// State of an episode's contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Arc length s at which the object first touches the free wire, mm.
    pub s_mm: f64,
    /// Displacement x along the push at first touch, mm.
    pub onset_mm: f64,
    /// Gap g between the free wire and the object's point at first touch, mm.
    pub gap_mm: f64,
}

/// Longest step over which stick and slip are integrated, mm.
pub(crate) const PLAY_MM: f64 = 0.25;
/// Moment beyond which a reading is no longer that of a free wire, in standard deviations.
const LOADED_SDS: f64 = 4.0;
/// Smallest sine of the angle between push and wire: a push along the wire has no gap direction.
pub(crate) const ACROSS: f64 = 0.1;
/// Range of the onset before the first reading, mm.
pub(crate) const BEFORE_MM: f64 = 20.0;

/// An episode with its push direction, ready for states.
pub struct ContactPath<'a> {
    pub(crate) field: &'a MomentField,
    pub(crate) rows: &'a [MotionRow],
    /// Unit vector of the push.
    pub(crate) push: Vector3<f64>,
    /// Each reading's motion since the reference, the first loaded reading:
    /// `P_k = turn P + displacement`, mm.
    motions: Vec<(Rotation3<f64>, Vector3<f64>)>,
    /// Range of the onset: displacements along the push, mm.
    pub(crate) onset_mm: [f64; 2],
}

/// Whether a reading is loaded beyond its noise.
pub(crate) fn loaded(row: &MotionRow) -> bool {
    let shared = || {
        row.shared_nmm
            .iter()
            .map(|h| h[0] * h[0] + h[1] * h[1])
            .sum::<f64>()
    };
    // What a free wire would show: noise and the common errors at no load.
    let variance = row
        .free_nmm2
        .map_or_else(|| row.noise_nmm2.trace() + shared(), |free| free.trace());
    let sd = variance.max(0.0).sqrt();
    !row.free && row.moment_nmm[0].hypot(row.moment_nmm[1]) > LOADED_SDS * sd
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
    let least = Vector3::ith(push.iamin(), 1.0);
    let first = push.cross(&least).normalize();
    [first, push.cross(&first)].map(|e| turn * e * (creep_sd * way_mm))
}

impl<'a> ContactPath<'a> {
    /// None where no reading is loaded, or the motion has no direction.
    pub fn new(field: &'a MomentField, episode: &'a Episode) -> Option<Self> {
        let rows = &episode.rows[..];
        let first = rows.iter().position(loaded)?;
        let back = rows[first].turn.inverse();
        let motions = rows.iter().map(|r| {
            let turn = r.turn * back;
            (turn, r.moved_mm - turn * rows[first].moved_mm)
        });
        let mut own = Self {
            field,
            rows,
            push: Vector3::zeros(),
            motions: motions.collect(),
            onset_mm: [0.0; 2],
        };
        let push = match episode.push {
            Some(push) => push,
            None => own.push_direction(first)?,
        };
        own.push = push.try_normalize(1e-9)?;
        let along: Vec<f64> = (0..rows.len()).map(|k| own.along(k)).collect();
        let touched = along.iter().zip(rows).filter(|(_, r)| loaded(r));
        let deepest = touched.map(|(a, _)| *a).fold(f64::NEG_INFINITY, f64::max);
        let lowest = along.iter().copied().fold(0.0, f64::min);
        Some(Self {
            onset_mm: [lowest - BEFORE_MM, deepest],
            ..own
        })
    }

    /// Of one reading, whose motion since the reference is known.
    pub(crate) fn of_reading(
        field: &'a MomentField,
        row: &'a MotionRow,
        push: Vector3<f64>,
        motion: (Rotation3<f64>, Vector3<f64>),
    ) -> Self {
        Self {
            field,
            rows: std::slice::from_ref(row),
            push,
            motions: vec![motion],
            onset_mm: [0.0; 2],
        }
    }

    /// Displacement of a reading from the reference, mm; under rotation that of the wire's middle.
    pub(crate) fn displacement(&self, row: usize) -> Vector3<f64> {
        let middle = self.field.free(0.5 * self.field.length_mm()).0;
        self.carried(&middle, row) - middle
    }

    /// Direction of motion when the object first loads the wire, over a tenth of its largest
    /// displacement so that jitter does not set it.
    fn push_direction(&self, first: usize) -> Option<Vector3<f64>> {
        const SHARE: f64 = 0.1;
        let displacements: Vec<Vector3<f64>> =
            (0..self.rows.len()).map(|k| self.displacement(k)).collect();
        let farthest = displacements.iter().map(Vector3::norm).fold(0.0, f64::max);
        let jitter = 3.0 * self.rows.iter().map(|r| r.moved_sd_mm).fold(0.0, f64::max);
        let enough = |w: &Vector3<f64>| w.norm() >= (SHARE * farthest).max(jitter).max(1e-9);
        let before = displacements[..first].iter().rev().map(|w| -w).find(enough);
        before.or_else(|| displacements[first..].iter().copied().find(enough))
    }

    /// Displacement along the push of a reading from the reference, mm; under rotation that of the
    /// wire's middle.
    pub(crate) fn along(&self, row: usize) -> f64 {
        self.displacement(row).dot(&self.push)
    }

    /// Where a point that is at `place_mm` at the reference reading is at another, mm.
    pub(crate) fn carried(&self, place_mm: &Vector3<f64>, row: usize) -> Vector3<f64> {
        let (turn, displacement) = &self.motions[row];
        turn * place_mm + displacement
    }

    /// Rotation from the reference reading to another.
    pub(crate) fn turned(&self, row: usize) -> &Rotation3<f64> {
        &self.motions[row].0
    }

    /// Place at first touch and the direction of the gap; none where the push runs along the wire.
    pub(crate) fn touch(&self, state: &State) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (wire, tangent) = self.field.free(state.s_mm);
        let across = tangent.cross(&self.push).try_normalize(ACROSS)?;
        Some((wire + across * state.gap_mm, across))
    }

    /// Place of the object's point at a reading, mm.
    pub fn place(&self, state: &State, row: usize) -> Option<Vector3<f64>> {
        let (touch, _) = self.touch(state)?;
        Some(self.carried(&(touch - self.push * state.onset_mm), row))
    }

    /// Displacement along the push past first touch, mm.
    pub(crate) fn depth(&self, state: &State, row: usize) -> Option<f64> {
        // The point goes along the push; it holds the wire from first touch on.
        let (touch, _) = self.touch(state)?;
        Some((self.place(state, row)? - touch).dot(&self.push))
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
        let (turn, displacement) = &self.motions[row];
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
        let s_mm = match near_mm {
            Some(near) => found.min_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs())),
            None => found.min_by(|a, b| gap2(*a).total_cmp(&gap2(*b))),
        }?;
        let state = State {
            s_mm,
            onset_mm: 0.0,
            gap_mm: 0.0,
        };
        let (wire, across) = self.touch(&state)?;
        let off = origin - wire;
        Some(State {
            s_mm,
            onset_mm: -off.dot(&self.push),
            gap_mm: off.dot(&across),
        })
    }

    /// Moments of every reading; none where a state has no equilibrium there.
    pub fn moments(&self, state: &State) -> Option<Vec<[f64; 2]>> {
        let (touch, _) = self.touch(state)?;
        let origin = touch - self.push * state.onset_mm;
        // Place at a reading, and whether the wire is held there.
        let at = |k: usize| {
            let place = self.carried(&origin, k);
            (
                place,
                !self.rows[k].free && (place - touch).dot(&self.push) > 0.0,
            )
        };
        let mu = self.field.friction();
        if mu.coefficient <= 0.0 {
            let moment = |k: usize| match at(k) {
                (_, false) => Some([0.0; 2]),
                (place, true) => Some(self.field.held(&place, 0.0)?.moment_nmm),
            };
            return (0..self.rows.len()).map(moment).collect();
        }
        // Friction makes the contact depend on its history: integrated from first touch on, visit
        // by visit.
        let mut moments = Vec::with_capacity(self.rows.len());
        let mut contact: Option<(f64, Vector3<f64>, u32)> = None;
        for (k, row) in self.rows.iter().enumerate() {
            let (to, held) = at(k);
            if !held {
                contact = None;
                moments.push([0.0; 2]);
                continue;
            }
            let (mut s, from) = match contact.filter(|c| c.2 == row.contact_segment) {
                Some((s, from, _)) => (s, from),
                None => (state.s_mm, self.visit_start(&touch, &to)),
            };
            let share = if row.velocity_mm_s.norm() > 0.0 {
                mu.moving_share
            } else {
                1.0
            };
            let steps = ((to - from).norm() / PLAY_MM).ceil().max(1.0) as usize;
            let mut held = None;
            for n in 1..=steps {
                let at = from + (to - from) * (n as f64 / steps as f64);
                held = Some(play(self.field, &at, mu.coefficient * share, &mut s)?);
            }
            moments.push(held?.moment_nmm);
            contact = Some((s, to, row.contact_segment));
        }
        Some(moments)
    }

    /// Start of a visit whose first reading is at `to`, mm: on the free wire, straight back along
    /// the push.
    fn visit_start(&self, touch: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
        let depth = (to - touch).dot(&self.push);
        // Just past first touch: at touch itself the force vanishes and has no direction.
        to - self.push * (depth - depth.min(1e-3))
    }

    /// Whether the wire is held at a reading.
    pub(crate) fn held(&self, state: &State, row: usize) -> bool {
        !self.rows[row].free && self.depth(state, row).is_some_and(|d| d > 0.0)
    }
}

/// One step of the contact: it sticks up to the edge of the friction cone, then slips at it.
pub(crate) fn play(
    field: &MomentField,
    at: &Vector3<f64>,
    friction: f64,
    s_mm: &mut f64,
) -> Option<ContactMoments> {
    let here = field.at_place(at)?;
    let [low, free, high] =
        [-friction, 0.0, friction].map(|r| here.held(r).map(|h| h.arclength_mm));
    let (low, free, high) = (low?, free?, high?);
    *s_mm = s_mm.clamp(low.min(high), low.max(high));
    // Ratio of tangential to normal force whose equilibrium has this arc length, by regula falsi.
    let (mut a, mut b) = ((-friction, low - *s_mm), (friction, high - *s_mm));
    let mut ratio = 0.0;
    let mut value = free - *s_mm;
    for _ in 0..8 {
        if value.abs() < 1e-7 {
            break;
        }
        if (value > 0.0) == (a.1 > 0.0) {
            a = (ratio, value)
        } else {
            b = (ratio, value)
        }
        if (b.1 - a.1).abs() < 1e-12 {
            break;
        }
        ratio = a.0 - a.1 * (b.0 - a.0) / (b.1 - a.1);
        value = here.held(ratio)?.arclength_mm - *s_mm;
    }
    here.held(ratio)
}
