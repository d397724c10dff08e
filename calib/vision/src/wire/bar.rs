//! A blurred bar between two backgrounds, fitted to the pixels of a piece of wire: its centre, with
//! the levels eliminated.
//!
//! ```text
//! I(u) = L (1 - a) + R b + B (a - b) + G (a - b) e / h,   e = u - centre,  h = half width
//! a = S(e + h),  b = S(e - h),   S(x) = (1 + erf(x / (s sqrt 2))) / 2,   s = blur
//! ```
//! L, R, B: grey values of both backgrounds and of the bar; G: light across the bar, held near 0 by
//! a ridge. Variable projection: the levels are linear, so that Gauss-Newton moves the centre
//! alone, with the slope's part in the levels projected out. Source: Golub and Pereyra, "The
//! Differentiation of Pseudo-Inverses and Nonlinear Least Squares Problems Whose Variables
//! Separate", 1973.

use crate::profile::erf_with_slope;
use nalgebra::{SMatrix, SVector};

/// A pixel of a piece: its place across the line and its grey value.
pub(crate) type Pixel = (f64, f64);
/// Grey values of left background, right background and bar, and the light across the bar, DN.
pub(crate) type Levels = SVector<f64, 4>;
type Square = SMatrix<f64, 4, 4>;

/// A blurred bar of known width.
pub(crate) struct Bar {
    /// Half width, px.
    half: f64,
    /// 1 / (blur sqrt 2), 1/px.
    inverse: f64,
}

/// Light across the bar over its depth, sd: without this prior it would be confounded with a shift
/// of narrow wires.
const TILT_SHARE: f64 = 0.03;
/// Floor of the noise of a pixel, DN: quantisation and errors of the model.
pub(crate) const MIN_NOISE: f64 = 0.5;
/// Residual from errors of blur and width, as a share of the depth: it must not favour a shifted
/// bar with tilted light.
const MODEL_SHARE: f64 = 0.03;
/// Weight of the light across the bar while neither noise nor depth is known, and while blur and
/// width are not: nearly none is let in, so that a symmetric line has one best centre.
pub(crate) const FIRST_RIDGE: f64 = 4.0;
/// Step of the centre at convergence, px: far below the noise of any pixel.
const SMALL_STEP_PX: f64 = 1e-3;

/// Weight of the light across the bar, noise^2 / (its prior sd)^2.
fn ridge(cost: f64, pixels: usize, level: &Levels) -> f64 {
    let depth = (0.5 * (level[0] + level[1]) - level[2])
        .abs()
        .max(2.0 * MIN_NOISE);
    let noise2 = (cost / (pixels as f64 - 5.0).max(1.0)).max((MODEL_SHARE * depth).powi(2));
    noise2 / (TILT_SHARE * depth).powi(2)
}

/// Distance from the centre within which pixels count, px: the bar, its blur and a little of the
/// background.
pub(crate) fn near_px(width_px: f64, blur_px: f64) -> f64 {
    0.5 * width_px + 3.0 * blur_px + 2.0
}

impl Bar {
    pub(crate) fn new(width_px: f64, blur_px: f64) -> Self {
        Self {
            half: 0.5 * width_px,
            inverse: std::f64::consts::FRAC_1_SQRT_2 / blur_px,
        }
    }

    /// Step from 0 to 1 at 0 and its derivative.
    fn step(&self, x: f64) -> (f64, f64) {
        let (f, slope) = erf_with_slope(x * self.inverse);
        (0.5 + 0.5 * f, 0.5 * slope * self.inverse)
    }

    /// Shares of left background, right background, bar, and light across the bar, with their
    /// derivatives by the centre.
    #[inline]
    fn shares(&self, e: f64) -> [Levels; 2] {
        let [shares, by_centre, ..] = self.shares_with_slopes(e);
        [shares, by_centre]
    }

