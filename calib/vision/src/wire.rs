//! The wire's centre in a picture: short pieces of the wire, each fitted by a blurred bar between two backgrounds that need not be
//! equal, with light that may change across the bar. That is Steger's bias for unequal sides, solved rather than corrected.

use crate::picture::Picture;
use crate::profile::erf_with_slope;
use nalgebra::{SMatrix, SVector, Vector2};

/// Length of a piece, px.
pub const PIECE_PX: f64 = 4.0;

/// A place on the predicted line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// Arc length, mm.
    pub arc_mm: f64,
    /// Position, px.
    pub position_px: Vector2<f64>,
    /// Unit tangent in the picture.
    pub tangent: Vector2<f64>,
    /// Curvature of the line in the picture, 1/px, positive toward the normal (-ty, tx).
    pub bend_per_px: f64,
    /// Expected width of the wire, px.
    pub width_px: f64,
}

impl Station {
    /// Unit normal.
    #[must_use]
    pub fn normal(&self) -> Vector2<f64> {
        Vector2::new(-self.tangent.y, self.tangent.x)
    }
}

/// How the wire looks: shared by all pieces of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Blur, sd of the Gaussian, px.
    pub blur_px: f64,
    /// Width over the expected width.
    pub width_scale: f64,
}

/// A measured piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Where it was looked for.
    pub station: Station,
    /// Offset of the centre along the normal, px.
    pub offset_px: f64,
    /// Standard deviation of the offset from the pixels' scatter, px.
    pub sd_px: f64,
    /// Background minus wire on the two sides, DN.
    pub depth: [f64; 2],
    /// log likelihood ratio of the bar against the best edge or flat patch, less what its extra parameters are worth (BIC).
    pub evidence: f64,
    /// Sum of squared residuals, DN^2, and pixels.
    pub residual: (f64, usize),
}

/// A pixel of a piece: its place across the line and its grey value.
pub(crate) type Pixel = (f64, f64);

/// Pixels of a piece, row by row where the strip about the line crosses the row.
pub(crate) fn gather(picture: &Picture, at: &Station, reach: f64) -> Vec<Pixel> {
    let (normal, tangent) = (at.normal(), at.tangent);
    let half = 0.5 * PIECE_PX;
    let sag = 0.5 * at.bend_per_px.abs() * half * half;
    let span = (reach + sag).hypot(half);
    let p = at.position_px;
    let mut pixels = Vec::with_capacity((2.0 * (reach + 1.0) * (PIECE_PX + 1.0)) as usize);
    for y in (p.y - span).ceil() as i64..=(p.y + span).floor() as i64 {
        let dy = y as f64 - p.y;
        let (mut from, mut to) = (-span, span);
        for (slope, start, limit) in
            [(tangent.x, tangent.y * dy, half), (normal.x, normal.y * dy, reach + sag)]
        {
            if slope.abs() > 1e-6 {
                let ends = [(-limit - start) / slope, (limit - start) / slope];
                from = from.max(ends[0].min(ends[1]));
                to = to.min(ends[0].max(ends[1]));
            }
        }
        for x in (p.x + from).ceil() as i64..=(p.x + to).floor() as i64 {
            let d = Vector2::new(x as f64 - p.x, dy);
            let t = tangent.dot(&d);
            let u = normal.dot(&d) - 0.5 * at.bend_per_px * t * t;
            if t.abs() <= half && u.abs() <= reach {
                pixels.push((u, picture.at(x, y)));
            }
        }
    }
    pixels
}

pub(crate) type Levels = SVector<f64, 4>;
type Square = SMatrix<f64, 4, 4>;

/// A blurred bar of known width.
#[derive(Clone, Copy)]
pub(crate) struct Bar {
    /// Half width, px.
    half: f64,
    /// 1 / (blur sqrt 2), 1/px.
    inverse: f64,
}

