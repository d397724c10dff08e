//! Where a single contact can be, given the two transverse moments: a curve in space, one point for each arc length.
//!
//! A force square to the wire has two components; with the arc length that makes three unknowns for two moments. At the tip the force
//! may lean inward: there its slant is the third unknown, and the curve goes on. The rod gives the curve; time, the base's way and what
//! is known of objects choose the point on it.

use crate::TrackError;
use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{Chain, Section, Shape};

/// How fine the table is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InverseGrid {
    /// First arc length and distance of the nodes, mm; the last is the tip.
    pub first_mm: f64,
    /// See `first_mm`.
    pub step_mm: f64,
    /// Nodes for each one at which the rod is solved; those between are interpolated.
    pub refine: usize,
    /// Slants of the force at the tip, up to a right angle less one part.
    pub slants: usize,
    /// Directions of the moment around the root.
    pub directions: usize,
    /// Largest moment, N mm, and its steps.
    pub most_nmm: f64,
    /// See `most_nmm`.
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
            slants: 9,
            directions: 48,
            most_nmm: 3.2,
            steps: 32,
            links: 40,
        }
    }
}

/// A contact that would explain the moments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Point of the object, mm: the wire's axis less its radius along the force.
    pub point_mm: Vector3<f64>,
    /// Direction of the force on the wire.
    pub normal: Vector3<f64>,
    /// Volume of places that the node and a unit square of moments stand for, mm^3/(N mm)^2.
    pub volume: f64,
    /// Whether the moments can come from this arc length at all; where not, the last moments on the way that can are meant.
    pub reachable: bool,
}

/// A node of the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Arc length, mm.
    pub arclength_mm: f64,
    /// Tangent of the force's slant, inward along the wire; 0 but at the tip.
    pub slant: f64,
}

/// The table.
#[derive(Debug, Clone)]
pub struct StaticInverse {
    /// Nodes from the root to the tip, then the tip's slants.
    pub nodes: Vec<Node>,
    grid: InverseGrid,
    /// By arc length, direction and moment: point and normal.
    cells: Vec<Cell>,
}

type Cell = ([f32; 6], bool);

impl StaticInverse {
    /// Solves the rod on the whole grid.
    ///
    /// # Errors
    /// Where the whisker cannot be used or the grid is too coarse to hold a cell.
    pub fn new(whisker: &WhiskerSpec, grid: InverseGrid) -> Result<Self, TrackError> {
        if grid.directions < 4 || grid.steps < 2 || !(grid.most_nmm > 0.0 && grid.step_mm > 0.0) {
            return Err(TrackError::value(
                "inverse grid",
                "4 directions, 2 steps or more",
                format!("{grid:?}"),
            ));
        }
        let shape = Shape::new(&whisker.rest_shape, 0.25)?;
        let section = Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
        let chain = Chain::new(&section, &shape, whisker.diameter_mm, grid.links)?;
        let tip_mm = shape.length_mm;
        let steps = ((tip_mm - grid.first_mm) / grid.step_mm).floor().max(1.0) as usize;
        let along = (0..=steps)
            .map(|k| Node { arclength_mm: tip_mm - grid.step_mm * (steps - k) as f64, slant: 0.0 });
        let slant = |k: usize| (std::f64::consts::FRAC_PI_2 * k as f64 / (grid.slants + 1) as f64).tan();
        let tip = (1..=grid.slants).map(|k| Node { arclength_mm: tip_mm, slant: slant(k) });
        let nodes: Vec<Node> = along.chain(tip).collect();
        let cells: Vec<Vec<Cell>> = nodes
            .par_iter()
            .map(|n| (0..grid.directions).flat_map(|d| ray(&chain, n, d, &grid)).collect())
            .collect();
        Ok(refined(&nodes, &cells, grid))
    }

    /// Candidates at every node for transverse moments (N mm), written over `out`.
    pub fn candidates(&self, moment_nmm: [f64; 2], out: &mut Vec<Candidate>) {
        let [y, z] = moment_nmm;
        let here = self.corners(moment_nmm);
        let beside = [self.corners([y + BESIDE_NMM, z]), self.corners([y, z + BESIDE_NMM])];
        let mut areas = Vec::with_capacity(self.nodes.len());
        out.clear();
        out.extend((0..self.nodes.len()).map(|node| {
            let (values, reachable) = self.mixed(node, &here);
            let point_mm = Vector3::new(values[0], values[1], values[2]);
            let normal = Vector3::new(values[3], values[4], values[5]);
            let [by_y, by_z] = [0, 1].map(|k| {
                let v = self.mixed(node, &beside[k]).0;
                (Vector3::new(v[0], v[1], v[2]) - point_mm) / BESIDE_NMM
            });
            let normal = normal.try_normalize(1e-9).unwrap_or(Vector3::z());
            areas.push(by_y.cross(&by_z));
            Candidate { point_mm, normal, volume: 0.0, reachable }
        }));
        let last = out.len() - 1;
        for (k, area) in areas.iter().enumerate() {
            let (low, high) = (k.saturating_sub(1), (k + 1).min(last));
            let pitch = (out[high].point_mm - out[low].point_mm) / (high - low) as f64;
            out[k].volume = pitch.dot(area).abs();
        }
    }

