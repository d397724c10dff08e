//! Base moments as a function of the contact point, tabulated on demand.
//!
//! A point contact at P has one equilibrium near the free wire (wcal-rod): `r(s_c) = P`,
//! `F . t = ratio |F_perp|`, base moment `m = P x F`. With `q(P) = |P|^2 m(P)`, from which a
//! cantilever's `3 E I delta / |P|^2` has lost its pole at the root, `q` and `s_c` are smooth in P
//! and interpolated by Lagrange's cubic in each coordinate. In the table the wire is extended
//! beyond its tip, so that `q` and `s_c` stay smooth there; [`MomentField::held`] refuses `s_c`
//! beyond the true length. Nodes are solved by continuation from the free wire, which keeps to the
//! branch of equilibria that starts at first touch. Source of the equilibrium: `wcal_rod`.

use nalgebra::{Matrix2x3, Vector3};
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, RwLock};
use wcal_core::interpolation::cubic;
use wcal_core::observation::MomentAxes;
use wcal_rod::{Equilibrium, Guess, Rod, Tangential};

/// Spacing of the nodes, mm. Relative error of interpolated moments: 3e-4 from 10 mm on (tests).
const PITCH_MM: f64 = 2.0;
/// Extension of the wire beyond the tip, mm: the reach of a cell's outermost nodes.
const BEYOND_MM: f64 = 8.0;
/// Spacing of the free wire's samples, mm.
const WIRE_MM: f64 = 0.25;
/// Nodes closer to the root than this are left out, mm.
const ROOT_MM: f64 = 1.0;
/// Largest step of the contact along the wire per displacement of the contact point, plus a
/// constant (mm): more is another equilibrium.
const JUMP: f64 = 4.0;
const JUMP_MM: f64 = 0.5;
/// Halvings of the continuation step from a node to the next before the node counts as unreachable.
const HALVINGS: usize = 4;

/// Friction along the wire.
#[derive(Debug, Clone, Copy)]
pub struct Friction {
    /// Largest tangential over normal force, the groove's walls included.
    pub coefficient: f64,
    /// Friction while the contact moves, over friction at rest.
    pub moving_share: f64,
}

impl Friction {
    /// No friction.
    pub const NONE: Self = Self {
        coefficient: 0.0,
        moving_share: 1.0,
    };
}

/// The wire held at one point: moments (N mm) and contact arc length (mm).
#[derive(Debug, Clone, Copy)]
pub struct ContactMoments {
    /// The two moment components, N mm.
    pub moment_nmm: [f64; 2],
    /// Contact arc length, mm.
    pub arclength_mm: f64,
}

/// Interpolated values at a place: what remains is the parabola through the ratios.
pub(crate) struct InterpolatedField<'a> {
    field: &'a MomentField,
    place_mm: Vector3<f64>,
    sums: [[f64; 3]; 3],
}

impl InterpolatedField<'_> {
    /// As [`MomentField::held`].
    pub(crate) fn held(&self, ratio: f64) -> Option<ContactMoments> {
        let by_ratio = self.field.ratio_weights(ratio);
        let sum = [0, 1, 2].map(|k| {
            self.sums
                .iter()
                .zip(by_ratio)
                .map(|(s, by)| by * s[k])
                .sum()
        });
        self.field.of_sums(&self.place_mm, &sum)
    }
}

/// `q` (N mm^3) and arc length (mm) at the three ratios -mu, 0, +mu; one where there is no
/// friction.
type Values = Vec<[f64; 3]>;

/// Values of the nodes around a cell, one after the other.
type Cell = Arc<[[f64; 3]]>;

/// The step of the continuation that leads to a node.
struct Continuation {
    /// Arc length of the nearest sample of the free wire, mm.
    arclength_mm: f64,
    /// Distance to that sample, mm.
    distance_mm: f64,
    /// The previous node; none within one spacing of the free wire.
    previous: Option<Key>,
}

struct Node {
    equilibrium: Equilibrium,
    values: Values,
}

type Key = [i32; 3];

/// The table.
pub struct MomentField {
    rod: Rod,
    length_mm: f64,
    axes: MomentAxes,
    friction: Friction,
    at_rest_nmm: [f64; 2],
    /// The field with each of the first common unknowns one standard deviation higher.
    pub changed: Vec<MomentField>,
    /// Samples of the free wire: arc length and place.
    wire: Vec<(f64, Vector3<f64>)>,
    nodes: RwLock<HashMap<Key, Option<Arc<Node>>>>,
    /// Values of the 64 nodes around a cell, ratio by ratio; none where one is missing.
    cells: RwLock<HashMap<Key, Option<Cell>>>,
}

fn place(key: &Key) -> Vector3<f64> {
    Vector3::new(f64::from(key[0]), f64::from(key[1]), f64::from(key[2])) * PITCH_MM
}

