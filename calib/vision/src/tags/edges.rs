//! Corners of a tag from every edge between a dark and a bright cell, not from its outline alone: ink, a camera's tone curve
//! and half-saturated paper move all edges toward one colour by the same amount. Inner edges have both polarities, so that
//! this spread is solved for together with the corners instead of biasing the tag's size.
//!
//! ```text
//! n_i . (observed_i - H(c) m_i) = polarity_i s + noise      unknowns: four corners c (homography H), spread s of the dark cells
//! ```
//! with an edge's middle m_i in the tag's square and its normal n_i in undistorted pixels; weighted least squares.
//! Source: Zhang, "A Flexible New Technique for Camera Calibration", IEEE PAMI 22(11), 2000, appendix A (homography).

use crate::camera::{Camera, distorted_px, undistorted_px};
use crate::picture::Picture;
use crate::profile::blurred_step;
use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector4};
use wcal_core::least_squares::{Damping, Ending, NormalEquations, minimise};

/// Movement at which a fit ends, px.
pub(crate) const FINE_PX: f64 = 0.01;
/// Cells smaller than this do not resolve the grey levels on both sides of an edge, px.
const MIN_CELL_PX: f64 = 5.0;
/// Edges needed: 9 unknowns, and enough beyond them to judge the scatter.
const MIN_EDGES: usize = 32;
/// Share of a cell's side that an edge is fitted over; the rest is kept clear of the crossing edges.
const ALONG: f64 = 0.66;
/// Floor of an edge's standard deviation, px: the raster of the print, which the pixels' noise does not include.
const SCATTER_FLOOR_PX: f64 = 0.005;

/// Refined corners.
pub(crate) struct Corners {
    /// Straightened px, in the order of the tag's corners.
    pub corners: [Vector2<f64>; 4],
    /// Covariances, px^2.
    pub covariances: [Matrix2<f64>; 4],
}

/// An edge between two cells: middle and half length in the tag's frame (-1..1), measured offset across it.
struct CellEdge {
    middle: Vector2<f64>,
    normal: Vector2<f64>,
    observed: Vector2<f64>,
    /// +1 where the normal points from dark to bright.
    polarity: f64,
    variance: f64,
}

/// Corners by all cell edges, starting from `start` (straightened px). None where the tag is too small or mostly hidden.
pub(crate) fn refine_by_cells(
    picture: &Picture,
    camera: Option<&Camera>,
    start: &[Vector2<f64>; 4],
    cells: usize,
) -> Option<Corners> {
    let shortest = (0..4).map(|k| (start[(k + 1) % 4] - start[k]).norm()).fold(f64::INFINITY, f64::min);
    if shortest / (cells as f64) < MIN_CELL_PX {
        return None;
    }
    let mut found = Corners { corners: *start, covariances: [Matrix2::zeros(); 4] };
    // The first round balances bright against dark only; the second fits the profile to the pixels about its edges.
    for method in [balance as Method, fit] {
        let edges = cell_edges(picture, camera, &found.corners, cells, method)?;
        found = solve(&found.corners, &edges)?;
    }
    let near = found.corners.iter().zip(start).all(|(a, b)| (a - b).norm() < 3.0);
    near.then_some(found)
}

/// The map from the tag's square (-1..1) to straightened pixels.
fn homography(corners: &[Vector2<f64>; 4]) -> Option<[f64; 8]> {
    let mut a = SMatrix::<f64, 8, 8>::zeros();
    let mut b = SVector::<f64, 8>::zeros();
    for (k, (p, q)) in UNIT.iter().zip(corners).enumerate() {
        a.row_mut(2 * k).copy_from_slice(&[p[0], p[1], 1.0, 0.0, 0.0, 0.0, -q.x * p[0], -q.x * p[1]]);
        a.row_mut(2 * k + 1).copy_from_slice(&[0.0, 0.0, 0.0, p[0], p[1], 1.0, -q.y * p[0], -q.y * p[1]]);
        b[2 * k] = q.x;
        b[2 * k + 1] = q.y;
    }
    a.lu().solve(&b).map(|s| std::array::from_fn(|k| s[k]))
}

/// Corners of the square in the tag's order.
const UNIT: [[f64; 2]; 4] = [[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]];

fn map(h: &[f64; 8], p: &Vector2<f64>) -> Vector2<f64> {
    let w = h[6] * p.x + h[7] * p.y + 1.0;
    Vector2::new((h[0] * p.x + h[1] * p.y + h[2]) / w, (h[3] * p.x + h[4] * p.y + h[5]) / w)
}

