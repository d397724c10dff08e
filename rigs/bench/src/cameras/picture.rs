//! From a view to grey values.

use nalgebra::Vector2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::faces::SeenFace;
use super::lens::Lens;
use super::scene::View;

/// How a camera and its light make a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    /// Grey value of a reflectance of 1 in the middle of the picture; past 255 the picture
    /// saturates.
    pub exposure_dn: f64,
    /// Reflectance of the background.
    pub background: f64,
    /// Reflectance of the wire, and of a highlight along it off the middle.
    pub wire: f64,
    /// Height of the highlight.
    pub highlight: f64,
    /// Relative fall of the light from one side of the picture to the other, and toward the
    /// corners.
    pub uneven: [f64; 2],
    /// Blur of the lens (Gaussian), px.
    pub blur_px: f64,
    /// Read noise, grey values.
    pub read_noise_dn: f64,
    /// Variance of the shot noise per grey value.
    pub shot_noise_dn: f64,
}

impl Default for Appearance {
    fn default() -> Self {
        Self {
            exposure_dn: 235.0,
            background: 0.72,
            wire: 0.33,
            highlight: 0.06,
            uneven: [0.12, 0.10],
            blur_px: 0.6,
            read_noise_dn: 0.8,
            shot_noise_dn: 0.006,
        }
    }
}

/// Fibonacci lattice of a pixel: 34 points whose coordinates are all different (Niederreiter 1992,
/// section 5.1).
const SAMPLES: usize = 34;
const LATTICE_STEP: usize = 21;

/// A straight piece of the wire's image.
#[derive(Debug, Clone, Copy)]
struct ImageSegment {
    from: Vector2<f64>,
    to: Vector2<f64>,
    half_px: f64,
    depth_mm: f64,
    /// The wire's first or last piece, cut square.
    ends: [bool; 2],
}

/// Picture before noise, grey values row by row, not limited to 255.
pub fn clean(lens: &Lens, view: &View, look: &Appearance) -> Vec<f32> {
    let [width, height] = lens.size_px;
    let faces: Vec<SeenFace<'_>> = view
        .faces
        .iter()
        .map(|f| f.view(&lens.camera_from_base))
        .collect();
    let boxes: Vec<[usize; 4]> = view
        .faces
        .iter()
        .map(|f| bounds(lens, &f.base_from_plane, &f.corners))
        .collect();
    // Nearest surface at every pixel corner: depth and shade.
    let row_length = width + 1;
    let mut corners = vec![(f32::INFINITY, look.background as f32); row_length * (height + 1)];
    for (face, [left, top, right, bottom]) in faces.iter().zip(&boxes) {
        for row in *top..=*bottom {
            for column in *left..=*right {
                if let Some((depth, shade)) = face.hit(&lens.corner(row, column)) {
                    let kept = &mut corners[row * row_length + column];
                    if (depth as f32) < kept.0 {
                        *kept = (depth as f32, shade as f32);
                    }
                }
            }
        }
    }
    let pieces = wire_pieces(lens, view);
    let near = nearest_pieces(lens, &pieces);
    let mut light = vec![0.0_f32; width * height];
    for row in 0..height {
        let across = light_across(lens, look, row);
        for column in 0..width {
            let at = row * row_length + column;
            let around = [
                corners[at],
                corners[at + 1],
                corners[at + row_length],
                corners[at + row_length + 1],
            ];
            // One shade at all four corners: no edge is taken to cross the pixel.
            let flat = around.iter().all(|c| (c.1 - around[0].1).abs() < 1e-4);
            let piece = near[row * width + column] as usize;
            let mean = if piece == 0 {
                if flat {
                    f64::from(around[0].1)
                } else {
                    sampled(lens, look, &faces, &boxes, &[], row, column)
                }
            } else {
                // With its neighbours: at a joint the pixel sees two pieces.
                let pieces = &pieces[piece.saturating_sub(2)..(piece + 1).min(pieces.len())];
                let own = pieces.iter().find(|p| p.ends[0] || p.ends[1]);
                // In front of all surfaces nothing hides the wire.
                let before = around
                    .iter()
                    .all(|c| f64::from(c.0) > pieces[0].depth_mm + 0.5);
                if flat && before && own.is_none() {
                    strip(pieces, look, f64::from(around[0].1), row, column)
                } else {
                    sampled(lens, look, &faces, &boxes, pieces, row, column)
                }
            };
            light[row * width + column] = (mean * across.at(column)) as f32;
        }
    }
    blurred(&light, width, height, look.blur_px)
}

