//! Corners of a tag from every edge between a dark and a bright cell, not from its outline alone:
//! ink, a camera's tone curve and half-saturated paper move all edges toward one colour by the same
//! amount. Inner edges have both polarities, so that this spread is solved for together with the
//! corners instead of biasing the tag's size.
//!
//! ```text
//! n_i . (observed_i - H(c) m_i) = polarity_i s + noise      unknowns: four corners c (homography H), spread s of the dark cells
//! ```
//! with an edge's middle m_i in the tag's square and its normal n_i in undistorted pixels; weighted
//! least squares. Where cells are too small to be measured one by one, pieces of the four sides
//! take their place; these have one polarity, so that s is held at 0. Source: Zhang, "A Flexible
//! New Technique for Camera Calibration", IEEE PAMI 22(11), 2000, appendix A (homography).

use crate::camera::{Camera, distorted_px, undistorted_px};
use crate::homography::{homography, mapped};
use crate::picture::Picture;
use crate::profile::blurred_step;
use crate::tags::tag_corners;
use nalgebra::{Matrix2, Matrix3, Matrix4, SMatrix, SVector, Vector2, Vector4};
use wcal_core::least_squares::{Damping, Ending, NormalEquations, minimise};

/// Movement at which a fit ends, px.
const FINE_PX: f64 = 0.01;
/// Cells smaller than this do not resolve the grey levels on both sides of an edge, px.
const MIN_CELL_PX: f64 = 5.0;
/// Edges needed: 9 unknowns, and enough beyond them to judge the scatter.
const MIN_EDGES: usize = 32;
/// Share of a cell's side that an edge is fitted over; the rest is kept clear of the crossing
/// edges.
const ALONG: f64 = 0.66;
/// Pieces of a side of the outline, and how many of all four sides are needed.
const PIECES: usize = 4;
const MIN_PIECES: usize = 12;
/// Share of a cell beside the outline that shows nothing but the border and the margin.
const BESIDE: f64 = 0.7;
/// Least width of that on either side, px.
const MIN_BESIDE_PX: f64 = 1.5;
/// Floor of an edge's standard deviation, px: the raster of the print, which the pixels' noise does
/// not include.
const SCATTER_FLOOR_PX: f64 = 0.005;

/// Refined corners.
pub(crate) struct Corners {
    /// Straightened px, in the order of the tag's corners.
    pub corners: [Vector2<f64>; 4],
    /// Covariances, px^2.
    pub covariances: [Matrix2<f64>; 4],
}

/// An edge between two cells: middle and half length in the tag's frame (-1..1), measured offset
/// across it.
struct CellEdge {
    middle: Vector2<f64>,
    normal: Vector2<f64>,
    observed: Vector2<f64>,
    /// +1 where the normal points from dark to bright.
    polarity: f64,
    variance: f64,
}

/// Which edges of a tag are measured.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Edges {
    /// Those between all cells.
    Cells,
    /// The outline's.
    Outline,
}

/// Corners by a tag's edges, starting from `start` (straightened px). None where the tag is too
/// small or mostly hidden.
pub(crate) fn refine_by_edges(
    picture: &Picture,
    camera: Option<&Camera>,
    start: &[Vector2<f64>; 4],
    cells: usize,
    kind: Edges,
) -> Option<Corners> {
    let mut found = Corners {
        corners: *start,
        covariances: [Matrix2::zeros(); 4],
    };
    // The first round balances bright against dark only; the second fits the profile to the pixels
    // about its edges.
    for method in [balance as Method, fit] {
        let view = TagView {
            picture,
            camera,
            h: square(&found.corners)?,
            cells,
            method,
        };
        let cell_px = shortest_side(&found.corners) / cells as f64;
        let edges = match kind {
            Edges::Cells => view.cell_edges(cell_px)?,
            Edges::Outline => view.outline_pieces(cell_px)?,
        };
        found = solve(&found.corners, &edges, kind)?;
    }
    let near = |k: usize| (found.corners[k] - start[k]).norm() < 3.0;
    (0..4).all(near).then_some(found)
}

fn shortest_side(corners: &[Vector2<f64>; 4]) -> f64 {
    (0..4)
        .map(|k| (corners[(k + 1) % 4] - corners[k]).norm())
        .fold(f64::INFINITY, f64::min)
}

/// The corners of the tag's square (-1..1).
fn unit() -> [Vector2<f64>; 4] {
    tag_corners(2.0).map(|p| p.xy())
}

/// The map from the tag's square (-1..1) to straightened pixels.
fn square(corners: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    homography(&unit(), corners)
}

/// A tag of so many cells a side in a picture, and how its edges are measured.
struct TagView<'a> {
    picture: &'a Picture,
    camera: Option<&'a Camera>,
    h: Matrix3<f64>,
    cells: usize,
    method: Method,
}