    /// Shares with their derivatives by the centre, by the logarithm of the blur and by that of the
    /// width.
    #[inline]
    pub(crate) fn shares_with_slopes(&self, e: f64) -> [Levels; 4] {
        let h = self.half;
        let ((a, da), (b, db)) = (self.step(e + h), self.step(e - h));
        let (bar, tilt) = (a - b, e / h);
        // e = u - centre: a derivative by the centre is minus that by e.
        let by_centre = Levels::new(da, -db, db - da, (db - da) * tilt - bar / h);
        // d S(x / s) / d ln s = -x dS/dx, and d S(e + h) / d ln h = h dS/dx.
        let (a_blur, b_blur) = (-(e + h) * da, -(e - h) * db);
        let by_blur = Levels::new(-a_blur, b_blur, a_blur - b_blur, (a_blur - b_blur) * tilt);
        let (a_width, b_width) = (h * da, -h * db);
        let wider = a_width - b_width;
        let by_width = Levels::new(-a_width, b_width, wider, (wider - bar) * tilt);
        [
            Levels::new(1.0 - a, b, bar, bar * tilt),
            by_centre,
            by_blur,
            by_width,
        ]
    }

    /// Best centre near `start`: Gauss-Newton with the levels eliminated, their part of the slope
    /// projected out. The slope is taken at the levels of the step before, first at `level`.
    /// `tilted`: light may change across the bar.
    pub(crate) fn settle(
        &self,
        pixels: &[Pixel],
        start: f64,
        mut level: Levels,
        rounds: usize,
        tilted: bool,
    ) -> Option<Settled> {
        let mut centre = start;
        let mut settled = None;
        let mut last_step = f64::INFINITY;
        let mut weight = FIRST_RIDGE;
        let yy: f64 = pixels.iter().map(|p| p.1 * p.1).sum();
        for round in 0..=rounds {
            // The levels' normal matrix, its product with the slope, and the slope's own.
            let (mut m, mut cross, mut v) = (Square::zeros(), Levels::zeros(), Levels::zeros());
            let (mut own, mut pull) = (0.0, 0.0);
            for &(u, value) in pixels {
                let [f, d] = self.shares(u - centre);
                let slope = d.dot(&level);
                m += f * f.transpose();
                v += f * value;
                cross += f * slope;
                own += slope * slope;
                pull += slope * value;
            }
            let full = m;
            m[(3, 3)] += weight;
            let inverse = m.cholesky()?;
            level = inverse.solve(&v);
            // Schur complement: what the levels can imitate of a shift tells nothing of the centre.
            let projected = own - cross.dot(&inverse.solve(&cross));
            if !(projected > 0.0) {
                return None;
            }
            let cost = (yy - 2.0 * v.dot(&level) + level.dot(&(full * level))).max(0.0);
            if tilted {
                weight = ridge(cost, pixels.len(), &level).min(FIRST_RIDGE);
            }
            settled = Some(Settled {
                centre,
                cost,
                level,
                projected,
            });
            // The last step was small: levels and cost are those of the end.
            if round == rounds || last_step < SMALL_STEP_PX {
                break;
            }
            // The levels are at their best here, so that only the centre's own slope counts.
            let gradient = pull - level.dot(&cross);
            last_step = (gradient / projected).clamp(-0.5, 0.5);
            centre += last_step;
            last_step = last_step.abs();
        }
        settled
    }
}

/// A bar settled on its pixels.
pub(crate) struct Settled {
    pub centre: f64,
    /// Sum of squares, DN^2.
    pub cost: f64,
    pub level: Levels,
    /// Information on the centre, levels eliminated, DN^2 / px^2.
    pub projected: f64,
}

/// Side of the cells in which pixels are summed across the line, px.
const CELL_PX: f64 = 0.25;
/// Cells between two centres tried.
const STRIDE: usize = 2;

/// Pixels summed in cells across the line, from `-reach` up: counts and sums of all cells before
/// each one.
struct Sums {
    counts: Vec<f64>,
    values: Vec<f64>,
}