/// Noise and 8 bits.
pub fn exposed(clean: &[f32], look: &Appearance, seed: u64) -> Vec<u8> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let read = (look.read_noise_dn * look.read_noise_dn) as f32;
    let shot = look.shot_noise_dn as f32;
    clean
        .iter()
        .map(|v| {
            let z: f32 = StandardNormal.sample(&mut rng);
            (v + z * (read + shot * v.max(0.0)).sqrt())
                .round()
                .clamp(0.0, 255.0) as u8
        })
        .collect()
}

/// Pixel corners that a polygon may touch: left, top, right, bottom, both ends taken; an edge bends
/// by less than 8 px.
fn bounds(
    lens: &Lens,
    base_from_plane: &nalgebra::Isometry3<f64>,
    corners: &[[f64; 2]],
) -> [usize; 4] {
    let (mut low, mut high) = (
        Vector2::repeat(f64::INFINITY),
        Vector2::repeat(f64::NEG_INFINITY),
    );
    for [a, b] in corners {
        let p = base_from_plane * nalgebra::Point3::new(*a, *b, 0.0);
        if let Some((at, _)) = lens.project(&p.coords) {
            (low, high) = (low.inf(&at), high.sup(&at));
        }
    }
    let limit = |v: f64, k: usize| v.clamp(0.0, lens.size_px[k] as f64) as usize;
    let pad = 2.0 + 0.01 * lens.size_px[0] as f64;
    [
        limit(low.x - pad, 0),
        limit(low.y - pad, 1),
        limit(high.x + pad, 0),
        limit(high.y + pad, 1),
    ]
}

/// A point of the image, px, and its depth, mm; none behind the camera.
type ImagePoint = Option<(Vector2<f64>, f64)>;

/// Image of the wire, piece by piece.
fn wire_pieces(lens: &Lens, view: &View) -> Vec<ImageSegment> {
    let focal = 0.5 * (lens.focal_px[0] + lens.focal_px[1]);
    let seen: Vec<_> = view.wire.iter().map(|p| lens.project(p)).collect();
    let count = seen.len().saturating_sub(1);
    let piece = |(k, w): (usize, &[ImagePoint])| {
        let ((from, z0), (to, z1)) = (w[0]?, w[1]?);
        let depth_mm = 0.5 * (z0 + z1);
        // Pinhole: a length d at depth z spans f d / z pixels.
        let half_px = 0.5 * view.diameter_mm * focal / depth_mm;
        Some(ImageSegment {
            from,
            to,
            half_px,
            depth_mm,
            ends: [k == 0, k + 1 == count],
        })
    };
    seen.windows(2).enumerate().filter_map(piece).collect()
}

/// For every pixel near the wire the nearest piece, counted from 1; 0: none.
fn nearest_pieces(lens: &Lens, pieces: &[ImageSegment]) -> Vec<u16> {
    let [width, height] = lens.size_px;
    let mut near = vec![0_u16; width * height];
    let mut distance = std::collections::HashMap::new();
    for (k, piece) in pieces.iter().enumerate().take(usize::from(u16::MAX) - 1) {
        // More than half a pixel's diagonal: no pixel that the wire touches is missed.
        let reach = piece.half_px + 1.0;
        let (low, high) = (piece.from.inf(&piece.to), piece.from.sup(&piece.to));
        let range = |k: usize, n: usize| {
            let from = (low[k] - reach).floor().max(0.0) as usize;
            from..(((high[k] + reach).ceil() + 1.0).max(0.0) as usize).min(n)
        };
        for row in range(1, height) {
            for column in range(0, width) {
                let p = Vector2::new(column as f64, row as f64);
                let (off, _) = piece.off(&p);
                let kept = distance
                    .entry(row * width + column)
                    .or_insert(f64::INFINITY);
                if off.norm() < *kept && off.norm() <= reach {
                    *kept = off.norm();
                    near[row * width + column] = k as u16 + 1;
                }
            }
        }
    }
    near
}

