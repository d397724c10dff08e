//! A sweep: where the object lies, how fast the base passes it, and what happens on the way.
//!
//! Way of the base: l(t) = v_0 t + 1/2 a t^2, one second after the other with a drawn in [-a_max,
//! a_max] and turned where v would leave its range. Object to base: p = R q + x_0 - l(t) e_z, with
//! R uniform on SO(3) (Haar measure; K. Shoemake, Graphics Gems III, 1992, p. 124) and x_0 by the
//! drawn plane y, the gap along x and the way before the object can be touched along z.

use crate::contact::{Contact, Surface};
use crate::physics::{Physics, PhysicsPlan};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::cell::Cell;
use std::f64::consts::FRAC_PI_2;
use wcal_core::ranges::{self, Range};
use wcal_mesh::{ClosestPoint, Mesh, MeshError};

/// How sweeps are drawn (docs/src/system.md: 3-7 mm/s, +-0.4 mm/s^2, series of 5 Hz).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SweepPlan {
    /// Speeds, mm/s.
    pub speed_mm_s: [f64; 2],
    /// Bound of the acceleration, drawn anew every second and turned round at the speeds' ends,
    /// mm/s^2.
    pub acceleration_mm_s2: f64,
    /// Samples a second.
    pub rate_hz: f64,
    /// Distance from the base to the object's nearest point in the sweep's plane, along the
    /// straight wire, mm.
    pub gap_mm: [f64; 2],
    /// Way of the base before the object can be touched, mm.
    pub lead_mm: [f64; 2],
    /// Longest way of the base, mm.
    #[serde(rename = "most_mm", alias = "max_travel_mm")]
    pub max_travel_mm: f64,
    /// Way after the wire is free again, mm.
    pub tail_mm: f64,
    /// Longest step of the base between two equilibria of the rod, mm: shorter ones tell springs
    /// that are small from a fast slide, and take that much longer.
    pub step_mm: f64,
    /// Largest strain of the wire's skin; past it the torque is too high.
    #[serde(rename = "most_strain", alias = "max_strain")]
    pub max_strain: f64,
    /// How the object lies.
    pub turn: Turn,
    /// Whether sweeps in which the wire sprang from one equilibrium to another are kept; the paper
    /// rejects contact jumps.
    pub keep_jumps: bool,
    /// Friction, softening and medium.
    pub physics: PhysicsPlan,
}

/// How an object is turned before a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Turn {
    /// At random, uniform over rotations.
    Haar,
    /// Upright as its mesh is (+z up, along the base's +y): four faces in turn, a quarter turn
    /// apart (docs/src/system.md, Evaluation).
    Faces,
}

impl Turn {
    /// Object to base frame.
    fn of(self, index: u64, rng: &mut ChaCha8Rng) -> Matrix3<f64> {
        let drawn = haar(rng);
        if self == Self::Haar {
            return drawn;
        }
        let face = Rotation3::from_axis_angle(&Vector3::y_axis(), (index % 4) as f64 * FRAC_PI_2);
        (face * Rotation3::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2)).into_inner()
    }
}

/// More make a sweep of hours.
const MAX_STEPS: f64 = 1e6;

/// Numbers that a plan may state; what a sweep takes follows from several of them.
const RANGES: &[Range] = &[
    Range::real("speed_mm_s", 0.01, 1e4),
    Range::real("acceleration_mm_s2", 0.0, 1e4),
    Range::real("rate_hz", 1e-3, 1e5),
    Range::real("gap_mm", 0.5, 2000.0),
    Range::real("lead_mm", 0.5, 2000.0),
    Range::real("most_mm", 0.1, 1e4),
    Range::real("tail_mm", 1e-3, 1e4),
    Range::real("step_mm", 1e-3, 100.0),
    Range::real("most_strain", 1e-6, 1.0),
];

impl Default for SweepPlan {
    fn default() -> Self {
        Self {
            speed_mm_s: [3.0, 7.0],
            acceleration_mm_s2: 0.4,
            rate_hz: 5.0,
            gap_mm: [22.0, 47.0],
            lead_mm: [2.0, 12.0],
            max_travel_mm: 120.0,
            tail_mm: 5.0,
            step_mm: 1.0,
            max_strain: 0.015,
            turn: Turn::Haar,
            keep_jumps: true,
            physics: PhysicsPlan::default(),
        }
    }
}

impl SweepPlan {
    /// From a plan file.
    ///
    /// # Errors
    /// Where it is no such file, or a value cannot be.
    pub fn from_toml(text: &str) -> Result<Self, MeshError> {
        let plan: Self = wcal_core::document::toml_as(text).map_err(|e| MeshError::Value {
            what: "sweep plan".to_owned(),
            expected: "the keys of a plan".to_owned(),
            found: e.to_string(),
        })?;
        plan.check()?;
        Ok(plan)
    }