    /// Cells around a moment, as offsets within a node, with their weights.
    fn corners(&self, moment_nmm: [f64; 2]) -> [(usize, f64); 4] {
        let g = &self.grid;
        let (size, angle) = (moment_nmm[0].hypot(moment_nmm[1]), moment_nmm[1].atan2(moment_nmm[0]));
        let along = (size / g.most_nmm * g.steps as f64).min(g.steps as f64 - 1e-9);
        let around = angle.rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU * g.directions as f64;
        let (m, d) = (along as usize, around as usize);
        let (u, v) = (along - m as f64, around - d as f64);
        let at = |d: usize, m: usize| d % g.directions * (g.steps + 1) + m;
        [
            (at(d, m), (1.0 - v) * (1.0 - u)),
            (at(d, m + 1), (1.0 - v) * u),
            (at(d + 1, m), v * (1.0 - u)),
            (at(d + 1, m + 1), v * u),
        ]
    }

    fn mixed(&self, node: usize, corners: &[(usize, f64); 4]) -> ([f64; 6], bool) {
        let cells = &self.cells[node * self.grid.directions * (self.grid.steps + 1)..];
        let (mut sum, mut reachable) = ([0.0; 6], true);
        for (at, weight) in corners {
            let (values, there) = &cells[*at];
            reachable &= there;
            sum.iter_mut().zip(values).for_each(|(a, b)| *a += weight * f64::from(*b));
        }
        (sum, reachable)
    }
}

/// Step of moments for the volume, N mm.
const BESIDE_NMM: f64 = 0.02;

fn refined(nodes: &[Node], cells: &[Vec<Cell>], grid: InverseGrid) -> StaticInverse {
    let parts = grid.refine.max(1);
    let last = (nodes.len() - 1) * parts;
    let mix = |a: f64, b: f64, u: f64| a + (b - a) * u;
    let (mut fine, mut fine_cells) = (Vec::with_capacity(last + 1), Vec::new());
    for k in 0..=last {
        let (from, u) = (k / parts, (k % parts) as f64 / parts as f64);
        let to = (from + 1).min(nodes.len() - 1);
        let (a, b) = (nodes[from], nodes[to]);
        fine.push(Node {
            arclength_mm: mix(a.arclength_mm, b.arclength_mm, u),
            slant: mix(a.slant.atan(), b.slant.atan(), u).tan(),
        });
        fine_cells.extend(cells[from].iter().zip(&cells[to]).map(|((a, there), (b, too))| {
            let values: [f32; 6] = std::array::from_fn(|i| mix(a[i].into(), b[i].into(), u) as f32);
            (values, *there && (u == 0.0 || *too))
        }));
    }
    StaticInverse { nodes: fine, grid, cells: fine_cells }
}

/// Newton steps for one moment.
const NEWTON_STEPS: usize = 12;
/// Agreement asked for, N mm.
const AGREES_NMM: f64 = 1e-7;
/// Moment that stands for the first touch, N mm.
const FIRST_NMM: f64 = 1e-4;

/// One node and direction: moments from none to the largest.
fn ray(chain: &Chain, node: &Node, direction: usize, grid: &InverseGrid) -> Vec<Cell> {
    let angle = std::f64::consts::TAU * direction as f64 / grid.directions as f64;
    let toward = Vector2::new(angle.cos(), angle.sin());
    let cell = |force: Vector2<f64>, reachable: bool| {
        let push = chain.pushed(node.arclength_mm, &leaning(force, node.slant));
        let normal = push.force_n.normalize();
        let point = push.axis_mm - normal * chain.radius_mm;
        ([point.x, point.y, point.z, normal.x, normal.y, normal.z].map(|x| x as f32), reachable)
    };
    let step = grid.most_nmm / grid.steps as f64;
    // Without a force there is a direction all the same: that of the first one.
    let mut force = solve(chain, node, toward * FIRST_NMM, Vector2::zeros());
    let mut last = force.unwrap_or(Vector2::new(1e-6, 0.0));
    let mut cells = vec![cell(last, force.is_some())];
    let mut before = Vector2::zeros();
    for m in 1..=grid.steps {
        if let Some(from) = force {
            let guess = if m > 1 { from * 2.0 - before } else { from * (step / FIRST_NMM) };
            before = if m > 1 { from } else { Vector2::zeros() };
            force = solve(chain, node, toward * (step * m as f64), guess);
            last = force.unwrap_or(last);
        }
        cells.push(cell(last, force.is_some()));
    }
    cells
}

fn leaning(force: Vector2<f64>, slant: f64) -> Vector3<f64> {
    Vector3::new(-slant * force.norm(), force.x, force.y)
}

/// Transverse force (N) whose moments at the root are these; `None` where none is found near the guess.
fn solve(chain: &Chain, node: &Node, moment_nmm: Vector2<f64>, guess: Vector2<f64>) -> Option<Vector2<f64>> {
    let moments = |f: Vector2<f64>| {
        let m = chain.pushed(node.arclength_mm, &leaning(f, node.slant)).moment_nmm;
        Vector2::new(m.y, m.z)
    };
    let mut force = guess;
    if force == Vector2::zeros() {
        // Small forces only: the lean has no derivative at none.
        let arm = node.arclength_mm.max(1.0);
        force = Vector2::new(moment_nmm.y, -moment_nmm.x) / arm;
    }
    let start = force;
    for _ in 0..NEWTON_STEPS {
        let off = moments(force) - moment_nmm;
        if off.norm() < AGREES_NMM {
            // A force that turned round on the way belongs to another branch.
            return (guess == Vector2::zeros() || force.dot(&start) > 0.0).then_some(force);
        }
        let h = 1e-4 * force.norm();
        let column = |e: Vector2<f64>| (moments(force + e * h) - moments(force - e * h)) / (2.0 * h);
        let step = Matrix2::from_columns(&[column(Vector2::x()), column(Vector2::y())]).lu().solve(&off)?;
        let most = 0.5 * force.norm();
        force -= if step.norm() > most { step * (most / step.norm()) } else { step };
    }
    None
}
