//! Distances of contact points from the mesh of the touched object, where its place is known: from
//! those of its faces that something outside can touch. A vessel's mesh has an inner wall, too,
//! which is near to contacts that are too deep; it does not count.

use nalgebra::{Isometry3, Vector3};
use schemars::JsonSchema;
use serde::Serialize;
use wcal_mesh::{Mesh, MeshError};

/// Fewer points make no statistics.
const MIN_POINTS: usize = 6;
/// Points farther than this from the mesh have no closest point, mm.
const MAX_DISTANCE_MM: f64 = 1e4;

/// Distances from a surface.
#[derive(Debug, Clone, Copy, Serialize, JsonSchema)]
pub struct Distances {
    /// RMS distance, mm.
    pub rmse_mm: f64,
    /// Mean distance, mm.
    pub mean_mm: f64,
    /// Median distance, mm.
    pub median_mm: f64,
    /// 95 % quantile, mm.
    pub p95_mm: f64,
}

impl Distances {
    /// Of distances, mm; not of none.
    pub(crate) fn new(mut mm: Vec<f64>) -> Self {
        mm.iter_mut().for_each(|d| *d = d.abs());
        mm.sort_by(f64::total_cmp);
        let n = mm.len() as f64;
        // Nearest rank.
        let quantile = |q: f64| mm[((n - 1.0) * q).round() as usize];
        Self {
            rmse_mm: (mm.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
            mean_mm: mm.iter().sum::<f64>() / n,
            median_mm: quantile(0.5),
            p95_mm: quantile(0.95),
        }
    }
}

/// Distances of contact points to the mesh.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct MeshScore {
    /// Points.
    pub points: usize,
    /// With the mesh where it is said to be.
    #[serde(flatten)]
    pub distances: Distances,
}

impl MeshScore {
    /// Of signed distances, mm; none for fewer than six.
    pub fn new(distances_mm: Vec<f64>) -> Option<Self> {
        let points = distances_mm.len();
        (points >= MIN_POINTS).then(|| Self {
            points,
            distances: Distances::new(distances_mm),
        })
    }
}

/// An object whose place is known.
pub struct KnownObject {
    /// What of its mesh can be touched from outside.
    pub mesh: Mesh,
    /// Where it lies in the frame of the base's poses.
    pub world_from_object: Isometry3<f64>,
    /// Distance of a stated place from the surface that it touches, mm.
    pub radius_mm: f64,
}

impl KnownObject {
    /// Of a mesh.
    ///
    /// # Errors
    /// As [`Mesh::outside`].
    pub fn new(
        mesh: Mesh,
        world_from_object: Isometry3<f64>,
        radius_mm: f64,
    ) -> Result<Self, MeshError> {
        Ok(Self {
            mesh: mesh.outside()?,
            world_from_object,
            radius_mm,
        })
    }

    /// Distance of a contact in the world from the surface, positive outside, mm.
    pub fn distance_mm(&self, world_mm: &Vector3<f64>) -> f64 {
        let point = self
            .world_from_object
            .inverse_transform_point(&(*world_mm).into())
            .coords;
        let near = self.mesh.closest_point(&point, MAX_DISTANCE_MM);
        near.map_or(MAX_DISTANCE_MM, |near| near.distance_mm) - self.radius_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_lab_sweeps::objects;

    /// Points on three faces of a block that stands anywhere.
    #[test]
    fn errors_of_points_are_their_distances_and_none_is_fitted_away() {
        let mesh = objects::built_in("block").unwrap();
        let (low, high) = (mesh.low_mm, mesh.high_mm);
        let at = |u: f64, v: f64, face: usize| {
            let mut p = low + (high - low).component_mul(&Vector3::new(u, v, u * v));
            p[face] = high[face];
            p
        };
        let grid = [0.1, 0.3, 0.6, 0.9];
        let all = (0..48).map(|k| (grid[k % 4], grid[k / 4 % 4], k / 16));
        let closest = |p: Vector3<f64>| mesh.closest_point(&p, MAX_DISTANCE_MM).unwrap().point_mm;
        let on: Vec<Vector3<f64>> = all.map(|(u, v, face)| closest(at(u, v, face))).collect();
        let frame = Isometry3::new(
            Vector3::new(30.0, -200.0, 7.0),
            Vector3::new(0.1, 1.4, -0.15),
        );
        let moved = |off_mm: f64| -> Vec<Vector3<f64>> {
            let sign = |k: usize| if k.is_multiple_of(2) { off_mm } else { -off_mm };
            on.iter()
                .enumerate()
                .map(|(k, p)| {
                    frame.rotation * (p + Vector3::repeat(sign(k))) + frame.translation.vector
                })
                .collect()
        };
        let known = |world_from_object, radius_mm| {
            KnownObject::new(mesh.clone(), world_from_object, radius_mm).unwrap()
        };
        let score = |object: KnownObject, points: &[Vector3<f64>]| {
            MeshScore::new(points.iter().map(|p| object.distance_mm(p)).collect())
        };
        let exact = score(known(frame, 0.0), &moved(0.0)).unwrap();
        assert!(
            exact.distances.rmse_mm < 1e-9 && exact.points == 48,
            "{exact:?}"
        );
        // A mesh that does not stand where it is said to, and points off the surface to both sides.
        let mut pose = frame;
        pose.translation.vector += Vector3::new(0.4, 0.0, -0.4);
        let off = score(known(pose, 0.0), &moved(0.0)).unwrap();
        assert!(off.distances.rmse_mm > 0.1, "{off:?}");
        let off = score(known(frame, 0.0), &moved(2.0)).unwrap();
        assert!(off.distances.rmse_mm > 0.7, "{off:?}");
        // A point of the axis of a wire is its radius outside.
        assert!((known(frame, 0.15).distance_mm(&moved(0.0)[0]) + 0.15).abs() < 1e-6);
        assert!(score(known(frame, 0.0), &moved(0.0)[..5]).is_none());
    }
}