fn cell_edges(
    picture: &Picture,
    camera: Option<&Camera>,
    corners: &[Vector2<f64>; 4],
    cells: usize,
    method: Method,
) -> Option<Vec<CellEdge>> {
    let h = homography(corners)?;
    let side = 2.0 / cells as f64;
    let place = |k: f64| k * side - 1.0;
    // Grey values of the cells, one ring outside included.
    let count = cells + 2;
    let grey: Vec<f64> = (0..count * count)
        .map(|k| {
            let (i, j) = ((k % count) as f64 - 0.5, (k / count) as f64 - 0.5);
            let p = distorted_px(camera, &map(&h, &Vector2::new(place(i), place(j))));
            picture.sample(p.x, p.y)
        })
        .collect();
    let mut sorted = grey.clone();
    sorted.sort_by(f64::total_cmp);
    let (dark, bright) = (sorted[sorted.len() / 10], sorted[sorted.len() * 9 / 10]);
    let colour = |i: usize, j: usize| {
        let x = (grey[j * count + i] - dark) / (bright - dark).max(1.0);
        // In between: a shadow, a smear or the wire covers the cell.
        ((x - 0.5).abs() > 0.15).then_some(x > 0.5)
    };
    let mut edges = Vec::new();
    for across in 1..=cells {
        for k in 0..=cells {
            for upright in [true, false] {
                let (one, two, middle, along) = if upright {
                    let m = Vector2::new(place(k as f64), place(across as f64 - 0.5));
                    (colour(k, across), colour(k + 1, across), m, Vector2::new(0.0, 1.0))
                } else {
                    let m = Vector2::new(place(across as f64 - 0.5), place(k as f64));
                    (colour(across, k), colour(across, k + 1), m, Vector2::new(1.0, 0.0))
                };
                let (Some(one), Some(two)) = (one, two) else { continue };
                if one != two {
                    let half = along * (0.5 * ALONG * side);
                    edges.extend(measure(picture, camera, &h, [&middle, &half], method));
                }
            }
        }
    }
    (edges.len() >= MIN_EDGES).then_some(edges)
}

/// An edge across its pixels: where it lies and the variance of that, px and px^2, its lower side's level and its step, DN.
pub(crate) struct Profile {
    pub offset_px: f64,
    variance_px2: f64,
    pub level: f64,
    pub step: f64,
}

/// Measures an edge from (place across it in px, grey value) of its pixels, which extend this far to both sides.
type Method = fn(&[(f64, f64)], f64) -> Option<Profile>;

/// Levels far from the edge on its two sides.
fn levels(pixels: &[(f64, f64)], from_px: f64) -> [f64; 2] {
    [-1.0, 1.0].map(|sign| {
        let (n, sum) =
            pixels.iter().filter(|p| sign * p.0 > from_px).fold((0.0, 0.0), |(n, s), p| (n + 1.0, s + p.1));
        sum / f64::max(n, 1.0)
    })
}

/// Where an edge lies whose mean grey value is what the pixels have: within a tenth of a pixel, in one pass.
pub(crate) fn balance(pixels: &[(f64, f64)], reach: f64) -> Option<Profile> {
    let [low, high] = levels(pixels, 0.5 * reach);
    let step = high - low;
    // The sum over the pixels of what each lacks to an edge at 0, over the pixels that a shift by 1 px changes.
    let lack: f64 = pixels.iter().map(|p| if p.0 > 0.0 { high - p.1 } else { low - p.1 }).sum();
    let offset_px = lack / step * 2.0 * reach / pixels.len() as f64;
    (offset_px.abs() < 0.5 * reach).then_some(Profile { offset_px, variance_px2: 0.01, level: low, step })
}

/// Measures one cell's edge.
fn measure(
    picture: &Picture,
    camera: Option<&Camera>,
    h: &[f64; 8],
    [middle, half]: [&Vector2<f64>; 2],
    method: Method,
) -> Option<CellEdge> {
    let straight = [map(h, &(middle - half)), map(h, &(middle + half))];
    let [a, b] = straight.map(|p| distorted_px(camera, &p));
    let (origin, length) = (0.5 * (a + b), (b - a).norm());
    let along = (b - a) / length;
    let normal = Vector2::new(-along.y, along.x);
    // Half of the next cell at most, and no more than a wide blur needs.
    let reach = (0.5 * length / ALONG).min(6.0);
    let span = reach.hypot(0.5 * length) + 1.0;
    if !picture.contains(origin.x, origin.y, span) {
        return None;
    }
    let mut pixels: Vec<(f64, f64)> = Vec::with_capacity(128);
    for y in (origin.y - span) as i64..=(origin.y + span) as i64 {
        for x in (origin.x - span) as i64..=(origin.x + span) as i64 {
            let d = Vector2::new(x as f64, y as f64) - origin;
            if along.dot(&d).abs() <= 0.5 * length && normal.dot(&d).abs() <= reach {
                pixels.push((normal.dot(&d), picture.at(x, y)));
            }
        }
    }
    if pixels.len() < 12 {
        return None;
    }
    let profile = method(&pixels, reach)?;
    let observed = undistorted_px(camera, &(origin + normal * profile.offset_px));
    // The normal in straightened pixels, at right angles to the edge there.
    let run = (straight[1] - straight[0]).normalize();
    Some(CellEdge {
        middle: *middle,
        normal: Vector2::new(-run.y, run.x),
        observed,
        polarity: profile.step.signum(),
        variance: profile.variance_px2,
    })
}