impl Sums {
    fn new(pixels: &[Pixel], reach: f64) -> Self {
        let cells = (2.0 * reach / CELL_PX).ceil() as usize + 1;
        let (mut counts, mut values) = (vec![0.0; cells + 1], vec![0.0; cells + 1]);
        for &(u, value) in pixels {
            let k = (((u + reach) / CELL_PX) as usize).min(cells - 1);
            counts[k + 1] += 1.0;
            values[k + 1] += value;
        }
        for k in 0..cells {
            counts[k + 1] += counts[k];
            values[k + 1] += values[k];
        }
        Self { counts, values }
    }

    /// Number and mean of the pixels from one cell up to another.
    fn mean(&self, from: usize, to: usize) -> (f64, f64) {
        let n = self.counts[to] - self.counts[from];
        (n, (self.values[to] - self.values[from]) / n)
    }
}

/// Where a sharp bar of this width between two plain backgrounds fits best, every half pixel within
/// `search_px`, and its levels; only bars that are darker than both sides, or brighter, count.
pub(crate) fn coarse_centre(
    pixels: &[Pixel],
    width_px: f64,
    reach: f64,
    search_px: f64,
) -> Option<(f64, Levels)> {
    let sums = Sums::new(pixels, reach);
    let last = sums.counts.len() - 1;
    let half = ((0.5 * width_px / CELL_PX).round() as usize).max(2);
    let middle = (reach / CELL_PX).round() as usize;
    let steps = (search_px / (STRIDE as f64 * CELL_PX)).ceil() as usize;
    let mut best = None;
    let mut largest = f64::NEG_INFINITY;
    for k in 0..=2 * steps {
        let at = (middle + STRIDE * k).checked_sub(STRIDE * steps)?;
        let (from, to) = (at.checked_sub(half)?, at + half);
        if to >= last {
            break;
        }
        let [(n0, l), (n1, b), (n2, r)] =
            [sums.mean(0, from), sums.mean(from, to), sums.mean(to, last)];
        // Empty parts have no mean: comparisons with it fail.
        // With each part at its mean, sum I^2 less sum n mean^2 is left.
        let explained = n0 * l * l + n1 * b * b + n2 * r * r;
        if (l - b) * (r - b) > 0.0 && explained > largest {
            largest = explained;
            best = Some((at as f64 * CELL_PX - reach, Levels::new(l, r, b, 0.0)));
        }
    }
    best
}

/// Least sum of squares of a patch that holds one edge anywhere, or a slope, but no wire.
pub(crate) fn without_wire(pixels: &[Pixel], bar: &Bar) -> f64 {
    let (n, y0, yy) = pixels.iter().fold((0.0f64, 0.0, 0.0), |(n, y0, yy), p| {
        (n + 1.0, y0 + p.1, yy + p.1 * p.1)
    });
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
    // The best place of a sharp edge, then by halves for the blurred one: an edge between two
    // places must not pass for a wire.
    let sums = Sums::new(pixels, reach);
    let last = sums.counts.len() - 1;
    let explained = |k: usize| {
        let [(n0, l), (n1, r)] = [sums.mean(0, k), sums.mean(k, last)];
        n0 * l * l + n1 * r * r
    };
    let sharp = (1..last)
        .map(|k| (explained(k), k))
        .fold((f64::NEG_INFINITY, 1), |best, next| {
            if next.0 > best.0 { next } else { best }
        });
    let edge = |place: f64| two(&|u| bar.step(u - place).0);
    let mut place = sharp.1 as f64 * CELL_PX - reach;
    let mut smallest = edge(place);
    let mut step = 0.5;
    while step > 0.05 {
        step *= 0.5;
        for at in [place - step, place + step] {
            let there = edge(at);
            if there < smallest {
                (place, smallest) = (at, there);
            }
        }
    }
    smallest.min(two(&|u| u))
}
