//! The wire's centre in a picture: short pieces of the wire, each fitted by a blurred bar between two backgrounds that need not be
//! equal, with light that may change across the bar. That is Steger's bias for unequal sides, solved rather than corrected.

use crate::picture::Picture;
use crate::profile::blurred_step;
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

/// Pixels of a piece: across, along, grey value.
fn gather(picture: &Picture, at: &Station, reach: f64) -> Vec<(f64, f64, f64)> {
    let normal = at.normal();
    let span = (reach * reach + PIECE_PX * PIECE_PX * 0.25).sqrt() + 1.0;
    let mut pixels = Vec::with_capacity(96);
    let p = at.position_px;
    for y in (p.y - span).ceil() as i64..=(p.y + span).floor() as i64 {
        for x in (p.x - span).ceil() as i64..=(p.x + span).floor() as i64 {
            let d = Vector2::new(x as f64, y as f64) - p;
            let t = at.tangent.dot(&d);
            let u = normal.dot(&d) - 0.5 * at.bend_per_px * t * t;
            if t.abs() <= 0.5 * PIECE_PX && u.abs() <= reach {
                pixels.push((u, t, picture.at(x, y)));
            }
        }
    }
    pixels
}

type Levels = SVector<f64, 4>;

/// Shares of left background, right background, bar, and light across the bar; with their derivatives by the centre.
fn shares(u: f64, centre: f64, width: f64, blur: f64) -> (Levels, Levels) {
    let h = 0.5 * width;
    let e = u - centre;
    let (a, da) = blurred_step(e + h, blur);
    let (b, db) = blurred_step(e - h, blur);
    let bar = a - b;
    let tilt = e / h;
    (Levels::new(1.0 - a, b, bar, bar * tilt), Levels::new(da, -db, db - da, (db - da) * tilt - bar / h))
}

/// Best levels for a given centre: (sum of squares, levels).
fn levels(pixels: &[(f64, f64, f64)], centre: f64, width: f64, blur: f64) -> Option<(f64, Levels)> {
    let (mut m, mut v, mut yy) = (SMatrix::<f64, 4, 4>::zeros(), Levels::zeros(), 0.0);
    for &(u, _, value) in pixels {
        let (f, _) = shares(u, centre, width, blur);
        m += f * f.transpose();
        v += f * value;
        yy += value * value;
    }
    // The light across the bar is only as free as the bar is wide: a mild ridge keeps narrow wires from trading it for a shift.
    m[(3, 3)] += 1e-2 * pixels.len() as f64 * (blur / width).powi(2);
    let levels = m.cholesky()?.solve(&v);
    Some(((yy - v.dot(&levels)).max(0.0), levels))
}

/// Fits one piece. `search_px`: how far from the predicted line the centre may lie.
#[must_use]
pub fn fit_piece(picture: &Picture, at: &Station, look: Look, search_px: f64) -> Option<Piece> {
    let width = at.width_px * look.width_scale;
    let reach = 0.5 * width + 3.0 * look.blur_px + 2.0 + search_px;
    if !picture.contains(at.position_px.x, at.position_px.y, reach + 1.0) {
        return None;
    }
    let wide = gather(picture, at, reach);
    if wide.len() < 16 {
        return None;
    }
    // Coarse: every half pixel; only bars of one sign on both sides count.
    let steps = (2.0 * search_px).ceil() as i64;
    let mut centre = None;
    let mut least = f64::INFINITY;
    for k in -steps..=steps {
        let c = 0.5 * k as f64;
        if let Some((cost, l)) = levels(&wide, c, width, look.blur_px)
            && (l[0] - l[2]) * (l[1] - l[2]) > 0.0
            && cost < least
        {
            least = cost;
            centre = Some(c);
        }
    }
    let mut centre = centre?;
    // Fine: a window about the coarse centre, so that what lies beyond the wire's own surroundings does not count.
    let near = 0.5 * width + 3.0 * look.blur_px + 2.0;
    let pixels: Vec<_> = wide.iter().copied().filter(|p| (p.0 - centre).abs() <= near).collect();
    let n = pixels.len();
    let mut variance_of_centre = f64::INFINITY;
    let (mut cost, mut level) = levels(&pixels, centre, width, look.blur_px)?;
    for _ in 0..12 {
        // Gauss-Newton on the centre with the levels eliminated: their part of the slope is projected out.
        let (mut m, mut c, mut s, mut g, mut gl) =
            (SMatrix::<f64, 4, 4>::zeros(), Levels::zeros(), 0.0, 0.0, Levels::zeros());
        for &(u, _, value) in &pixels {
            let (f, d) = shares(u, centre, width, look.blur_px);
            let slope = d.dot(&level);
            let r = value - f.dot(&level);
            m += f * f.transpose();
            c += f * slope;
            s += slope * slope;
            g += slope * r;
            gl += f * r;
        }
        m[(3, 3)] += 1e-2 * n as f64 * (look.blur_px / width).powi(2);
        let inverse = m.cholesky()?;
        let projected = s - c.dot(&inverse.solve(&c));
        if projected <= 0.0 {
            return None;
        }
        let step = (g - c.dot(&inverse.solve(&gl))) / projected;
        centre += step.clamp(-0.5, 0.5);
        (cost, level) = levels(&pixels, centre, width, look.blur_px)?;
        variance_of_centre = cost / (n as f64 - 5.0).max(1.0) / projected;
        if step.abs() < 1e-4 {
            break;
        }
    }
    if centre.abs() > search_px + 1.0 {
        return None;
    }
    let other = without_wire(&pixels, look.blur_px);
    let depth = [level[0] - level[2], level[1] - level[2]];
    // Two parameters more than an edge (its place, two levels): bar has centre and four levels.
    let evidence = 0.5 * n as f64 * (other / cost.max(1e-9)).ln() - (n as f64).ln();
    Some(Piece {
        station: *at,
        offset_px: centre,
        sd_px: variance_of_centre.sqrt(),
        depth,
        evidence,
        residual: (cost, n),
    })
}

