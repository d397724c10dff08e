//! Where a single contact can be, given the two transverse moments: a curve in space, one point for
//! each arc length.
//!
//! A force F across the wire at arc length s bends it; the rod gives the moments at the root:
//!
//! ```text
//! m(s, F) = [M_y, M_z],   M = r(s) x F             solved for F at given m, for every s (Newton and Broyden, `force`)
//! p(s; m) = r(s) - a n,   n = F / |F|              touched point: the axis less the wire's radius a along the force
//! tip:  n . r / |r| = -sin(tilt),  0 <= tilt < pi/2   the force may tilt toward the root; its tilt takes the place of s
//! p(s; m) ~ sum_ij L_i(direction) L_j(|m|) p_ij    table over direction and size of m, cubic Lagrange polynomials L
//! dp/dm, dn/dm                                      forward differences of the interpolated table
//! ```
//!
//! Two force components and s are three unknowns for two moments: the rod gives the curve; time,
//! the base's travel and what is known of objects choose the point on it. What points at the root
//! makes no moment there. Source of the rod: `wcal_rod`.

use crate::error::NetworkError;
use force::{moment, solve_ray, solve_tilts};
use grid::TableEntry;
pub use grid::{GRID_RANGES, InverseGrid};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::f64::consts::TAU;
use wcal_core::interpolation::cubic;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{DiscreteRod, Rod};

mod force;
mod grid;

/// A contact that would explain the moments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseSolution {
    /// Point of the object, mm: the wire's axis less its radius along the force.
    pub point_mm: Vector3<f64>,
    /// Direction of the force on the wire.
    pub normal: Vector3<f64>,
    /// Derivative of the point along the force by the moments (norm over both), mm/(N mm).
    pub compliance_mm_per_nmm: f64,
    /// Derivative of the force's direction by the moments (norm over both), rad/(N mm).
    pub turn_rad_per_nmm: f64,
    /// Whether a force at this arc length can give the moments; where not, the solution is that of
    /// the largest moments that it can give.
    pub reachable: bool,
}

/// A node of the curve.
#[derive(Debug, Clone, Copy)]
pub struct Node {
    /// Arc length, mm.
    pub arclength_mm: f64,
    /// Tilt of the force: 0 perpendicular to the wire, toward 1 straight at the root; nonzero at
    /// the tip only.
    pub tilt: f64,
}

/// The table.
#[derive(Debug, Clone)]
pub struct StaticInverse {
    /// Nodes from the root to the tip, then the tip's tilts.
    pub nodes: Vec<Node>,
    /// Whether the free wire lies in the plane y = 0: there a sweep's mirror image is a sweep, too.
    pub flat: bool,
    grid: InverseGrid,
    /// By arc length, direction and moment: point and normal.
    cells: Vec<TableEntry>,
}

/// Mesh of a declared wire's shape, and how far a flat one lies from its plane, mm.
const MESH_MM: f64 = 0.25;
const FLAT_MM: f64 = 1e-9;

impl StaticInverse {
    /// Solves the rod on the whole grid.
    ///
    /// # Errors
    /// Where the whisker cannot be used or the grid is too coarse to hold a cell.
    pub fn new(whisker: &WhiskerSpec, grid: InverseGrid) -> Result<Self, NetworkError> {
        Self::of_rod(&Rod::new(whisker, MESH_MM)?, whisker.diameter_mm, grid)
    }