/// Fits `level + step S((u - d) / s)`.
fn fit(pixels: &[(f64, f64)], reach: f64) -> Option<Profile> {
    let linearise = |p: &Vector4<f64>| {
        let (mut cost, mut m, mut g) = (0.0, Matrix4::zeros(), Vector4::zeros());
        let blur = p[1].exp();
        for &(u, value) in pixels {
            let e = u - p[0];
            let (f, slope) = blurred_step(e, blur);
            let r = value - p[2] - p[3] * f;
            let j = Vector4::new(-p[3] * slope, -p[3] * slope * e, 1.0, f);
            cost += r * r;
            m += j * j.transpose();
            g += j * r;
        }
        Some(NormalEquations { cost, matrix: m, descent: g })
    };
    let [low, high] = levels(pixels, 0.0);
    let start = Vector4::new(0.0, 0.9f64.ln(), low, high - low);
    let damping = Damping { max: 1e6, max_steps: 20, ..Damping::default() };
    let settled = |step: &Vector4<f64>, _: [f64; 2]| step[0].abs() < FINE_PX;
    let first = (start, linearise(&start)?);
    let found = minimise(first, &damping, linearise, |p, _, step| p + step, settled);
    if found.ending == Ending::Singular {
        return None;
    }
    let (p, NormalEquations { cost, matrix: m, .. }) = (found.place, found.at);
    if p[0].abs() > 0.5 * reach || p[1].exp() > reach || !cost.is_finite() {
        return None;
    }
    let variance_px2 = m.try_inverse()?[(0, 0)] * cost / (pixels.len() as f64 - 4.0);
    Some(Profile { offset_px: p[0], variance_px2, level: p[2], step: p[3] })
}

/// Corners and spread from the edges: Gauss-Newton with Student weights whose scale is the edges' own scatter.
fn solve(start: &[Vector2<f64>; 4], edges: &[CellEdge]) -> Option<Corners> {
    type Row = SVector<f64, 9>;
    let h = homography(start)?;
    let nudge = 0.01;
    let mut moved = Vec::with_capacity(8);
    for k in 0..8 {
        let mut corners = *start;
        corners[k / 2][k % 2] += nudge;
        moved.push(homography(&corners)?);
    }
    let rows: Vec<(Row, f64, f64)> = edges
        .iter()
        .map(|e| {
            let at = map(&h, &e.middle);
            let mut row = Row::zeros();
            for (k, m) in moved.iter().enumerate() {
                row[k] = e.normal.dot(&(map(m, &e.middle) - at)) / nudge;
            }
            row[8] = -e.polarity;
            (row, e.normal.dot(&(e.observed - at)), e.variance)
        })
        .collect();
    let mut x = Row::zeros();
    let mut scatter2 = SCATTER_FLOOR_PX * SCATTER_FLOOR_PX;
    let mut inverse = SMatrix::<f64, 9, 9>::identity();
    for round in 0..8 {
        let (mut m, mut g) = (SMatrix::<f64, 9, 9>::zeros(), Row::zeros());
        let mut squares = Vec::with_capacity(rows.len());
        for (row, value, variance) in &rows {
            let r = value - row.dot(&x);
            let v = variance + scatter2;
            let weight = if round == 0 { 1.0 } else { 5.0 / (4.0 + r * r / v) } / v;
            m += row * row.transpose() * weight;
            g += row * (weight * r);
            squares.push((r * r, r * r - variance));
        }
        inverse = m.cholesky()?.inverse();
        x += inverse * g;
        // Median of squares of a Gaussian: 0.455 variances.
        squares.sort_by(|a, b| a.0.total_cmp(&b.0));
        let typical = squares[squares.len() / 2];
        if round > 0 {
            let excess = (typical.0 / 0.455 - (typical.0 - typical.1)).max(0.0);
            scatter2 = excess.max(SCATTER_FLOOR_PX * SCATTER_FLOOR_PX);
        }
    }
    // Student weights of 4 degrees of freedom keep 5/7 of a Gaussian's information.
    inverse *= 1.4;
    Some(Corners {
        corners: std::array::from_fn(|k| start[k] + Vector2::new(x[2 * k], x[2 * k + 1])),
        covariances: std::array::from_fn(|k| inverse.fixed_view::<2, 2>(2 * k, 2 * k).into_owned()),
    })
}