fn key_of(place_mm: &Vector3<f64>) -> Key {
    [0, 1, 2].map(|k| (place_mm[k] / PITCH_MM).round() as i32)
}

impl MomentField {
    /// Of a rod with its accepted effects; moments are those of contact, less the moment of the
    /// free wire's weight.
    pub fn new(rod: &Rod, axes: &MomentAxes, friction: Friction) -> Self {
        // A heavy extension would change the sag of the wire itself.
        let beyond_mm = if rod.weight_n_per_mm.norm() > 0.0 {
            0.0
        } else {
            BEYOND_MM
        };
        let length_mm = rod.shape.length_mm;
        let at_rest_nmm = axes.components_nmm(&rod.rest_moment_nmm());
        let rod = rod.extended(beyond_mm);
        let samples = (rod.shape.length_mm / WIRE_MM).ceil() as usize;
        let wire = (0..=samples)
            .map(|k| rod.shape.length_mm * k as f64 / samples as f64)
            .map(|s| (s, rod.shape.rest_point(s)))
            .collect();
        Self {
            rod,
            length_mm,
            axes: axes.clone(),
            friction,
            at_rest_nmm,
            changed: Vec::new(),
            wire,
            nodes: RwLock::default(),
            cells: RwLock::default(),
        }
    }

    /// Length of the wire, mm.
    pub fn length_mm(&self) -> f64 {
        self.length_mm
    }

    /// Friction along the wire.
    pub fn friction(&self) -> Friction {
        self.friction
    }

    /// Free wire at an arc length (mm): place and tangent.
    pub fn free(&self, s_mm: f64) -> (Vector3<f64>, Vector3<f64>) {
        const STEP_MM: f64 = 0.05;
        let at = |s: f64| {
            self.rod
                .shape
                .rest_point(s.clamp(0.0, self.rod.shape.length_mm))
        };
        // Central difference over the joints of the shape.
        let tangent = at(s_mm + STEP_MM) - at(s_mm - STEP_MM);
        (
            at(s_mm),
            tangent.try_normalize(1e-12).unwrap_or_else(Vector3::x),
        )
    }

    /// Middle of the free wire, which stands for the object under rotation, mm.
    pub fn middle_mm(&self) -> Vector3<f64> {
        self.free(0.5 * self.length_mm).0
    }

    /// Moments and contact at a place (mm) under a ratio of tangential to normal force; none where
    /// no equilibrium is known or the contact lies beyond the tip.
    pub fn held(&self, place_mm: &Vector3<f64>, ratio: f64) -> Option<ContactMoments> {
        self.at_place(place_mm)?.held(ratio)
    }

