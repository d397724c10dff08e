//! Distances of contact points from the mesh of the touched object.
//!
//! Where the mesh lies in the frame of the points (x = R p + t) is either known, or taken from the points themselves: R and t minimise
//! `sum_i |x_i - c(x_i)|^2`, c the mesh's closest point, by iterated closest points from the 24 turns by right angles
//! (P. J. Besl, N. D. McKay, IEEE Trans. Pattern Analysis and Machine Intelligence 14 (1992) 239; the turn between matched points by singular
//! values, K. S. Arun et al., ibid. 9 (1987) 698). Six numbers that are fitted take their part of the error: the distances that are left are
//! those of the shape, not of the place.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Serialize;
use wcal_sim::Mesh;

/// Points that the placement is taken from, and rounds of it: for each start, and for the best one.
const MAX_POINTS: usize = 200;
const ROUNDS: [usize; 2] = [8, 80];
/// Rounds end where the sum of squares falls by less than this share.
const SETTLED: f64 = 1e-6;
/// Fewer points place no mesh.
const MIN_POINTS: usize = 6;
/// Points farther than this from the mesh have no closest point, mm.
const MAX_DISTANCE_MM: f64 = 1e4;

/// Distances of contact points to the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeshScore {
    /// Points.
    pub points: usize,
    /// RMS distance, mm.
    pub rmse_mm: f64,
    /// Median distance, mm.
    pub median_mm: f64,
    /// 95 % quantile, mm.
    pub p95_mm: f64,
    /// Whether the mesh was placed by the points themselves.
    pub placed_by_points: bool,
}

/// Closest point of the mesh; the point itself beyond that distance.
fn closest(mesh: &Mesh, p: &Vector3<f64>) -> (f64, Vector3<f64>) {
    mesh.closest_point(p, MAX_DISTANCE_MM)
        .map_or((MAX_DISTANCE_MM, *p), |n| (n.distance_mm.abs(), n.point_mm))
}

/// Rigid motion that takes points to others (least squares); none where they span nothing.
fn matched(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Isometry3<f64>> {
    let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len() as f64;
    let (a, b) = (mean(from), mean(to));
    let spread: Matrix3<f64> = from.iter().zip(to).map(|(p, q)| (p - a) * (q - b).transpose()).sum();
    let svd = spread.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (v * u.transpose()).determinant().signum()));
    let turn =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(v * sign * u.transpose()));
    Some(Isometry3::from_parts(Translation3::from(b - turn * a), turn))
}

/// Rounds of closest points: the placement of the points in the mesh's frame, and the mean square distance, mm^2.
fn iterate(
    mesh: &Mesh,
    points: &[Vector3<f64>],
    start: Isometry3<f64>,
    rounds: usize,
) -> (Isometry3<f64>, f64) {
    let (mut pose, mut last) = (start, f64::INFINITY);
    for _ in 0..rounds {
        let here: Vec<Vector3<f64>> =
            points.iter().map(|p| pose.rotation * p + pose.translation.vector).collect();
        let near: Vec<(f64, Vector3<f64>)> = here.iter().map(|p| closest(mesh, p)).collect();
        let mean_square = near.iter().map(|n| n.0 * n.0).sum::<f64>() / points.len() as f64;
        if mean_square > last * (1.0 - SETTLED) {
            break;
        }
        last = mean_square;
        let to: Vec<Vector3<f64>> = near.iter().map(|n| n.1).collect();
        match matched(points, &to) {
            Some(next) => pose = next,
            None => break,
        }
    }
    let square = |p: &Vector3<f64>| closest(mesh, &(pose.rotation * p + pose.translation.vector)).0.powi(2);
    (pose, points.iter().map(square).sum::<f64>() / points.len() as f64)
}

/// The 24 turns that take the axes to each other.
fn right_angles() -> Vec<UnitQuaternion<f64>> {
    let axes: Vec<Vector3<f64>> =
        [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().flat_map(|a| [a, -a]).collect();
    let mut all = Vec::new();
    for x in &axes {
        for y in axes.iter().filter(|y| x.dot(y) == 0.0) {
            let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[*x, *y, x.cross(y)]));
            all.push(UnitQuaternion::from_rotation_matrix(&turn));
        }
    }
    all
}