impl TagView<'_> {
    /// Pieces of the four sides, clear of the corners.
    fn outline_pieces(&self, cell_px: f64) -> Option<Vec<CellEdge>> {
        let reach = (BESIDE * cell_px).min(6.0);
        // In the tag's square, where a side is 2 long.
        let clear = 2.0 * reach.max(2.0) / (cell_px * self.cells as f64);
        if reach < MIN_BESIDE_PX || clear > 0.5 {
            return None;
        }
        let half = (1.0 - clear) / PIECES as f64;
        let corners = unit();
        let pieces = (0..4 * PIECES).filter_map(|k| {
            let (a, b) = (corners[k / PIECES], corners[(k / PIECES + 1) % 4]);
            let along = 0.5 * (b - a);
            let middle =
                0.5 * (a + b) + along * (clear - 1.0 + half * (2 * (k % PIECES) + 1) as f64);
            self.measure([&middle, &(along * half)], reach)
        });
        Some(pieces.collect()).filter(|pieces: &Vec<_>| pieces.len() >= MIN_PIECES)
    }

    /// Edges between cells of different colour.
    fn cell_edges(&self, cell_px: f64) -> Option<Vec<CellEdge>> {
        if cell_px < MIN_CELL_PX {
            return None;
        }
        let cells = self.cells;
        let side = 2.0 / cells as f64;
        let place = |k: f64| k * side - 1.0;
        // Grey values of the cells, one ring outside included.
        let count = cells + 2;
        let grey: Vec<f64> = (0..count * count)
            .map(|k| {
                let (i, j) = ((k % count) as f64 - 0.5, (k / count) as f64 - 0.5);
                let p = distorted_px(
                    self.camera,
                    &mapped(&self.h, &Vector2::new(place(i), place(j)))?,
                );
                Some(self.picture.sample(p.x, p.y))
            })
            .collect::<Option<_>>()?;
        // More than a tenth of a tag's cells and margin are of either colour.
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
                    let turned = |x, y| if upright { [x, y] } else { [y, x] };
                    let colour = |k| {
                        let [i, j] = if upright { [k, across] } else { [across, k] };
                        colour(i, j)
                    };
                    if let (Some(one), Some(two)) = (colour(k), colour(k + 1))
                        && one != two
                    {
                        let middle = turned(place(k as f64), place(across as f64 - 0.5)).into();
                        let half = turned(0.0, 0.5 * ALONG * side).into();
                        // Half of the next cell at most, and no more than a wide blur needs.
                        edges.extend(self.measure([&middle, &half], (0.5 * cell_px).min(6.0)));
                    }
                }
            }
        }
        (edges.len() >= MIN_EDGES).then_some(edges)
    }

    /// Measures an edge by the pixels that lie beside it as far as `reach`, px.
    fn measure(&self, [middle, half]: [&Vector2<f64>; 2], reach: f64) -> Option<CellEdge> {
        let straight = [
            mapped(&self.h, &(middle - half))?,
            mapped(&self.h, &(middle + half))?,
        ];
        let [a, b] = straight.map(|p| distorted_px(self.camera, &p));
        let (origin, length) = (0.5 * (a + b), (b - a).norm());
        let along = (b - a) / length;
        let normal = Vector2::new(-along.y, along.x);
        let span = reach.hypot(0.5 * length) + 1.0;
        if !self.picture.contains(origin.x, origin.y, span) {
            return None;
        }
        let mut pixels: Vec<(f64, f64)> = Vec::with_capacity(128);
        for y in (origin.y - span) as i64..=(origin.y + span) as i64 {
            for x in (origin.x - span) as i64..=(origin.x + span) as i64 {
                let d = Vector2::new(x as f64, y as f64) - origin;
                if along.dot(&d).abs() <= 0.5 * length && normal.dot(&d).abs() <= reach {
                    pixels.push((normal.dot(&d), self.picture.at(x, y)));
                }
            }
        }
        if pixels.len() < 12 {
            return None;
        }
        let profile = (self.method)(&pixels, reach)?;
        let observed = undistorted_px(self.camera, &(origin + normal * profile.offset_px));
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
}

/// An edge across its pixels: where it lies and the variance of that, px and px^2, and its step,
/// DN.
struct Profile {
    offset_px: f64,
    variance_px2: f64,
    step: f64,
}

/// Measures an edge from (place across it in px, grey value) of its pixels, which extend this far
/// to both sides.
type Method = fn(&[(f64, f64)], f64) -> Option<Profile>;

/// Levels far from the edge on its two sides.
fn levels(pixels: &[(f64, f64)], from_px: f64) -> [f64; 2] {
    [-1.0, 1.0].map(|sign| {
        let (n, sum) = pixels
            .iter()
            .filter(|p| sign * p.0 > from_px)
            .fold((0.0, 0.0), |(n, s), p| (n + 1.0, s + p.1));
        sum / f64::max(n, 1.0)
    })
}

