//! Tags: detection by AprilTag, corners by lines fitted to the pixels along the four edges.

use crate::camera::{Camera, distorted_px, undistorted_px};
use crate::error::VisionError;
use crate::picture::Picture;
use crate::profile::blurred_step;
use crate::tags::apriltag_ffi::{MIN_CONTRAST, RawTag, Region, detect};
use crate::tags::edges::{FINE_PX, balance, refine_by_cells};
use crate::tags::regions::tag_regions;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use wcal_core::least_squares::{Damping, Minimum, NormalEquations, minimise};

/// A tag in one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Tag {
    /// Family.
    pub family: String,
    /// Number.
    pub id: u32,
    /// Contrast of the decision, DN.
    pub decision_margin: f64,
    /// Corners, px, in the tag's frame (x right, y down): (-,+), (+,+), (+,-), (-,-).
    pub corners_px: [Vector2<f64>; 4],
    /// Covariances of the corners, px^2.
    pub covariances_px2: [Matrix2<f64>; 4],
    /// Whether the edges could be fitted; otherwise the library's corners stand, with a wide covariance.
    pub refined: bool,
}

impl Tag {
    /// Mean of the corners, px.
    pub fn middle_px(&self) -> Vector2<f64> {
        self.corners_px.iter().sum::<Vector2<f64>>() / 4.0
    }
}

/// Cells (bits) along the side between the detected corners; the outermost ring is of one colour, its outside neighbour of the other.
fn cells_along_side(family: &str) -> f64 {
    match family {
        "tag25h9" => 7.0,
        "tag16h5" => 6.0,
        "tagStandard41h12" => 5.0,
        "tagStandard52h13" => 6.0,
        "tagCircle21h7" => 5.0,
        _ => 8.0,
    }
}

/// Where tags are searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// Where the picture shows dark pieces of strong contrast, like a tag's border: a third of the time. A tag in the shade may be missed.
    StrongContrast,
    /// All of the picture at half its size: whatever the contrast, but no small tags.
    Halved,
    /// All of the picture.
    Whole,
}

/// Detects the tags of a family, with the corners of AprilTag's quads.
///
/// # Errors
/// Where the family is unknown.
pub fn detect_tags(picture: &Picture, family: &str, search: Search) -> Result<Vec<RawTag>, VisionError> {
    let whole = Region::whole(picture);
    match search {
        Search::Halved => detect(picture, family, &[Region { decimate: 2.0, ..whole }], MIN_CONTRAST),
        Search::StrongContrast if DARK_BORDERS.contains(&family) => {
            let (regions, contrast) = tag_regions(picture);
            detect(picture, family, &regions, contrast).map(once_each)
        }
        // The other families' borders are bright.
        Search::StrongContrast | Search::Whole => detect(picture, family, &[whole], MIN_CONTRAST),
    }
}

/// Detects and refines the tags of a family. With a camera, edges are straight in the undistorted picture; without, in the picture itself.
///
/// # Errors
/// Where the family is unknown.
pub fn find_tags(
    picture: &Picture,
    family: &str,
    camera: Option<&Camera>,
    search: Search,
) -> Result<Vec<Tag>, VisionError> {
    let found = detect_tags(picture, family, search)?;
    let mut tags: Vec<Tag> = found.into_iter().map(|raw| refine(picture, raw, camera)).collect();
    tags.sort_by_key(|t| t.id);
    Ok(tags)
}

/// Families with a black border about their cells.
const DARK_BORDERS: [&str; 3] = ["tag36h11", "tag25h9", "tag16h5"];

/// Of the same tag found in two regions the more certain one stays.
fn once_each(mut tags: Vec<RawTag>) -> Vec<RawTag> {
    tags.sort_by(|a, b| b.decision_margin.total_cmp(&a.decision_margin));
    let corner = |t: &RawTag, k: usize| Vector2::from(t.corners_px[k]);
    let middle = |t: &RawTag| (0..4).map(|k| corner(t, k)).sum::<Vector2<f64>>() / 4.0;
    let mut kept: Vec<RawTag> = Vec::with_capacity(tags.len());
    for tag in tags {
        let near = 0.5 * (corner(&tag, 1) - corner(&tag, 0)).norm();
        if !kept.iter().any(|k| k.id == tag.id && (middle(k) - middle(&tag)).norm() < near) {
            kept.push(tag);
        }
    }
    kept
}

/// A fitted edge: a point, its direction and the covariance of (offset, slope) about that point.
struct Edge {
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// Parameters of the fit.
    profile: SVector<f64, 7>,
}