/// Light across the bar over its depth, sd: free, it would be traded for a shift of narrow wires.
const TILT_SHARE: f64 = 0.03;
/// Noise below which pixels are not believed, DN: quantisation and what the model lacks.
const LEAST_NOISE: f64 = 0.5;
/// What blur and width that are not quite right leave, as a share of the depth: a shifted bar with tilted light must not pay for it.
const MODEL_SHARE: f64 = 0.03;
/// Weight of the light across the bar while neither noise nor depth is known, and while blur and width are not: nearly none is let
/// in, so that a symmetric line has one best centre.
pub(crate) const FIRST_RIDGE: f64 = 4.0;

/// Weight of the light across the bar, noise^2 / (its prior sd)^2.
fn ridge(cost: f64, pixels: usize, level: &Levels) -> f64 {
    let depth = (0.5 * (level[0] + level[1]) - level[2]).abs().max(2.0 * LEAST_NOISE);
    let noise2 = (cost / (pixels as f64 - 5.0).max(1.0)).max((MODEL_SHARE * depth).powi(2));
    noise2 / (TILT_SHARE * depth).powi(2)
}

impl Bar {
    pub(crate) fn new(width_px: f64, blur_px: f64) -> Self {
        Self { half: 0.5 * width_px, inverse: std::f64::consts::FRAC_1_SQRT_2 / blur_px }
    }

    /// Step from 0 to 1 at 0 and its derivative.
    fn step(&self, x: f64) -> (f64, f64) {
        let (f, slope) = erf_with_slope(x * self.inverse);
        (0.5 + 0.5 * f, 0.5 * slope * self.inverse)
    }

    /// Shares of left background, right background, bar, and light across the bar.
    fn shares(&self, e: f64) -> Levels {
        let (a, b) = (self.step(e + self.half).0, self.step(e - self.half).0);
        Levels::new(1.0 - a, b, a - b, (a - b) * e / self.half)
    }

    /// Shares with their derivatives by the centre, by the logarithm of the blur and by that of the width.
    pub(crate) fn shares_with_slopes(&self, e: f64) -> [Levels; 4] {
        let h = self.half;
        let ((a, da), (b, db)) = (self.step(e + h), self.step(e - h));
        let (bar, tilt) = (a - b, e / h);
        let by_centre = Levels::new(da, -db, db - da, (db - da) * tilt - bar / h);
        let (a_blur, b_blur) = (-(e + h) * da, -(e - h) * db);
        let by_blur = Levels::new(-a_blur, b_blur, a_blur - b_blur, (a_blur - b_blur) * tilt);
        let (a_width, b_width) = (h * da, -h * db);
        let wider = a_width - b_width;
        let by_width = Levels::new(-a_width, b_width, wider, (wider - bar) * tilt);
        [Levels::new(1.0 - a, b, bar, bar * tilt), by_centre, by_blur, by_width]
    }

    /// Best levels for a given centre: (sum of squares, levels).
    fn levels(&self, pixels: &[Pixel], centre: f64) -> Option<(f64, Levels)> {
        let (mut m, mut v, mut yy) = (Square::zeros(), Levels::zeros(), 0.0);
        for &(u, value) in pixels {
            let f = self.shares(u - centre);
            m += f * f.transpose();
            v += f * value;
            yy += value * value;
        }
        m[(3, 3)] += FIRST_RIDGE;
        let levels = m.cholesky()?.solve(&v);
        Some(((yy - v.dot(&levels)).max(0.0), levels))
    }

