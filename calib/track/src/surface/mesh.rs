//! Mesh of an implicit surface by marching tetrahedra, in the cells near contacts only.
//!
//! Where d changes its sign along an edge of a tetrahedron, from a to b, lies a corner at `a (1 - u) + b u`, `u = d_a / (d_a - d_b)`.
//! Source: A. Doi, A. Koide, "An efficient method of triangulating equi-valued surfaces by using tetrahedral cells", IEICE E74 (1991) 214.

use super::{ImplicitSurface, SurfaceSettings};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// Triangles, corners counted against the clock as seen from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceMesh {
    /// Corners, mm.
    pub corners_mm: Vec<Vector3<f64>>,
    /// Standard deviation of the surface at each, mm.
    pub sd_mm: Vec<f64>,
    /// Triangles.
    pub triangles: Vec<[usize; 3]>,
}

type Cell = [i64; 3];

/// A cube as six tetrahedra round its diagonal, by the bits of its corners.
const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

fn corner(cell: Cell, k: usize) -> Cell {
    [0, 1, 2].map(|axis| cell[axis] + ((k >> axis) & 1) as i64)
}

/// Cells near the contacts.
fn cells(surface: &ImplicitSurface, settings: &SurfaceSettings) -> BTreeSet<Cell> {
    let reach = (settings.reach_mm / settings.cell_mm).ceil() as i64;
    let mut cells = BTreeSet::new();
    for c in surface.contacts() {
        let at = [0, 1, 2].map(|k| (c.point_mm[k] / settings.cell_mm).floor() as i64);
        for x in -reach..=reach {
            for y in -reach..=reach {
                for z in -reach..=reach {
                    if x * x + y * y + z * z <= reach * reach {
                        cells.insert([at[0] + x, at[1] + y, at[2] + z]);
                    }
                }
            }
        }
    }
    cells
}

pub(super) fn mesh(surface: &ImplicitSurface, settings: &SurfaceSettings) -> SurfaceMesh {
    let place = |c: Cell| Vector3::new(c[0] as f64, c[1] as f64, c[2] as f64) * settings.cell_mm;
    let cells = cells(surface, settings);
    let corners: BTreeSet<Cell> = cells.iter().flat_map(|c| (0..8).map(|k| corner(*c, k))).collect();
    let corners: Vec<Cell> = corners.into_iter().collect();
    let values: Vec<f64> = corners.par_iter().map(|c| surface.at(&place(*c))).collect();
    let value: BTreeMap<Cell, f64> = corners.into_iter().zip(values).collect();
    let mut made = SurfaceMesh::default();
    let mut known: BTreeMap<[Cell; 2], usize> = BTreeMap::new();
    for (cell, tetrahedron) in cells.iter().flat_map(|c| TETRAHEDRA.iter().map(move |t| (c, t))) {
        let c = tetrahedron.map(|k| corner(*cell, k));
        let v = c.map(|c| value[&c]);
        let (inside, outside): (Vec<usize>, Vec<usize>) = (0..4).partition(|k| v[*k] < 0.0);
        let mut cross = |from: usize, to: usize| {
            let key = if c[from] < c[to] { [c[from], c[to]] } else { [c[to], c[from]] };
            *known.entry(key).or_insert_with(|| {
                let u = v[from] / (v[from] - v[to]);
                made.corners_mm.push(place(c[from]) * (1.0 - u) + place(c[to]) * u);
                made.corners_mm.len() - 1
            })
        };
        // One corner alone on its side: a triangle; two against two: a quadrilateral, cut into two triangles.
        let faces: Vec<[usize; 3]> = match (&inside[..], &outside[..]) {
            ([one], [p, q, r]) | ([p, q, r], [one]) => {
                vec![[cross(*one, *p), cross(*one, *q), cross(*one, *r)]]
            }
            ([a, b], [p, q]) => {
                let [i, j, k, l] = [cross(*a, *p), cross(*a, *q), cross(*b, *q), cross(*b, *p)];
                vec![[i, j, k], [i, k, l]]
            }
            _ => continue,
        };
        let middle =
            |which: &[usize]| which.iter().map(|k| place(c[*k])).sum::<Vector3<f64>>() / which.len() as f64;
        let outward = middle(&outside) - middle(&inside);
        for [i, j, k] in faces {
            let [p, q, r] = [i, j, k].map(|n| made.corners_mm[n]);
            let turned = (q - p).cross(&(r - p)).dot(&outward) < 0.0;
            made.triangles.push(if turned { [i, k, j] } else { [i, j, k] });
        }
    }
    made.sd_mm = made.corners_mm.par_iter().map(|p| surface.sd_mm(p)).collect();
    made
}

impl SurfaceMesh {
    /// As a PLY file, in mm, with the standard deviation of every corner.
    #[must_use]
    pub fn ply(&self, frame: &str) -> String {
        let mut out = format!(
            "ply\nformat ascii 1.0\ncomment touched surface, mm, frame: {frame}\nelement vertex {}\n",
            self.corners_mm.len()
        );
        ["x", "y", "z", "sd_mm"].iter().for_each(|n| out += &format!("property double {n}\n"));
        let _ = write!(
            out,
            "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            self.triangles.len()
        );
        for (p, sd) in self.corners_mm.iter().zip(&self.sd_mm) {
            let _ = writeln!(out, "{:.4} {:.4} {:.4} {sd:.4}", p.x, p.y, p.z);
        }
        for [a, b, c] in &self.triangles {
            let _ = writeln!(out, "3 {a} {b} {c}");
        }
        out
    }
}