    /// # Errors
    /// Where a value cannot be.
    pub fn check(&self) -> Result<(), MeshError> {
        ranges::check_value(self, &[RANGES])?;
        for (what, r) in [
            ("speed_mm_s", self.speed_mm_s),
            ("gap_mm", self.gap_mm),
            ("lead_mm", self.lead_mm),
        ] {
            if !(r[1] >= r[0]) {
                let expected = "low <= high".to_owned();
                return Err(MeshError::Value {
                    what: what.to_owned(),
                    expected,
                    found: format!("{r:?}"),
                });
            }
        }
        // Samples and equilibria of one sweep.
        let samples = self.max_travel_mm / self.speed_mm_s[0] * self.rate_hz;
        let steps = self.max_travel_mm / self.step_mm;
        for (what, count) in [("rate_hz", samples), ("step_mm", steps)] {
            if !(count <= MAX_STEPS) {
                let expected =
                    format!("at most {MAX_STEPS} samples and steps of the base in a sweep");
                return Err(MeshError::Value {
                    what: what.to_owned(),
                    expected,
                    found: format!("{count:.0}"),
                });
            }
        }
        self.physics.check()
    }
}

/// Time for which an acceleration holds, s.
pub const HOLD_S: f64 = 1.0;

/// One sweep. The base moves along +z of its own frame; in that frame the object comes along -z.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Number of the sweep over this object.
    pub index: u64,
    /// Object to base frame, at the start.
    pub turn: Matrix3<f64>,
    /// See `turn`, mm.
    pub shift_mm: Vector3<f64>,
    /// Speed at the start, mm/s.
    pub speed_mm_s: f64,
    /// Accelerations, one a second, mm/s^2; the last speed is held.
    pub accelerations_mm_s2: Vec<f64>,
    /// Drawn gap, mm.
    pub gap_mm: f64,
    /// Drawn friction, softening and medium.
    pub physics: Physics,
}

impl Sweep {
    /// Draws sweep `index` over an object: the same for the same object, seed and index.
    ///
    /// `None` where the plane misses the object within the wire's reach.
    pub fn draw(
        mesh: &Mesh,
        plan: &SweepPlan,
        seed: u64,
        index: u64,
        reach_mm: f64,
    ) -> Option<Self> {
        let mut rng = generator(&mesh.name, "", seed, index);
        // Draws of its own: the physics leaves the sweep's way as it is.
        let physics = Physics::draw(
            &plan.physics,
            &mut generator(&mesh.name, "/physics", seed, index),
        );
        let turn = plan.turn.of(index, &mut rng);
        let points: Vec<Vector3<f64>> = mesh.points().map(|p| turn * p).collect();
        let low = points.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let high = points.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max);
        let plane_mm = low + (high - low) * rng.random_range(0.05..0.95);
        let gap_mm = uniform(&mut rng, plan.gap_mm);
        let lead_mm = uniform(&mut rng, plan.lead_mm);
        let speed_mm_s = uniform(&mut rng, plan.speed_mm_s);
        let accelerations_mm_s2 = accelerations(&mut rng, plan, speed_mm_s);
        // Where the plane cuts the triangles: segments (x, z).
        let mut section: Vec<[[f64; 2]; 2]> = Vec::new();
        for t in mesh.triangles() {
            let mut ends = Vec::with_capacity(2);
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let (p, q) = (points[t[a] as usize], points[t[b] as usize]);
                let (from, to) = (p.y - plane_mm, q.y - plane_mm);
                if from * to < 0.0 {
                    let at = p + (q - p) * (from / (from - to));
                    ends.push([at.x, at.z]);
                }
            }
            if let [a, b] = ends[..] {
                section.push([a, b]);
            }
        }
        // Gap along x at the object's nearest point; along z the lowest point within reach is
        // touched first.
        let nearest = section
            .iter()
            .flatten()
            .map(|s| s[0])
            .fold(f64::INFINITY, f64::min);
        let x_mm = gap_mm - nearest;
        let first = section
            .iter()
            .map(|s| lowest_within(*s, reach_mm - x_mm))
            .fold(f64::INFINITY, f64::min);
        first.is_finite().then(|| Self {
            index,
            turn,
            shift_mm: Vector3::new(x_mm, -plane_mm, lead_mm - first),
            speed_mm_s,
            accelerations_mm_s2,
            gap_mm,
            physics,
        })
    }

    /// Way of the base after a time, mm, and its speed, mm/s.
    pub fn travel(&self, t_s: f64) -> (f64, f64) {
        let (mut way_mm, mut speed, mut rest_s) = (0.0, self.speed_mm_s, t_s);
        for a in &self.accelerations_mm_s2 {
            let dt = rest_s.min(HOLD_S);
            way_mm += speed * dt + 0.5 * a * dt * dt;
            speed += a * dt;
            rest_s -= dt;
            if rest_s <= 0.0 {
                return (way_mm, speed);
            }
        }
        (way_mm + speed * rest_s, speed)
    }
}

/// Accelerations for the longest sweep.
fn accelerations(rng: &mut ChaCha8Rng, plan: &SweepPlan, mut speed: f64) -> Vec<f64> {
    let [low, high] = plan.speed_mm_s;
    let seconds = (plan.max_travel_mm / low / HOLD_S).ceil().min(1e4) as usize;
    (0..seconds)
        .map(|_| {
            // Turned around where the speed would leave its range.
            let drawn = uniform(rng, [-plan.acceleration_mm_s2, plan.acceleration_mm_s2]);
            let next = speed + drawn * HOLD_S;
            let a = if (low..=high).contains(&next) {
                drawn
            } else {
                -drawn
            };
            let a = a.clamp((low - speed) / HOLD_S, (high - speed) / HOLD_S);
            speed += a * HOLD_S;
            a
        })
        .collect()
}