    /// Best centre near `start`: Gauss-Newton with the levels eliminated, their part of the slope projected out.
    /// `tilted`: light may change across the bar.
    pub(crate) fn settle(
        &self,
        pixels: &[Pixel],
        start: f64,
        rounds: usize,
        tilted: bool,
    ) -> Option<Settled> {
        let mut centre = start;
        let mut settled = None;
        let mut last_step = f64::INFINITY;
        let mut weight = FIRST_RIDGE;
        for round in 0..=rounds {
            let (mut ff, mut fd, mut dd) = (Square::zeros(), Square::zeros(), Square::zeros());
            let (mut v, mut w, mut yy) = (Levels::zeros(), Levels::zeros(), 0.0);
            for &(u, value) in pixels {
                let [f, d, _, _] = self.shares_with_slopes(u - centre);
                ff += f * f.transpose();
                fd += f * d.transpose();
                dd += d * d.transpose();
                v += f * value;
                w += d * value;
                yy += value * value;
            }
            let mut m = ff;
            m[(3, 3)] += weight;
            let inverse = m.cholesky()?;
            let level = inverse.solve(&v);
            let cross = fd * level;
            let projected = level.dot(&(dd * level)) - cross.dot(&inverse.solve(&cross));
            if !(projected > 0.0) {
                return None;
            }
            let cost = (yy - 2.0 * v.dot(&level) + level.dot(&(ff * level))).max(0.0);
            if tilted {
                weight = ridge(cost, pixels.len(), &level).min(FIRST_RIDGE);
            }
            settled = Some(Settled { centre, cost, level, projected });
            // The last step was small: levels and cost are those of the end.
            if round == rounds || last_step < 1e-4 {
                break;
            }
            // The levels are at their best here, so that only the centre's own slope counts.
            let gradient = level.dot(&w) - level.dot(&cross);
            last_step = (gradient / projected).clamp(-0.5, 0.5);
            centre += last_step;
            last_step = last_step.abs();
        }
        settled
    }
}

/// A bar settled on its pixels.
#[derive(Clone, Copy)]
pub(crate) struct Settled {
    pub(crate) centre: f64,
    /// Sum of squares, DN^2.
    pub(crate) cost: f64,
    pub(crate) level: Levels,
    /// Information on the centre, levels eliminated, DN^2 / px^2.
    pub(crate) projected: f64,
}

/// Distance from the centre within which pixels count, px: the bar, its blur and a little of the background.
pub(crate) fn near_px(width_px: f64, blur_px: f64) -> f64 {
    0.5 * width_px + 3.0 * blur_px + 2.0
}

/// Fits one piece. `search_px`: how far from the predicted line the centre may lie.
#[must_use]
pub fn fit_piece(picture: &Picture, at: &Station, look: Look, search_px: f64) -> Option<Piece> {
    let width = at.width_px * look.width_scale;
    let bar = Bar::new(width, look.blur_px);
    let near = near_px(width, look.blur_px);
    let reach = near + search_px;
    if !picture.contains(at.position_px.x, at.position_px.y, reach + 1.0) {
        return None;
    }
    let wide = gather(picture, at, reach);
    if wide.len() < 16 {
        return None;
    }
    // Coarse: every half pixel; only bars of one sign on both sides count.
    let steps = (2.0 * search_px).ceil() as i64;
    let mut coarse = None;
    let mut least = f64::INFINITY;
    for k in -steps..=steps {
        let c = 0.5 * k as f64;
        if let Some((cost, l)) = bar.levels(&wide, c)
            && (l[0] - l[2]) * (l[1] - l[2]) > 0.0
            && cost < least
        {
            least = cost;
            coarse = Some(c);
        }
    }
    let coarse = coarse?;
    // Fine: a window about the coarse centre, so that what lies beyond the wire's own surroundings does not count.
    let pixels: Vec<Pixel> = wide.into_iter().filter(|p| (p.0 - coarse).abs() <= near).collect();
    let n = pixels.len();
    let fit = bar.settle(&pixels, coarse, 12, true)?;
    if fit.centre.abs() > search_px + 1.0 {
        return None;
    }
    let other = without_wire(&pixels, &bar);
    // Two parameters more than an edge (its place, two levels): bar has centre and four levels.
    let floor = n as f64 * LEAST_NOISE * LEAST_NOISE;
    let evidence = 0.5 * n as f64 * ((other + floor) / (fit.cost + floor)).ln() - (n as f64).ln();
    Some(Piece {
        station: *at,
        offset_px: fit.centre,
        sd_px: (fit.cost / (n as f64 - 5.0).max(1.0) / fit.projected).sqrt(),
        depth: [fit.level[0] - fit.level[2], fit.level[1] - fit.level[2]],
        evidence,
        residual: (fit.cost, n),
    })
}

