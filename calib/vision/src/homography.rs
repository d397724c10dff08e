//! Homographies between a plane and a picture, by the direct linear transformation.
//!
//! ```text
//! h = argmin |A h| over |h| = 1: eigenvector of A^T A with the smallest eigenvalue
//! ```
//! Source: Hartley and Zisserman, Multiple View Geometry, 2nd ed., 4.1.

use crate::rigid::pose_from_parts;
use nalgebra::{DMatrix, Isometry3, Matrix3, Vector2};

/// Homography that takes `from` (numbers of order 1 to 10, as grid indices) to `to` (px); none for
/// fewer than four points.
pub(crate) fn homography(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let n = from.len();
    if n < 4 || to.len() != n {
        return None;
    }
    // Centred and scaled: the normal matrix would else be badly conditioned (Hartley 1997).
    let centre = to.iter().sum::<Vector2<f64>>() / n as f64;
    let scale = to.iter().map(|p| (p - centre).norm()).sum::<f64>() / n as f64;
    if scale <= 0.0 {
        return None;
    }
    let mut a = DMatrix::<f64>::zeros(2 * n, 9);
    for (k, (f, p)) in from.iter().zip(to).enumerate() {
        let (x, y) = (f.x, f.y);
        let q = (p - centre) / scale;
        let rows = [
            // q.x (h3 . p) = h1 . p, linear in h: two rows a point.
            [x, y, 1.0, 0.0, 0.0, 0.0, -q.x * x, -q.x * y, -q.x],
            [0.0, 0.0, 0.0, x, y, 1.0, -q.y * x, -q.y * y, -q.y],
        ];
        for (d, row) in rows.iter().enumerate() {
            for (col, value) in row.iter().enumerate() {
                a[(2 * k + d, col)] = *value;
            }
        }
    }
    // The least singular vector of A is the eigenvector of A^T A with the least eigenvalue.
    let eigen = (a.transpose() * a).symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let h = Matrix3::from_row_iterator(eigen.eigenvectors.column(smallest).iter().copied());
    let back = Matrix3::new(scale, 0.0, centre.x, 0.0, scale, centre.y, 0.0, 0.0, 1.0);
    Some(back * h)
}

/// Pose of a plane (z = 0) whose points a pinhole sees at normalised coordinates: by the columns
/// h1, h2, h1 x h2 of their homography.
pub(crate) fn plane_pose(plane: &[Vector2<f64>], seen: &[Vector2<f64>]) -> Option<Isometry3<f64>> {
    let size = plane
        .iter()
        .map(|p| p.amax())
        .fold(f64::MIN_POSITIVE, f64::max);
    let scaled: Vec<_> = plane.iter().map(|p| p / size).collect();
    let found = homography(&scaled, seen)?;
    let [c0, c1, c2] = [0, 1, 2].map(|k| found.column(k) / found[(2, 2)]);
    // Both columns are unit vectors but for the homography's own scale.
    let scale = 2.0 / (c0.norm() + c1.norm());
    let (x, y) = (c0 * scale, c1 * scale);
    let turn = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    let pose = pose_from_parts(&turn, &(c2 * scale * size));
    pose.translation
        .vector
        .iter()
        .all(|v| v.is_finite())
        .then_some(pose)
}

/// A point through a homography; none on the line that it sends to infinity.
pub(crate) fn mapped(homography: &Matrix3<f64>, p: &Vector2<f64>) -> Option<Vector2<f64>> {
    let q = homography * p.push(1.0);
    let to = Vector2::new(q.x / q.z, q.y / q.z);
    to.iter().all(|v| v.is_finite()).then_some(to)
}