impl ImageSegment {
    /// From the piece's nearest point to `p`, and where along the piece that lies (0..1 inside).
    fn off(&self, p: &Vector2<f64>) -> (Vector2<f64>, f64) {
        let run = self.to - self.from;
        let along = (p - self.from).dot(&run) / run.norm_squared();
        (p - self.from - run * along.clamp(0.0, 1.0), along)
    }

    /// Signed distance across the piece in half widths.
    fn across(&self, p: &Vector2<f64>) -> f64 {
        let run = (self.to - self.from).normalize();
        run.perp(&(p - self.from)) / self.half_px
    }
}

/// Bands across the wire, each of one shade.
const BANDS: usize = 6;

/// Shade of the wire at `u` half widths from its middle.
fn wire_shade(look: &Appearance, u: f64) -> f64 {
    look.wire * (1.0 + 0.1 * u) + look.highlight * (-((u + 0.3) / 0.35).powi(2)).exp()
}

/// Exact mean of a pixel that the wire crosses as a straight strip over a ground of one shade.
fn strip(
    pieces: &[ImageSegment],
    look: &Appearance,
    ground: f64,
    row: usize,
    column: usize,
) -> f64 {
    let p = Vector2::new(column as f64, row as f64);
    let nearest = pieces
        .iter()
        .min_by(|a, b| a.off(&p).0.norm().total_cmp(&b.off(&p).0.norm()));
    let Some(piece) = nearest else { return ground };
    let run = (piece.to - piece.from).normalize();
    let distance = piece.across(&p) * piece.half_px;
    // Share of the pixel on the strip's near side of a line at `edge` from the middle.
    let below = |edge: f64| half_plane(edge - distance, run.y.abs(), run.x.abs());
    let mut mean = ground;
    for k in 0..BANDS {
        let u = |k: usize| 2.0 * k as f64 / BANDS as f64 - 1.0;
        let share = below(u(k + 1) * piece.half_px) - below(u(k) * piece.half_px);
        mean += share * (wire_shade(look, 0.5 * (u(k) + u(k + 1))) - ground);
    }
    mean
}

/// Share of a unit pixel within the half plane `n . p < s`, p from its centre, |n| = (a, b): the
/// pixel projected on n is the convolution of two boxes of widths a and b.
fn half_plane(s: f64, a: f64, b: f64) -> f64 {
    let (wide, narrow) = (a.max(b), a.min(b));
    let (outer, inner) = (0.5 * (wide + narrow), 0.5 * (wide - narrow));
    if s.abs() >= outer {
        return if s > 0.0 { 1.0 } else { 0.0 };
    }
    let side = if s.abs() <= inner {
        s.abs() / wide
    } else {
        0.5 - (outer - s.abs()).powi(2) / (2.0 * wide * narrow)
    };
    0.5 + side.copysign(s)
}

