//! What the errors that all shapes share (cameras, board, base tag, light, the wire's end) do to
//! them, in independent parts.
//!
//! ```text
//! C = F F',   (J F)' (J F) = V L V',   parts: columns of J F V by falling L        J: of all shapes' places and lengths by the shared parameters
//! ```
//! Source: principal components of the propagated covariance (JCGM 102:2011, 6.2).

use nalgebra::{DMatrix, DVector, Vector3};
use wcal_core::covariance;
use wcal_core::shapes_document::{PairErrors, ShapesDocument};
use wcal_rod::MeasuredShape;

/// Share of the shapes' variance by common errors below which a part of it is omitted, and largest
/// number of parts.
const LEFT_OUT: f64 = 1e-4;
const MAX_PARTS: usize = 8;

/// The shapes moved by one standard deviation of each independent error that they share; none where
/// a shape does not say how.
///
/// # Errors
/// Where the document's covariance is none.
pub(crate) fn moved_by_shared(
    document: &ShapesDocument,
    usable: &[MeasuredShape],
) -> anyhow::Result<Vec<Vec<MeasuredShape>>> {
    let rows = &document.shared_covariance;
    let count = rows.len();
    let errors = |shape: &MeasuredShape| {
        let pair = document.pairs.iter().find(|p| p.name == shape.name)?;
        pair.errors
            .as_ref()
            .filter(|e| e.shared.len() == count && e.stations.len() > 1)
    };
    let errors: Option<Vec<&PairErrors>> = usable.iter().map(errors).collect();
    let Some(errors) = errors.filter(|_| count > 0) else {
        return Ok(Vec::new());
    };
    covariance::check(rows, count).map_err(|why| anyhow::anyhow!("shared_covariance: {why}"))?;
    let (sd, correlation) = covariance::correlation(rows);
    let correlation = correlation.symmetric_eigen();
    let root = correlation.eigenvalues.map(|v| v.max(0.0).sqrt());
    // With correlations V L V' and standard deviations S: F = S V L^1/2.
    let factor = DMatrix::from_diagonal(&DVector::from_vec(sd))
        * correlation.eigenvectors
        * DMatrix::from_diagonal(&root);
    let by_parameter = |k: usize| {
        let of_pair = |e: &&PairErrors| {
            let column = &e.shared[k];
            let at = |n: usize| column.centreline_mm.get(n).copied().unwrap_or_default();
            (0..e.stations.len())
                .flat_map(at)
                .chain([column.length_mm])
                .collect::<Vec<f64>>()
        };
        DVector::from_vec(errors.iter().flat_map(of_pair).collect())
    };
    let jacobian = DMatrix::from_columns(&(0..count).map(by_parameter).collect::<Vec<_>>());
    // The largest axes of what all errors together do to the shapes: the rest is noise of numbers.
    let moved = jacobian * factor;
    let axes = moved.tr_mul(&moved).symmetric_eigen();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| axes.eigenvalues[*b].total_cmp(&axes.eigenvalues[*a]));
    let enough = LEFT_OUT * axes.eigenvalues.sum();
    let parts = order
        .into_iter()
        .take(MAX_PARTS)
        .filter(|k| axes.eigenvalues[*k] > enough);
    let shapes = |k: usize| {
        let part: DVector<f64> = &moved * axes.eigenvectors.column(k);
        let mut from = 0;
        let mut shapes = Vec::with_capacity(usable.len());
        for (shape, e) in usable.iter().zip(&errors) {
            let length = from + 3 * e.stations.len();
            shapes.push(moved_by(
                shape,
                &e.stations,
                &part.as_slice()[from..=length],
            ));
            from = length + 1;
        }
        shapes
    };
    Ok(parts.map(shapes).collect())
}

/// A shape moved at its stations, and between them in proportion; the last number is the change of
/// its length.
fn moved_by(shape: &MeasuredShape, stations: &[usize], part: &[f64]) -> MeasuredShape {
    let by = |point: usize| {
        let after = stations
            .partition_point(|s| *s < point)
            .clamp(1, stations.len() - 1);
        let [a, b] =
            [after - 1, after].map(|n| Vector3::from_column_slice(&part[3 * n..3 * n + 3]));
        let share = (point as f64 - stations[after - 1] as f64)
            / (stations[after] as f64 - stations[after - 1] as f64).max(1.0);
        a * (1.0 - share) + b * share
    };
    let mut moved = shape.clone();
    moved
        .centreline_mm
        .iter_mut()
        .enumerate()
        .for_each(|(k, p)| *p += by(k));
    moved.length_mm[0] += part[part.len() - 1];
    if let Some((point, arclength_mm)) = &mut moved.groove {
        // The wire lies in the groove: the place goes with it.
        let last = shape.centreline_mm.len() - 1;
        *point += by(((*arclength_mm / shape.length_mm[0] * last as f64)
            .round()
            .max(0.0) as usize)
            .min(last));
    }
    moved
}