/// An object on its way through the base frame.
#[derive(Debug, Clone)]
pub struct MovingObject<'a> {
    mesh: &'a Mesh,
    sweep: &'a Sweep,
    travel_mm: f64,
    /// Place (object frame) and signed distance of the last answer: the next question is mostly
    /// asked close by.
    last: Cell<Option<(Vector3<f64>, f64)>>,
}

/// Rounding of a distance, mm.
const ROUNDING_MM: f64 = 1e-6;

impl<'a> MovingObject<'a> {
    /// The object of a sweep after a way of the base, mm.
    pub fn new(mesh: &'a Mesh, sweep: &'a Sweep, travel_mm: f64) -> Self {
        Self {
            mesh,
            sweep,
            travel_mm,
            last: Cell::new(None),
        }
    }
}

impl Surface for MovingObject<'_> {
    fn faceted(&self) -> bool {
        true
    }

    fn closest_point(&self, p: &Vector3<f64>, within_mm: f64) -> Option<ClosestPoint> {
        let shift = self.sweep.shift_mm - Vector3::z() * self.travel_mm;
        let place = self.sweep.turn.tr_mul(&(p - shift));
        let known = self
            .last
            .get()
            .map(|(last, distance_mm)| [distance_mm, (place - last).norm() + ROUNDING_MM]);
        let found = self.mesh.closest_point_from(&place, within_mm, known)?;
        self.last.set(Some((place, found.distance_mm)));
        Some(ClosestPoint {
            distance_mm: found.distance_mm,
            normal: self.sweep.turn * found.normal,
            point_mm: self.sweep.turn * found.point_mm + shift,
            second_per_mm: if found.second_per_mm == Matrix3::zeros() {
                found.second_per_mm
            } else {
                self.sweep.turn * found.second_per_mm * self.sweep.turn.transpose()
            },
        })
    }
}

/// What happened since the sample before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Event {
    /// Nothing.
    None,
    /// First touch.
    Onset,
    /// The wire came free.
    Release,
    /// The wire sprang from one equilibrium to another.
    Jump,
    /// The contact ran along the object much faster than the base moves.
    Slip,
}

impl Event {
    /// Name in the shards.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Onset => "onset",
            Self::Release => "release",
            Self::Jump => "jump",
            Self::Slip => "slip",
        }
    }
}

/// One sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Time, s.
    pub t_s: f64,
    /// Way of the base, mm.
    pub travel_mm: f64,
    /// Its speed, mm/s.
    pub speed_mm_s: f64,
    /// Moment at the root, N mm; the transverse ones are y and z.
    pub moment_nmm: Vector3<f64>,
    /// Contacts from the root on; the first is the nearest to the base.
    pub contacts: Vec<Contact>,
    /// What happened.
    pub event: Event,
    /// Whether the wire came to rest all the way since the sample before.
    pub settled: bool,
}

/// Verdict of a sweep in which the engine's program ended: it is made again by the next run.
pub const ENGINE_DIED: &str = "engine-died";

/// How a sweep ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// Usable.
    Kept,
    /// Kept aside, with the reason.
    Rejected(&'static str),
}

impl Verdict {
    /// "kept" or the reason.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::Rejected(why) => why,
        }
    }
}

/// Least z of a segment where x is below `reach_mm`; infinite where it is nowhere.
fn lowest_within([a, b]: [[f64; 2]; 2], reach_mm: f64) -> f64 {
    let (near, far) = if a[0] <= b[0] { (a, b) } else { (b, a) };
    if near[0] >= reach_mm {
        return f64::INFINITY;
    }
    if far[0] <= reach_mm {
        return near[1].min(far[1]);
    }
    let share = (reach_mm - near[0]) / (far[0] - near[0]);
    near[1].min(near[1] + (far[1] - near[1]) * share)
}

fn uniform(rng: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// Uniform over all rotations (K. Shoemake, Graphics Gems III, 1992).
fn haar(rng: &mut ChaCha8Rng) -> Matrix3<f64> {
    let [u, v, w] = [0; 3].map(|_| rng.random::<f64>());
    let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
    let (v, w) = (std::f64::consts::TAU * v, std::f64::consts::TAU * w);
    let q = Quaternion::new(b * w.cos(), a * v.sin(), a * v.cos(), b * w.sin());
    UnitQuaternion::new_normalize(q)
        .to_rotation_matrix()
        .into_inner()
}

fn generator(object: &str, what: &str, seed: u64, index: u64) -> ChaCha8Rng {
    let mut hash = Sha256::new();
    hash.update(object.as_bytes());
    hash.update(what.as_bytes());
    hash.update(seed.to_le_bytes());
    hash.update(index.to_le_bytes());
    ChaCha8Rng::from_seed(hash.finalize().into())
}