/// Mean of a pixel over the lattice, for edges, ends and hidden wire.
fn sampled(
    lens: &Lens,
    look: &Appearance,
    faces: &[SeenFace<'_>],
    boxes: &[[usize; 4]],
    pieces: &[ImageSegment],
    row: usize,
    column: usize,
) -> f64 {
    let touched =
        |b: &[usize; 4]| b[0] <= column + 1 && column <= b[2] && b[1] <= row + 1 && row <= b[3];
    let here: Vec<&SeenFace<'_>> = faces
        .iter()
        .zip(boxes)
        .filter(|(_, b)| touched(b))
        .map(|(f, _)| f)
        .collect();
    let mut sum = 0.0;
    for k in 0..SAMPLES {
        let right = (k as f64 + 0.5) / SAMPLES as f64;
        let down = ((k * LATTICE_STEP % SAMPLES) as f64 + 0.5) / SAMPLES as f64;
        let ray = lens.inside(row, column, right, down);
        let (mut depth, mut shade) = (f64::INFINITY, look.background);
        for (z, s) in here.iter().filter_map(|f| f.hit(&ray)) {
            if z < depth {
                (depth, shade) = (z, s);
            }
        }
        let p = Vector2::new(column as f64 + right - 0.5, row as f64 + down - 0.5);
        // The wire is cut square at root and tip: nothing of it lies past them.
        let over = pieces
            .iter()
            .map(|piece| (piece.off(&p), piece))
            .min_by(|a, b| a.0.0.norm().total_cmp(&b.0.0.norm()))
            // Beyond an end that is cut square nothing is, however near the pieces before it are.
            .filter(|((_, along), q)| !(*along < 0.0 && q.ends[0] || *along > 1.0 && q.ends[1]));
        if let Some(((off, _), piece)) = over
            && off.norm() < piece.half_px
            && piece.depth_mm < depth
        {
            shade = wire_shade(look, piece.across(&p).clamp(-1.0, 1.0));
        }
        sum += shade;
    }
    sum / SAMPLES as f64
}

/// Light along one row.
struct RowLight {
    scale: f64,
    slope: f64,
    fall: f64,
    middle: f64,
    down2: f64,
}

impl RowLight {
    fn at(&self, column: usize) -> f64 {
        let x = (column as f64 - self.middle) / self.middle;
        self.scale * (1.0 + self.slope * x) * (1.0 - self.fall * (x * x + self.down2))
    }
}

fn light_across(lens: &Lens, look: &Appearance, row: usize) -> RowLight {
    let middle = 0.5 * lens.size_px[0] as f64;
    let down = (row as f64 - 0.5 * lens.size_px[1] as f64) / middle;
    let (slope, fall) = (0.5 * look.uneven[0], 0.5 * look.uneven[1]);
    RowLight {
        scale: look.exposure_dn * (1.0 - 0.5 * slope * down),
        slope,
        fall,
        middle,
        down2: down * down,
    }
}

/// Gaussian blur, rows then columns; the border repeats.
fn blurred(light: &[f32], width: usize, height: usize, sd_px: f64) -> Vec<f32> {
    if sd_px <= 0.0 {
        return light.to_vec();
    }
    // Past 3.5 standard deviations less than a thousandth of the weight is left.
    let reach = (3.5 * sd_px).ceil() as usize;
    let weight = |k: usize| (-0.5 * ((k as f64 - reach as f64) / sd_px).powi(2)).exp();
    let total: f64 = (0..=2 * reach).map(weight).sum();
    let kernel: Vec<f32> = (0..=2 * reach)
        .map(|k| (weight(k) / total) as f32)
        .collect();
    let mut rows = vec![0.0_f32; light.len()];
    let mut padded = vec![0.0_f32; width + 2 * reach];
    for (from, to) in light.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        padded[..reach].fill(from[0]);
        padded[reach..reach + width].copy_from_slice(from);
        padded[reach + width..].fill(from[width - 1]);
        for (k, w) in kernel.iter().enumerate() {
            for (t, f) in to.iter_mut().zip(&padded[k..]) {
                *t += w * f;
            }
        }
    }
    let mut out = vec![0.0_f32; light.len()];
    for (y, to) in out.chunks_exact_mut(width).enumerate() {
        for (k, w) in kernel.iter().enumerate() {
            let from = (y + k).saturating_sub(reach).min(height - 1);
            for (t, f) in to.iter_mut().zip(&rows[from * width..(from + 1) * width]) {
                *t += w * f;
            }
        }
    }
    out
}