fn refine(picture: &Picture, raw: RawTag, camera: Option<&Camera>) -> Tag {
    let start = raw.corners_px.map(|p| undistorted_px(camera, &Vector2::new(p[0], p[1])));
    let cells = cells_along_side(&raw.family);
    // By the outline alone a tone curve's shift of all edges is the same as a larger tag; inner edges of cells that are large enough
    // distinguish the two. Small tags have their outline only.
    let by_cells = |from: &[Vector2<f64>; 4]| {
        refine_by_cells(picture, camera, from, cells as usize).map(|f| (f.corners, f.covariances))
    };
    let found = by_cells(&start).or_else(|| {
        let outline = refine_outline(picture, camera, &start, cells)?;
        by_cells(&outline.0).or(Some(outline))
    });
    let refined = found.is_some();
    // Unrefined corners of the library are good to a few tenths of a pixel.
    let (corners, covariances_px2) = found.unwrap_or((start, [Matrix2::identity() * 0.04; 4]));
    Tag {
        family: raw.family,
        id: raw.id,
        decision_margin: raw.decision_margin,
        corners_px: corners.map(|c| distorted_px(camera, &c)),
        covariances_px2,
        refined,
    }
}

type CornersWithSpread = ([Vector2<f64>; 4], [Matrix2<f64>; 4]);

/// Corners where the four fitted outer edges cross; none where an edge cannot be fitted or a corner wanders off.
fn refine_outline(
    picture: &Picture,
    camera: Option<&Camera>,
    start: &[Vector2<f64>; 4],
    cells: f64,
) -> Option<CornersWithSpread> {
    let mut corners = *start;
    let mut covariances = [Matrix2::zeros(); 4];
    let mut edges: Vec<Edge> = Vec::new();
    // Two rounds: the second fits the pixels about the lines of the first.
    for _ in 0..2 {
        edges = (0..4)
            .map(|k| {
                let ends = [&corners[k], &corners[(k + 1) % 4]];
                fit_edge(picture, camera, ends, cells, edges.get(k))
            })
            .collect::<Option<_>>()?;
        let mut next = corners;
        for k in 0..4 {
            let (p, c) = intersect(&edges[(k + 3) % 4], &edges[k])?;
            if !((p - corners[k]).norm() < 3.0) {
                return None;
            }
            (next[k], covariances[k]) = (p, c);
        }
        corners = next;
    }
    Some((corners, covariances))
}

/// Pixels beside an edge above which half of them do for that.
const SPARSE_FROM_PX2: f64 = 128.0;

/// Where two edges cross, with its covariance.
fn intersect(a: &Edge, b: &Edge) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let normal = |e: &Edge| Vector2::new(-e.direction.y, e.direction.x);
    let (na, nb) = (normal(a), normal(b));
    let m = Matrix2::new(na.x, na.y, nb.x, nb.y);
    let inverse = m.try_inverse()?;
    let p = inverse * Vector2::new(na.dot(&a.origin), nb.dot(&b.origin));
    let variance = |e: &Edge| {
        let j = Vector2::new(1.0, e.direction.dot(&(p - e.origin)));
        (j.transpose() * e.covariance * j)[0]
    };
    let c = inverse * Matrix2::from_diagonal(&Vector2::new(variance(a), variance(b))) * inverse.transpose();
    Some((p, c))
}

/// The pixels beside an edge: across and along it (over half its length), and grey value.
struct Strip {
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    normal: Vector2<f64>,
    half: f64,
    reach: f64,
    pixels: Vec<(f64, f64, f64)>,
}

/// The strip along the edge from `a` to `b`; where `thinned`, of a long edge every second pixel. None where it leaves the picture or is too
/// small.
fn strip(
    picture: &Picture,
    camera: Option<&Camera>,
    [a, b]: [&Vector2<f64>; 2],
    cells: f64,
    thinned: bool,
) -> Option<Strip> {
    let length = (b - a).norm();
    let cell = length / cells;
    // Within 0.7 of a cell nothing but the border and the margin is seen; the ends are kept clear of the other edges.
    let (reach, clear) = ((0.7 * cell).min(8.0), (0.7 * cell).max(2.0));
    if reach < 1.5 || length < 3.0 * clear {
        return None;
    }
    let direction = (b - a) / length;
    let normal = Vector2::new(-direction.y, direction.x);
    let origin = 0.5 * (a + b);
    let half = 0.5 * length;
    let (bent_a, bent_b) = (distorted_px(camera, a), distorted_px(camera, b));
    let (lo, hi) = (bent_a.inf(&bent_b), bent_a.sup(&bent_b));
    let pad = reach + 3.0;
    if !picture.contains(lo.x - pad, lo.y - pad, 0.0) || !picture.contains(hi.x + pad, hi.y + pad, 0.0) {
        return None;
    }
    // Row by row within the strip along the edge.
    let middle = 0.5 * (bent_a + bent_b);
    let sparse = thinned && 2.0 * reach * (length - 2.0 * clear) > SPARSE_FROM_PX2;
    let stride = if sparse { 2 } else { 1 };
    let mut pixels: Vec<(f64, f64, f64)> = Vec::with_capacity((2.0 * reach * length) as usize);
    for y in (lo.y - pad) as i64..=(hi.y + pad) as i64 {
        let (mut first, mut last) = ((lo.x - pad) as i64, (hi.x + pad) as i64);
        if normal.x.abs() > 1e-6 {
            let aside = normal.y * (y as f64 - middle.y);
            let ends = [-1.0, 1.0].map(|side| middle.x + (side * (reach + 2.0) - aside) / normal.x);
            first = first.max(ends[0].min(ends[1]).ceil() as i64);
            last = last.min(ends[0].max(ends[1]).floor() as i64);
        }
        for x in (first + (first + y).rem_euclid(stride)..=last).step_by(stride as usize) {
            let raw = Vector2::new(x as f64, y as f64);
            let p = undistorted_px(camera, &raw) - origin;
            let (u, t) = (normal.dot(&p), direction.dot(&p));
            if u.abs() <= reach && t.abs() <= half - clear {
                pixels.push((u, t / half, picture.at(x, y)));
            }
        }
    }
    (pixels.len() >= 24).then_some(Strip { origin, direction, normal, half, reach, pixels })
}