    /// The values at a place under every ratio.
    pub(crate) fn at_place(&self, place_mm: &Vector3<f64>) -> Option<InterpolatedField<'_>> {
        let (cell, [x, y, z]) = self.around(place_mm)?;
        // A tensor product: the cubic in each coordinate.
        let [wx, wy, wz] = [x, y, z].map(cubic);
        let ratios = cell.len() / 64;
        let mut sums = [[0.0; 3]; 3];
        for (n, values) in cell.chunks_exact(ratios).enumerate() {
            let weight = wx[n / 16] * wy[n / 4 % 4] * wz[n % 4];
            for (sum, value) in sums.iter_mut().zip(values) {
                sum.iter_mut()
                    .zip(value)
                    .for_each(|(s, v)| *s += weight * v);
            }
        }
        Some(InterpolatedField {
            field: self,
            place_mm: *place_mm,
            sums,
        })
    }

    /// [`Self::held`] with the derivative of the moments by the place, N mm/mm: that of the
    /// interpolating polynomial.
    pub(crate) fn held_and_rate(
        &self,
        place_mm: &Vector3<f64>,
        ratio: f64,
    ) -> Option<(ContactMoments, Matrix2x3<f64>)> {
        let (cell, [x, y, z]) = self.around(place_mm)?;
        let [wx, wy, wz] = [x, y, z].map(cubic);
        let [rx, ry, rz] = [x, y, z].map(cubic_rate);
        // Without friction a node has one value, and its weight is 1.
        let by_ratio = &self.ratio_weights(ratio)[..cell.len() / 64];
        let (mut sum, mut rates) = ([0.0; 3], [[0.0; 2]; 3]);
        for (n, values) in cell.chunks_exact(by_ratio.len()).enumerate() {
            let [i, j, k] = [n / 16, n / 4 % 4, n % 4];
            let mut value = [0.0; 3];
            for (v, by) in values.iter().zip(by_ratio) {
                value.iter_mut().zip(v).for_each(|(s, v)| *s += by * v);
            }
            let by_axis = [
                rx[i] * wy[j] * wz[k],
                wx[i] * ry[j] * wz[k],
                wx[i] * wy[j] * rz[k],
            ];
            let weight = wx[i] * wy[j] * wz[k];
            sum.iter_mut()
                .zip(value)
                .for_each(|(s, v)| *s += weight * v);
            // The argument of the cubic counts in pitches: d/dP = (1 / pitch) d/du.
            for (rate, by) in rates.iter_mut().zip(by_axis) {
                (0..2).for_each(|c| rate[c] += by / PITCH_MM * value[c]);
            }
        }
        // m = q / |P|^2.
        let squared = place_mm.norm_squared();
        // dm/dP = (dq/dP) / |P|^2 - 2 q P' / |P|^4.
        let rate =
            |c: usize, a: usize| (rates[a][c] - 2.0 * sum[c] * place_mm[a] / squared) / squared;
        Some((self.of_sums(place_mm, &sum)?, Matrix2x3::from_fn(rate)))
    }

    /// Fills the table for places up to `reach_mm` from the free wire, so that no reading of a
    /// stream has to wait for the rod.
    pub fn fill(&self, reach_mm: f64) {
        let mut cells: BTreeSet<Key> = BTreeSet::new();
        let steps = (reach_mm / PITCH_MM).ceil() as i32;
        let side = 2 * steps + 1;
        for (_, wire) in self.wire.iter().step_by((PITCH_MM / WIRE_MM) as usize) {
            let [x, y, z] = key_of(wire).map(|k| k - steps);
            let around =
                (0..side.pow(3)).map(|n| [x + n / side / side, y + n / side % side, z + n % side]);
            cells.extend(around.filter(|key| (place(key) - wire).norm() <= reach_mm));
        }
        for key in cells {
            let _ = self.cell(key);
        }
        self.changed
            .iter()
            .for_each(|changed| changed.fill(reach_mm));
    }

    /// The cell of a place, and where in it the place is, in each coordinate from 0 to 1.
    fn around(&self, place_mm: &Vector3<f64>) -> Option<(Cell, [f64; 3])> {
        let scaled = place_mm / PITCH_MM;
        let low = [0, 1, 2].map(|k| scaled[k].floor());
        Some((
            self.cell(low.map(|v| v as i32))?,
            [0, 1, 2].map(|k| scaled[k] - low[k]),
        ))
    }

    fn of_sums(&self, place_mm: &Vector3<f64>, sum: &[f64; 3]) -> Option<ContactMoments> {
        let squared = place_mm.norm_squared();
        // Beyond the true length lies only the table's extension: no wire is there to be held.
        (sum[2] <= self.length_mm).then_some(ContactMoments {
            moment_nmm: [
                sum[0] / squared - self.at_rest_nmm[0],
                sum[1] / squared - self.at_rest_nmm[1],
            ],
            arclength_mm: sum[2],
        })
    }

    /// Weights of the three ratios: the parabola through them.
    fn ratio_weights(&self, ratio: f64) -> [f64; 3] {
        let mu = self.friction.coefficient;
        if mu <= 0.0 {
            return [1.0, 0.0, 0.0];
        }
        // Lagrange's parabola through -mu, 0 and mu.
        let v = (ratio / mu).clamp(-1.0, 1.0);
        [0.5 * v * (v - 1.0), 1.0 - v * v, 0.5 * v * (v + 1.0)]
    }

    fn cell(&self, low: Key) -> Option<Cell> {
        if let Some(known) = self.cells.read().ok()?.get(&low) {
            return known.clone();
        }
        // The cubic takes one node before the place and two after it in each coordinate.
        let [x, y, z] = low.map(|k| k - 1);
        let values = |n: i32| {
            let node = self.node([x + n / 16, y + n / 4 % 4, z + n % 4])?;
            Some(node.values.clone())
        };
        let all: Option<Vec<Values>> = (0..64).map(values).collect();
        let cell: Option<Cell> = all.map(|all| all.concat().into());
        self.cells.write().ok()?.insert(low, cell.clone());
        cell
    }

    fn node(&self, key: Key) -> Option<Arc<Node>> {
        if let Some(known) = self.nodes.read().ok()?.get(&key) {
            return known.clone();
        }
        // Back to a solved node, then outward: a loop, so that the stack does not grow with the
        // distance.
        let mut unknown = vec![key];
        while let Some(previous) = unknown.last().and_then(|k| self.continuation(k)?.previous) {
            if self.nodes.read().ok()?.contains_key(&previous) {
                break;
            }
            unknown.push(previous);
        }
        for key in unknown.into_iter().rev() {
            let node = self.solve(key).map(Arc::new);
            self.nodes.write().ok()?.insert(key, node);
        }
        self.nodes.read().ok()?.get(&key).cloned().flatten()
    }

    /// Step of the continuation to a node; none out of the wire's reach.
    fn continuation(&self, key: &Key) -> Option<Continuation> {
        let target = place(key);
        let (arclength_mm, wire) = self.nearest(&target);
        // No wire reaches farther than its length; a motion in the wrong unit leads to points
        // metres away.
        if arclength_mm < ROOT_MM || target.norm() > self.rod.shape.length_mm {
            return None;
        }
        let to_wire = wire - target;
        let distance_mm = to_wire.norm();
        let previous = key_of(&(target + to_wire * (PITCH_MM / distance_mm.max(PITCH_MM))));
        // Each step must come closer to the wire, or the continuation would not end.
        let near = distance_mm <= PITCH_MM
            || previous == *key
            || (place(&previous) - wire).norm() >= distance_mm;
        Some(Continuation {
            arclength_mm,
            distance_mm,
            previous: (!near).then_some(previous),
        })
    }

    /// Sample of the free wire next to a place.
    fn nearest(&self, place_mm: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let off = |w: &(f64, Vector3<f64>)| (w.1 - place_mm).norm_squared();
        let found = self.wire.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        found.copied().unwrap_or((0.0, Vector3::zeros()))
    }

    /// From the free wire within one spacing of it, else from the previous node: the branch that
    /// starts at first touch.
    fn solve(&self, key: Key) -> Option<Node> {
        let target = place(&key);
        let step = self.continuation(&key)?;
        let equilibrium = match step.previous {
            None => {
                let free = Guess {
                    force_n: Vector3::zeros(),
                    arclength_mm: step.arclength_mm,
                };
                let found = self.rod.solve(&target, &free, Tangential::Frictionless);
                let is_near = |found: &Equilibrium| {
                    let jump = (found.arclength_mm - step.arclength_mm).abs();
                    jump <= JUMP * step.distance_mm + JUMP_MM
                };
                found.ok().filter(is_near)?
            }
            Some(previous) => self.continued(&self.node(previous)?.equilibrium, &target)?,
        };
        let squared = target.norm_squared();
        // q = |P|^2 m has no pole at the root.
        let values = |e: &Equilibrium| {
            let m = self.axes.components_nmm(&e.moment_nmm);
            [m[0] * squared, m[1] * squared, e.arclength_mm]
        };
        let mut all = vec![values(&equilibrium)];
        // Slip in either direction along the wire: what friction allows lies between the two.
        let mu = self.friction.coefficient;
        if mu > 0.0 {
            let slipped = |ratio: f64| Some(values(&self.slipped(&equilibrium, ratio)?));
            all = vec![slipped(-mu)?, all[0], slipped(mu)?];
        }
        Some(Node {
            equilibrium,
            values: all,
        })
    }

    /// Continuation of a known equilibrium along the straight line to a point, with the step halved
    /// where a solution is refused.
    fn continued(&self, from: &Equilibrium, target: &Vector3<f64>) -> Option<Equilibrium> {
        (0..=HALVINGS).find_map(|halvings| {
            // A step that leads to another branch is tried again in halves.
            let steps = 1 << halvings;
            let mut last = *from;
            for k in 1..=steps {
                let at =
                    from.point_mm + (target - from.point_mm) * (f64::from(k) / f64::from(steps));
                let found = self
                    .rod
                    .solve(&at, &Guess::from(&last), Tangential::Frictionless)
                    .ok()?;
                let jump = (found.arclength_mm - last.arclength_mm).abs();
                let step_mm = (at - last.point_mm).norm();
                // The determinant changes its sign at a fold: the other sign is another branch
                // (wcal-rod, path).
                if jump > JUMP * step_mm + JUMP_MM || found.determinant * last.determinant <= 0.0 {
                    return None;
                }
                last = found;
            }
            Some(last)
        })
    }

    /// The slipping equilibrium at the same place, ratio by ratio from the frictionless one.
    fn slipped(&self, free: &Equilibrium, ratio: f64) -> Option<Equilibrium> {
        const STEPS: usize = 3;
        let mut last = *free;
        for k in 1..=STEPS {
            // The force leans by degrees: each solution is the next one's guess.
            let part = Tangential::Ratio(ratio * k as f64 / STEPS as f64);
            last = self
                .rod
                .solve(&free.point_mm, &Guess::from(&last), part)
                .ok()?;
        }
        Some(last)
    }
}

/// Derivatives of the weights ([`cubic`]) by the argument.
fn cubic_rate(u: f64) -> [f64; 4] {
    // Nodes at -1, 0, 1 and 2. The weights sum to 1, so that their derivatives sum to 0.
    [
        -(3.0 * u * u - 6.0 * u + 2.0) / 6.0,
        (3.0 * u * u - 4.0 * u - 1.0) / 2.0,
        -(3.0 * u * u - 2.0 * u - 2.0) / 2.0,
        (3.0 * u * u - 1.0) / 6.0,
    ]
}

#[cfg(test)]
#[path = "field_test.rs"]
mod tests;
