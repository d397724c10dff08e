//! The faces of a mesh that something outside can touch. A bottle's mesh is a shell: a millimetre
//! behind the wall that a wire touches lies another one, and a contact that is a millimetre too
//! deep is on it. A face belongs to the outside where enough of the sky above it is open:
//!
//! ```text
//! open share = |{ d : d . n > 0, the ray from the face along d meets no face }| / |{ d : d . n > 0 }|,    d: Fibonacci lattice on the sphere
//! ```

use crate::MeshError;
use crate::mesh::Mesh;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Directions of the whole sphere.
const DIRECTIONS: usize = 128;
/// A tenth of the sky: from so many open directions on a face is of the outside. The inner wall of
/// a bottle sees less than this of its mouth.
const ENOUGH: usize = DIRECTIONS / 20;
/// A smaller part of the faces than one in so many are nooks of one surface.
const FEW: usize = 20;
/// A ray starts so far from its face, mm.
const OFF_FACE_MM: f64 = 1e-4;

impl Mesh {
    /// The mesh without the faces that nothing outside can touch; the same where they are few.
    ///
    /// # Errors
    /// As [`Mesh::new`].
    pub fn outside(self) -> Result<Self, MeshError> {
        let points: Vec<Vector3<f64>> = self.points().collect();
        let directions = sphere();
        // Of either side: not every mesh says which of them is outside.
        let is_outside = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|k| points[k as usize]);
            let normal = (b - a).cross(&(c - a)).normalize();
            [normal, -normal].iter().any(|n| {
                let from = (a + b + c) / 3.0 + n * OFF_FACE_MM;
                let open = directions
                    .iter()
                    .filter(|d| d.dot(n) > 0.0 && !self.meets(&from, d));
                open.take(ENOUGH).count() == ENOUGH
            })
        };
        let outside: Vec<[u32; 3]> = self
            .triangles()
            .par_iter()
            .filter(|t| is_outside(t))
            .copied()
            .collect();
        let hidden = self.triangles().len() - outside.len();
        if outside.is_empty() || hidden * FEW < self.triangles().len() {
            return Ok(self);
        }
        let mut mesh = Self::new(&self.name, &points, &outside)?;
        mesh.notes = self.notes;
        mesh.notes.push(format!(
            "{hidden} faces that nothing outside can touch are left out"
        ));
        Ok(mesh)
    }
}

/// Directions spread evenly over the sphere.
fn sphere() -> Vec<Vector3<f64>> {
    // Golden angle from point to point, equal areas by height.
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    let direction = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = (golden * k as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    };
    (0..DIRECTIONS).map(direction).collect()
}