/// Fits `level + gradient t + (step + change t) S((u - d - e t) / s)` to the pixels beside the edge from `a` to `b`
/// (u across, t along), by Levenberg-Marquardt from an earlier edge; without one only the place to search, see [`balanced`]. None where the
/// pixels are too few or the fit fails.
fn fit_edge(
    picture: &Picture,
    camera: Option<&Camera>,
    ends: [&Vector2<f64>; 2],
    cells: f64,
    earlier: Option<&Edge>,
) -> Option<Edge> {
    // Every second pixel of a long edge is enough for the first fit.
    let Strip { origin, direction, normal, half, reach, pixels } =
        strip(picture, camera, ends, cells, earlier.is_none())?;
    let Some(earlier) = earlier else {
        return balanced(&pixels, reach, half, [&origin, &direction, &normal]);
    };
    let mut start = earlier.profile;
    // The ends already lie on the earlier line.
    (start[0], start[1]) = (0.0, 0.0);
    let linearise = |p: &SVector<f64, 7>| {
        let (mut cost, mut matrix, mut descent) =
            (0.0, SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
        let blur = p[2].exp();
        for &(u, t, value) in &pixels {
            let e = u - p[0] - p[1] * t;
            let (f, slope) = blurred_step(e, blur);
            let step = p[5] + p[6] * t;
            let r = value - (p[3] + p[4] * t + step * f);
            let a = -step * slope;
            let j = [a, a * t, a * e, 1.0, t, f, f * t];
            cost += r * r;
            // Only the lower half: this is the innermost loop of all tags.
            for k in 0..7 {
                for i in k..7 {
                    matrix[(i, k)] += j[i] * j[k];
                }
                descent[k] += j[k] * r;
            }
        }
        Some(NormalEquations { cost, matrix, descent })
    };
    let first = (start, linearise(&start)?);
    let damping = Damping { max_steps: 30, ..Damping::default() };
    let settled = |step: &SVector<f64, 7>, _: [f64; 2]| step[0].abs() + step[1].abs() < FINE_PX;
    let Minimum { place: p, at, .. } = minimise(first, &damping, linearise, |p, _, step| p + step, settled);
    if p[0].abs() > reach || !at.cost.is_finite() || p[2].exp() > 2.0 * reach {
        return None;
    }
    let inverse = at.matrix.cholesky()?.inverse() * (at.cost / (pixels.len() as f64 - 7.0));
    let scale = Matrix2::new(1.0, 0.0, 0.0, 1.0 / half);
    let covariance = scale * inverse.fixed_view::<2, 2>(0, 0) * scale;
    let turned = (direction + normal * (p[1] / half)).normalize();
    Some(Edge { origin: origin + normal * p[0], direction: turned, covariance, profile: p })
}

/// Where an edge lies, from both halves of its length: within a tenth of a pixel, in one pass over its pixels (across, along over `half`,
/// grey value).
fn balanced(
    pixels: &[(f64, f64, f64)],
    reach: f64,
    half: f64,
    [origin, direction, normal]: [&Vector2<f64>; 3],
) -> Option<Edge> {
    let one = |later: bool| {
        let own = pixels.iter().filter(|p| (p.1 > 0.0) == later);
        let along = own.clone().map(|p| p.1).sum::<f64>() / own.clone().count().max(1) as f64;
        let across: Vec<(f64, f64)> = own.map(|p| (p.0, p.2)).collect();
        Some((along, balance(&across, reach)?))
    };
    let ((t0, first), (t1, second)) = (one(false)?, one(true)?);
    let slope = (second.offset_px - first.offset_px) / (t1 - t0);
    let offset = first.offset_px - slope * t0;
    let mean = |a: f64, b: f64| 0.5 * (a + b);
    let (level, step) = (mean(first.level, second.level), mean(first.step, second.step));
    Some(Edge {
        origin: origin + normal * offset,
        direction: (direction + normal * (slope / half)).normalize(),
        covariance: Matrix2::from_diagonal_element(0.01),
        profile: SVector::<f64, 7>::from([0.0, 0.0, 0.9f64.ln(), level, 0.0, step, 0.0]),
    })
}

/// Corners of a tag of side `size` in its own frame (x right, y down, z into the tag), in the order of [`Tag::corners_px`].
pub fn tag_corners(size: f64) -> [nalgebra::Vector3<f64>; 4] {
    let h = 0.5 * size;
    [(-h, h), (h, h), (h, -h), (-h, -h)].map(|(x, y)| nalgebra::Vector3::new(x, y, 0.0))
}