/// Where an edge lies whose mean grey value is what the pixels have: within a tenth of a pixel, in
/// one pass.
fn balance(pixels: &[(f64, f64)], reach: f64) -> Option<Profile> {
    let [low, high] = levels(pixels, 0.5 * reach);
    let step = high - low;
    // The sum over the pixels of what each lacks to an edge at 0, over the pixels that a shift by 1
    // px changes.
    let lack: f64 = pixels
        .iter()
        .map(|p| if p.0 > 0.0 { high - p.1 } else { low - p.1 })
        .sum();
    // A step of height h moved by d adds h d to the sum of each column of pixels.
    let offset_px = lack / step * 2.0 * reach / pixels.len() as f64;
    (offset_px.abs() < 0.5 * reach).then_some(Profile {
        offset_px,
        // A tenth of a pixel, squared.
        variance_px2: 0.01,
        step,
    })
}

/// Fits `level + step S((u - d) / s)`.
fn fit(pixels: &[(f64, f64)], reach: f64) -> Option<Profile> {
    let linearise = |p: &Vector4<f64>| {
        let (mut cost, mut m, mut g) = (0.0, Matrix4::zeros(), Vector4::zeros());
        // The blur as a logarithm: it stays positive.
        let blur = p[1].exp();
        for &(u, value) in pixels {
            let e = u - p[0];
            let (f, slope) = blurred_step(e, blur);
            let r = value - p[2] - p[3] * f;
            // By the centre S changes by -S', by ln s by -e S'.
            let j = Vector4::new(-p[3] * slope, -p[3] * slope * e, 1.0, f);
            cost += r * r;
            m += j * j.transpose();
            g += j * r;
        }
        Some(NormalEquations {
            cost,
            matrix: m,
            descent: g,
        })
    };
    let [low, high] = levels(pixels, 0.0);
    let start = Vector4::new(0.0, 0.9f64.ln(), low, high - low);
    let damping = Damping {
        max: 1e6,
        max_steps: 20,
        ..Damping::default()
    };
    let settled = |step: &Vector4<f64>, _: [f64; 2]| step[0].abs() < FINE_PX;
    let first = (start, linearise(&start)?);
    let found = minimise(first, &damping, linearise, |p, _, step| p + step, settled);
    if found.ending == Ending::Singular {
        return None;
    }
    let (p, cost) = (found.place, found.at.cost);
    if p[0].abs() > 0.5 * reach || p[1].exp() > reach || !cost.is_finite() {
        return None;
    }
    let variance_px2 = found.at.matrix.try_inverse()?[(0, 0)] * cost / (pixels.len() as f64 - 4.0);
    Some(Profile {
        offset_px: p[0],
        variance_px2,
        step: p[3],
    })
}

/// Corners and spread from the edges: Gauss-Newton with Student weights whose scale is the edges'
/// own scatter.
fn solve(start: &[Vector2<f64>; 4], edges: &[CellEdge], kind: Edges) -> Option<Corners> {
    type Row = SVector<f64, 9>;
    let h = square(start)?;
    let nudge = 0.01;
    let moved: Vec<_> = (0..8)
        .map(|k| {
            let mut corners = *start;
            corners[k / 2][k % 2] += nudge;
            square(&corners)
        })
        .collect::<Option<_>>()?;
    let row = |e: &CellEdge| {
        let at = mapped(&h, &e.middle)?;
        let mut row = Row::zeros();
        for (k, m) in moved.iter().enumerate() {
            row[k] = e.normal.dot(&(mapped(m, &e.middle)? - at)) / nudge;
        }
        row[8] = -e.polarity;
        Some((row, e.normal.dot(&(e.observed - at)), e.variance))
    };
    let rows: Vec<(Row, f64, f64)> = edges.iter().map(row).collect::<Option<_>>()?;
    // Information on the spread: an outline alone cannot tell it from a larger tag.
    let held = if kind == Edges::Outline { 1e12 } else { 0.0 };
    let mut x = Row::zeros();
    let mut scatter2 = SCATTER_FLOOR_PX * SCATTER_FLOOR_PX;
    let mut inverse = SMatrix::<f64, 9, 9>::identity();
    for round in 0..8 {
        let (mut m, mut g) = (SMatrix::<f64, 9, 9>::zeros(), Row::zeros());
        let mut squares = Vec::with_capacity(rows.len());
        for (row, value, variance) in &rows {
            let r = value - row.dot(&x);
            let v = variance + scatter2;
            let student = if round == 0 {
                1.0
            } else {
                5.0 / (4.0 + r * r / v)
            };
            let weight = student / v;
            m += row * row.transpose() * weight;
            g += row * (weight * r);
            squares.push((r * r, r * r - variance));
        }
        // A prior of no spread where the edges have one polarity.
        m[(8, 8)] += held;
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
