//! The wire's centre in a picture: short pieces of the wire, each fitted by a blurred bar between
//! two backgrounds that need not be equal, with light that may change across the bar. That is
//! Steger's bias for unequal sides, solved rather than corrected.
//!
//! ```text
//! evidence = n / 2 ln((RSS_edge + n s0^2) / (RSS_bar + n s0^2)) - 2 / 2 ln n          log likelihood ratio less BIC of two parameters
//! sd^2 = RSS_bar / (n - 5) / |P dI/d(centre)|^2                                       P: projection off the levels
//! ```
//!
//! n: pixels, s0: floor of their noise. Source: G. Schwarz, "Estimating the Dimension of a Model",
//! Annals of Statistics 6 (1978) 461 (BIC).

use crate::picture::Picture;
use crate::wire::bar::{Bar, MIN_NOISE, Pixel, coarse_centre, near_px, without_wire};
use nalgebra::Vector2;

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
    pub fn normal(&self) -> Vector2<f64> {
        Vector2::new(-self.tangent.y, self.tangent.x)
    }
}

/// Appearance of the wire, shared by all pieces of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    /// Blur, sd of the Gaussian, px.
    pub blur_px: f64,
    /// Width over the expected width.
    pub width_scale: f64,
}

/// A measured piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Predicted place.
    pub station: Station,
    /// Offset of the centre along the normal, px.
    pub offset_px: f64,
    /// Standard deviation of the offset from the pixels' scatter, px.
    pub sd_px: f64,
    /// Background minus wire on the two sides, DN.
    pub depth: [f64; 2],
    /// log likelihood ratio of the bar against the best edge or flat patch, less what its extra
    /// parameters are worth (BIC).
    pub evidence: f64,
}

impl Piece {
    /// Measured centre, px.
    pub fn position_px(&self) -> Vector2<f64> {
        self.station.position_px + self.station.normal() * self.offset_px
    }

    /// Whether it shows a wire of this polarity: a bar is likelier than an edge, and both sides
    /// differ from it alike.
    pub fn shows(&self, polarity: f64) -> bool {
        self.evidence > 0.0 && self.depth.iter().all(|depth| polarity * depth > 0.0)
    }
}

/// Pixels of a piece, row by row where the strip about the line crosses the row.
pub(crate) fn gather(picture: &Picture, at: &Station, reach: f64) -> Vec<Pixel> {
    let (normal, tangent) = (at.normal(), at.tangent);
    let half = 0.5 * PIECE_PX;
    // The line bends away from its tangent by the sagitta.
    let sag = 0.5 * at.bend_per_px.abs() * half * half;
    let span = (reach + sag).hypot(half);
    let p = at.position_px;
    let mut pixels = Vec::with_capacity((2.0 * (reach + 1.0) * (PIECE_PX + 1.0)) as usize);
    for y in (p.y - span).ceil() as i64..=(p.y + span).floor() as i64 {
        let dy = y as f64 - p.y;
        let (mut from, mut to) = (-span, span);
        for (slope, start, limit) in [
            (tangent.x, tangent.y * dy, half),
            (normal.x, normal.y * dy, reach + sag),
        ] {
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

/// Fits one piece. `search_px`: how far from the predicted line the centre may lie.
pub fn fit_piece(
    picture: &Picture,
    at: &Station,
    appearance: Appearance,
    search_px: f64,
) -> Option<Piece> {
    let width = at.width_px * appearance.width_scale;
    let bar = Bar::new(width, appearance.blur_px);
    let near = near_px(width, appearance.blur_px);
    let reach = near + search_px;
    if !picture.contains(at.position_px.x, at.position_px.y, reach + 1.0) {
        return None;
    }
    let mut pixels = gather(picture, at, reach);
    if pixels.len() < 16 {
        return None;
    }
    let (coarse, levels) = coarse_centre(&pixels, width, reach, search_px)?;
    // Fine: a window about the coarse centre, which excludes neighbouring objects.
    pixels.retain(|p| (p.0 - coarse).abs() <= near);
    let n = pixels.len();
    let fit = bar.settle(&pixels, coarse, levels, 12, true)?;
    if fit.centre.abs() > search_px + 1.0 {
        return None;
    }
    let other = without_wire(&pixels, &bar);
    // Two parameters more than an edge (its place, two levels): bar has centre and four levels.
    // A perfect fit of few pixels would else have infinite evidence.
    let floor = n as f64 * MIN_NOISE * MIN_NOISE;
    let evidence = 0.5 * n as f64 * ((other + floor) / (fit.cost + floor)).ln() - (n as f64).ln();
    Some(Piece {
        station: *at,
        offset_px: fit.centre,
        // The bar has five parameters: its centre and four levels.
        sd_px: (fit.cost / (n as f64 - 5.0).max(1.0) / fit.projected).sqrt(),
        depth: [fit.level[0] - fit.level[2], fit.level[1] - fit.level[2]],
        evidence,
    })
}
