//! Homographies between a plane and a picture, by the direct linear transformation.
//!
//! ```text
//! h = argmin |A h| over |h| = 1: eigenvector of A^T A with the smallest eigenvalue
//! ```
//! Source: Hartley and Zisserman, Multiple View Geometry, 2nd ed., 4.1.

use nalgebra::{DMatrix, Matrix3, Vector2};

/// Homography that takes `from` (numbers of order 1 to 10, as grid indices) to `to` (px); none for
/// fewer than four points.
pub(crate) fn homography(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let n = from.len();
    if n < 4 || to.len() != n {
        return None;
    }
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
            [x, y, 1.0, 0.0, 0.0, 0.0, -q.x * x, -q.x * y, -q.x],
            [0.0, 0.0, 0.0, x, y, 1.0, -q.y * x, -q.y * y, -q.y],
        ];
        for (d, row) in rows.iter().enumerate() {
            for (col, value) in row.iter().enumerate() {
                a[(2 * k + d, col)] = *value;
            }
        }
    }
    let eigen = (a.transpose() * a).symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let h = Matrix3::from_row_iterator(eigen.eigenvectors.column(smallest).iter().copied());
    let back = Matrix3::new(scale, 0.0, centre.x, 0.0, scale, centre.y, 0.0, 0.0, 1.0);
    Some(back * h)
}

/// A point through a homography; none on the line that it sends to infinity.
pub(crate) fn mapped(homography: &Matrix3<f64>, p: &Vector2<f64>) -> Option<Vector2<f64>> {
    let q = homography * p.push(1.0);
    let to = Vector2::new(q.x / q.z, q.y / q.z);
    to.iter().all(|v| v.is_finite()).then_some(to)
}