/// Least sum of squares of a patch that holds one edge anywhere, or a slope, but no wire.
fn without_wire(pixels: &[Pixel], bar: &Bar) -> f64 {
    let (n, y0, yy) =
        pixels.iter().fold((0.0f64, 0.0, 0.0), |(n, y0, yy), p| (n + 1.0, y0 + p.1, yy + p.1 * p.1));
    let two = |f: &dyn Fn(f64) -> f64| {
        let (mut s1, mut s2, mut y1) = (0.0, 0.0, 0.0);
        for &(u, value) in pixels {
            let x = f(u);
            s1 += x;
            s2 += x * x;
            y1 += value * x;
        }
        let d: f64 = n * s2 - s1 * s1;
        if d <= 1e-9 * n * n {
            return yy - y0 * y0 / n;
        }
        let (b, a) = ((n * y1 - s1 * y0) / d, (s2 * y0 - s1 * y1) / d);
        yy - a * y0 - b * y1
    };
    let reach = pixels.iter().fold(0.0f64, |m, p| m.max(p.0.abs()));
    let edge = |place: f64| two(&|u| bar.step(u - place).0);
    // The best of a coarse grid, then by halves: an edge between two of its places must not pass for a wire.
    let mut step = reach / 8.0;
    let (mut place, mut least) = (-8..=8)
        .map(|k| f64::from(k) * step)
        .map(|at| (at, edge(at)))
        .fold((0.0, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best });
    while step > 0.05 {
        step *= 0.5;
        for at in [place - step, place + step] {
            let there = edge(at);
            if there < least {
                (place, least) = (at, there);
            }
        }
    }
    least.min(two(&|u| u))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::blurred_step;

    /// A bar of 3.6 px across unequal backgrounds, drawn by its own formula (simulated).
    fn drawn(centre: f64, right: f64, width: f64) -> Picture {
        let data = (0..60usize)
            .flat_map(|_| {
                (0..60usize).map(move |x| {
                    let (a, _) = blurred_step(x as f64 - centre + 0.5 * width, 0.9);
                    let (b, _) = blurred_step(x as f64 - centre - 0.5 * width, 0.9);
                    (180.0 * (1.0 - a) + right * b + 80.0 * (a - b)).round() as u8
                })
            })
            .collect();
        Picture::new(60, 60, data).unwrap()
    }

    fn station() -> Station {
        Station {
            arc_mm: 0.0,
            position_px: Vector2::new(30.0, 30.0),
            tangent: Vector2::new(0.0, 1.0),
            bend_per_px: 0.0,
            width_px: 3.6,
        }
    }

    #[test]
    fn unequal_sides_do_not_move_the_centre() {
        let look = Look { blur_px: 0.9, width_scale: 1.0 };
        for right in [180.0, 120.0] {
            let piece = fit_piece(&drawn(30.37, right, 3.6), &station(), look, 2.0).unwrap();
            // The normal of a downward tangent points to -x.
            assert!((30.0 - piece.offset_px - 30.37).abs() < 0.01, "{right}: {}", piece.offset_px);
            assert!(piece.evidence > 0.0);
        }
    }

    #[test]
    fn an_edge_is_no_wire() {
        let look = Look { blur_px: 0.9, width_scale: 1.0 };
        let edge = drawn(30.0, 80.0, 3.6);
        assert!(
            fit_piece(&edge, &station(), look, 2.0)
                .is_none_or(|p| p.evidence < 0.0 || p.depth[1].abs() < 3.0)
        );
    }
}