/// Scores points against a mesh that lies at `frame_from_mesh` in their frame, or where they put it themselves. None for fewer than six
/// points.
#[must_use]
pub fn mesh_score(
    points_mm: &[Vector3<f64>],
    mesh: &Mesh,
    frame_from_mesh: Option<Isometry3<f64>>,
) -> Option<MeshScore> {
    if points_mm.len() < MIN_POINTS {
        return None;
    }
    let mesh_from_frame = match frame_from_mesh {
        Some(pose) => pose.inverse(),
        None => placed(points_mm, mesh),
    };
    let mut distances: Vec<f64> = points_mm
        .iter()
        .map(|p| closest(mesh, &(mesh_from_frame.rotation * p + mesh_from_frame.translation.vector)).0)
        .collect();
    distances.sort_by(f64::total_cmp);
    let n = distances.len();
    let quantile = |q: f64| distances[((n - 1) as f64 * q).round() as usize];
    Some(MeshScore {
        points: n,
        rmse_mm: (distances.iter().map(|d| d * d).sum::<f64>() / n as f64).sqrt(),
        median_mm: quantile(0.5),
        p95_mm: quantile(0.95),
        placed_by_points: frame_from_mesh.is_none(),
    })
}

/// Where the points lie best on the mesh.
fn placed(points_mm: &[Vector3<f64>], mesh: &Mesh) -> Isometry3<f64> {
    let stride = points_mm.len().div_ceil(MAX_POINTS);
    let chosen: Vec<Vector3<f64>> = points_mm.iter().step_by(stride).copied().collect();
    let middle = chosen.iter().sum::<Vector3<f64>>() / chosen.len() as f64;
    let (low, high) = (mesh.low_mm, mesh.high_mm);
    let starts = right_angles()
        .into_iter()
        .map(|turn| Isometry3::from_parts(Translation3::from(0.5 * (low + high) - turn * middle), turn));
    let best = starts
        .map(|start| iterate(mesh, &chosen, start, ROUNDS[0]))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or_else(Isometry3::identity, |b| b.0);
    iterate(mesh, &chosen, best, ROUNDS[1]).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_sim::objects;

    /// Points on three faces of a block that stands anywhere.
    #[test]
    fn points_find_their_place_on_the_mesh_and_errors_stay() {
        let mesh = objects::built_in("block").unwrap();
        let (low, high) = (mesh.low_mm, mesh.high_mm);
        let at = |u: f64, v: f64, face: usize| {
            let mut p = low + (high - low).component_mul(&Vector3::new(u, v, u * v));
            p[face] = high[face];
            p
        };
        let grid = [0.1, 0.3, 0.6, 0.9];
        let all = (0..48).map(|k| (grid[k % 4], grid[k / 4 % 4], k / 16));
        let on: Vec<Vector3<f64>> = all.map(|(u, v, face)| closest(&mesh, &at(u, v, face)).1).collect();
        let frame = Isometry3::new(Vector3::new(30.0, -200.0, 7.0), Vector3::new(0.1, 1.4, -0.15));
        let moved = |off_mm: f64| -> Vec<Vector3<f64>> {
            let sign = |k: usize| if k.is_multiple_of(2) { off_mm } else { -off_mm };
            on.iter()
                .enumerate()
                .map(|(k, p)| frame.rotation * (p + Vector3::repeat(sign(k))) + frame.translation.vector)
                .collect()
        };
        let exact = mesh_score(&moved(0.0), &mesh, Some(frame)).unwrap();
        assert!(exact.rmse_mm < 1e-9 && !exact.placed_by_points, "{exact:?}");
        let placed = mesh_score(&moved(0.0), &mesh, None).unwrap();
        assert!(placed.rmse_mm < 0.2 && placed.placed_by_points, "{placed:?}");
        // Control: points that are off the surface to both sides are not fitted away.
        let off = mesh_score(&moved(2.0), &mesh, None).unwrap();
        assert!(off.rmse_mm > 0.7, "{off:?}");
        assert!(mesh_score(&moved(0.0)[..5], &mesh, None).is_none());
    }
}