    /// The same of a rod whose section, shape and clamp may differ from a declared wire's.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_rod(rod: &Rod, diameter_mm: f64, grid: InverseGrid) -> Result<Self, NetworkError> {
        if grid.directions < 4 || grid.steps < 2 || !(grid.max_nmm > 0.0 && grid.step_mm > 0.0) {
            return Err(NetworkError::value(
                "inverse grid",
                "4 directions, 2 steps or more",
                format!("{grid:?}"),
            ));
        }
        let tip_mm = rod.shape.length_mm;
        grid.check(tip_mm)?;
        let flat = (0..=grid.links).all(|k| {
            rod.shape
                .rest_point(tip_mm * k as f64 / grid.links as f64)
                .y
                .abs()
                < FLAT_MM
        });
        let rod = DiscreteRod::of_rod(rod, diameter_mm, grid.links)?;
        let steps = ((tip_mm - grid.first_mm) / grid.step_mm).floor().max(1.0) as usize;
        // Nodes count back from the tip, so that the last one lies there.
        let along = (0..=steps).map(|k| Node {
            arclength_mm: tip_mm - grid.step_mm * (steps - k) as f64,
            tilt: 0.0,
        });
        let tip = (1..=grid.tilts).map(|k| Node {
            arclength_mm: tip_mm,
            tilt: k as f64 / (grid.tilts + 1) as f64,
        });
        let nodes: Vec<Node> = along.collect();
        let rays = |n: &Node| -> Vec<TableEntry> {
            let all = (0..grid.directions).flat_map(|d| solve_ray(&rod, n.arclength_mm, d, &grid));
            all.map(|s| s.0).collect()
        };
        let mut cells: Vec<Vec<TableEntry>> = nodes.par_iter().map(rays).collect();
        // Tilts go on from the force that is square to the wire at its tip.
        let tilts = |d: usize| -> Vec<Vec<TableEntry>> {
            let square = solve_ray(&rod, tip_mm, d, &grid).into_iter().enumerate();
            square
                .map(|(m, (_, force))| solve_tilts(&rod, tip_mm, force, moment(d, m, &grid), &grid))
                .collect()
        };
        let tilted: Vec<_> = (0..grid.directions).into_par_iter().map(tilts).collect();
        let of_lean = |k: usize| tilted.iter().flatten().map(|at| at[k]).collect();
        cells.extend((0..grid.tilts).map(of_lean));
        let nodes: Vec<Node> = nodes.into_iter().chain(tip).collect();
        Ok(refine(&nodes, &cells, flat, grid))
    }

    /// Number of the nodes on the wire; those after them are the tip's.
    pub(crate) fn first_tip(&self) -> usize {
        self.nodes
            .iter()
            .position(|n| n.tilt > 0.0)
            .unwrap_or(self.nodes.len())
    }

    /// Candidates at every node for transverse moments (N mm), written over `out`.
    pub fn solutions(&self, moment_nmm: [f64; 2], out: &mut Vec<InverseSolution>) {
        let [y, z] = moment_nmm;
        // dp/dm and dn/dm by forward differences in each moment component.
        let at = [[y, z], [y + MOMENT_STEP_NMM, z], [y, z + MOMENT_STEP_NMM]];
        let stencils = at.map(|moment_nmm| self.stencil(moment_nmm));
        out.clear();
        out.extend((0..self.nodes.len()).map(|node| {
            let [(here, reachable), (by_y, _), (by_z, _)] =
                stencils.each_ref().map(|s| self.interpolate(node, s));
            let point_mm = Vector3::new(here[0], here[1], here[2]);
            let normal = Vector3::new(here[3], here[4], here[5]);
            let [by_y, by_z] = [by_y, by_z].map(|v| {
                let by = |at: usize, from: &Vector3<f64>| {
                    (Vector3::new(v[at], v[at + 1], v[at + 2]) - from) / MOMENT_STEP_NMM
                };
                (by(0, &point_mm), by(3, &normal))
            });
            // Norm of the derivative over both moments.
            let turn_rad_per_nmm = by_y.1.norm().hypot(by_z.1.norm());
            let normal = normal.try_normalize(1e-9).unwrap_or(Vector3::z());
            let compliance_mm_per_nmm = normal.dot(&by_y.0).hypot(normal.dot(&by_z.0));
            InverseSolution {
                point_mm,
                normal,
                compliance_mm_per_nmm,
                turn_rad_per_nmm,
                reachable,
            }
        }));
    }

    /// Cells around a moment, as offsets within a node, with their weights: cubic through four in
    /// each direction; at the ends of the moments' range the parabola through three.
    fn stencil(&self, moment_nmm: [f64; 2]) -> Stencil {
        let g = &self.grid;
        let (size, angle) = (
            moment_nmm[0].hypot(moment_nmm[1]),
            moment_nmm[1].atan2(moment_nmm[0]),
        );
        // Moments larger than the table's take its edge.
        let along = (size / g.max_nmm * g.steps as f64).min(g.steps as f64 - 1e-9);
        let around = angle.rem_euclid(TAU) / TAU * g.directions as f64;
        let (m, d) = (along as usize, around as usize);
        let (mut by_m, by_d) = (cubic(along - m as f64), cubic(around - d as f64));
        // A fourth cell outside the table has the value of the parabola through the other three.
        let first = if m == 0 {
            by_m = [
                by_m[1] + 3.0 * by_m[0],
                by_m[2] - 3.0 * by_m[0],
                by_m[3] + by_m[0],
                0.0,
            ];
            0
        } else if m + 2 > g.steps {
            by_m = [
                0.0,
                by_m[0] + by_m[3],
                by_m[1] - 3.0 * by_m[3],
                by_m[2] + 3.0 * by_m[3],
            ];
            m - 2
        } else {
            m - 1
        };
        let at = |d: usize, m: usize| d % g.directions * (g.steps + 1) + m;
        let cells = std::array::from_fn(|k| {
            let (i, j) = (k / 4, k % 4);
            (
                at(d + g.directions + i - 1, (first + j).min(g.steps)),
                by_d[i] * by_m[j],
            )
        });
        let u = around - d as f64;
        let v = along - m as f64;
        let inner = [
            (at(d, m), (1.0 - u) * (1.0 - v)),
            (at(d, m + 1), (1.0 - u) * v),
            (at(d + 1, m), u * (1.0 - v)),
            (at(d + 1, m + 1), u * v),
        ];
        Stencil { cells, inner }
    }

    /// Value at a node, and whether a force there can give the moments.
    fn interpolate(&self, node: usize, stencil: &Stencil) -> ([f64; 6], bool) {
        let cells = &self.cells[node * self.grid.directions * (self.grid.steps + 1)..];
        let mut sum = [0.0; 6];
        let mut add = |(at, weight): &(usize, f64)| {
            sum.iter_mut()
                .zip(&cells[*at].0)
                .for_each(|(a, b)| *a += weight * f64::from(*b));
        };
        // Next to unreachable cells bilinear interpolation through the four innermost.
        if stencil
            .cells
            .iter()
            .all(|(at, weight)| *weight == 0.0 || cells[*at].1)
        {
            stencil.cells.iter().for_each(&mut add);
            (sum, true)
        } else {
            stencil.inner.iter().for_each(&mut add);
            (sum, stencil.inner.iter().all(|(at, _)| cells[*at].1))
        }
    }
}