/// Least sum of squares of a patch that holds one edge anywhere, or a slope, but no wire.
fn without_wire(pixels: &[(f64, f64, f64)], blur: f64) -> f64 {
    let two = |f: &dyn Fn(f64) -> f64| {
        let (mut s0, mut s1, mut s2, mut y0, mut y1, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for &(u, _, value) in pixels {
            let x = f(u);
            s0 += 1.0;
            s1 += x;
            s2 += x * x;
            y0 += value;
            y1 += value * x;
            yy += value * value;
        }
        let d: f64 = s0 * s2 - s1 * s1;
        if d <= 1e-9 * s0 * s0 {
            return yy - y0 * y0 / s0;
        }
        let (b, a) = ((s0 * y1 - s1 * y0) / d, (s2 * y0 - s1 * y1) / d);
        yy - a * y0 - b * y1
    };
    let reach = pixels.iter().fold(0.0f64, |m, p| m.max(p.0.abs()));
    (-8..=8)
        .map(|k| two(&|u| blurred_step(u - reach * f64::from(k) / 8.0, blur).0))
        .chain(std::iter::once(two(&|u| u)))
        .fold(f64::INFINITY, f64::min)
}

/// Blur and width of the wire from the pieces that show it best: least pooled squares by golden section, in turn.
#[must_use]
pub fn fit_look(picture: &Picture, pieces: &[Piece], start: Look) -> Look {
    let mut best: Vec<&Piece> = pieces.iter().filter(|p| p.evidence > 0.0).collect();
    best.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    best.truncate(32);
    if best.len() < 8 {
        return start;
    }
    // Centres move along: held where a wrong width put them, they would confirm that width. The worst quarter does not count.
    let misfit = |look: Look| {
        let mut costs: Vec<f64> = best
            .iter()
            .filter_map(|p| fit_piece(picture, &p.station, look, p.offset_px.abs() + 0.5))
            .map(|q| q.residual.0 / q.residual.1 as f64)
            .collect();
        costs.sort_by(f64::total_cmp);
        let keep = (costs.len() * 3 / 4).max(1).min(costs.len());
        costs[..keep].iter().sum::<f64>() / keep as f64
    };
    let mut look = start;
    for _ in 0..2 {
        look.blur_px = golden(0.35, 3.0, |b| misfit(Look { blur_px: b, ..look }));
        look.width_scale = golden(0.6, 1.5, |w| misfit(Look { width_scale: w, ..look }));
    }
    look
}

fn golden(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
    let ratio = 0.618_033_988_749_895;
    let (mut a, mut b) = (from.ln(), to.ln());
    let (mut x, mut y) = (b - ratio * (b - a), a + ratio * (b - a));
    let (mut fx, mut fy) = (f(x.exp()), f(y.exp()));
    for _ in 0..9 {
        if fx < fy {
            (b, y, fy) = (y, x, fx);
            x = b - ratio * (b - a);
            fx = f(x.exp());
        } else {
            (a, x, fx) = (x, y, fy);
            y = a + ratio * (b - a);
            fy = f(y.exp());
        }
    }
    (0.5 * (a + b)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

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