/// Cells around a moment with their weights: sixteen, and the innermost four.
struct Stencil {
    cells: [(usize, f64); 16],
    inner: [(usize, f64); 4],
}

/// Step of the moments for derivatives, N mm.
const MOMENT_STEP_NMM: f64 = 0.02;

fn refine(
    nodes: &[Node],
    cells: &[Vec<TableEntry>],
    flat: bool,
    grid: InverseGrid,
) -> StaticInverse {
    let parts = grid.refine.max(1);
    let last = (nodes.len() - 1) * parts;
    let mix = |a: f64, b: f64, u: f64| a + (b - a) * u;
    let first_tip = nodes
        .iter()
        .position(|n| n.tilt > 0.0)
        .map_or(nodes.len() - 1, |k| k - 1);
    let (mut fine, mut fine_cells) = (Vec::with_capacity(last + 1), Vec::new());
    for k in 0..=last {
        let (from, u) = (k / parts, (k % parts) as f64 / parts as f64);
        let to = (from + 1).min(nodes.len() - 1);
        let (a, b) = (nodes[from], nodes[to]);
        fine.push(Node {
            arclength_mm: mix(a.arclength_mm, b.arclength_mm, u),
            tilt: mix(a.tilt, b.tilt, u),
        });
        // Cubic along the wire and along the tilts, linear next to the tip, where the curve has a
        // corner.
        let whole = from > 0
            && to + 1 < nodes.len()
            && (from < first_tip) == (from - 1 < first_tip)
            && (to <= first_tip) == (to < first_tip);
        let by = if whole {
            cubic(u)
        } else {
            [0.0, 1.0 - u, u, 0.0]
        };
        let four = [
            from.saturating_sub(1),
            from,
            to,
            (to + 1).min(nodes.len() - 1),
        ]
        .map(|n| &cells[n]);
        fine_cells.extend((0..cells[from].len()).map(|c| {
            // A place between two nodes is reachable where both are.
            let there = four[1][c].1 && (u == 0.0 || four[2][c].1);
            let smooth = four[0][c].1 && four[3][c].1;
            let by = if smooth { by } else { [0.0, 1.0 - u, u, 0.0] };
            let value = |i: usize| {
                (0..4)
                    .map(|n| by[n] * f64::from(four[n][c].0[i]))
                    .sum::<f64>() as f32
            };
            (std::array::from_fn(value), there)
        }));
    }
    StaticInverse {
        nodes: fine,
        flat,
        grid,
        cells: fine_cells,
    }
}
