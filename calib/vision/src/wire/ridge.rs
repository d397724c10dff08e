//! Line evidence: second derivatives of the picture at the wire's scale, and what the response is
//! worth as a likelihood ratio of wire against everything else that this very picture shows.
//!
//! ```text
//! response = n^T (Hessian of g_s * I) n,   g_s: Gaussian of sd s,  n: the line's normal
//! score = ln (N(response / reference; 1, 0.35) / share of the background's responses in that bin),  at least HIDDEN
//! ```
//! Source: Steger, "An Unbiased Detector of Curvilinear Structures", IEEE PAMI 20(2), 1998.

use crate::picture::Picture;
use nalgebra::Vector2;
use std::cell::OnceCell;

/// Side of a tile, px.
const TILE: usize = 64;
/// One tile in this many samples the background.
const SAMPLED: usize = 9;
/// Values a row of a tile: one more than its side, so that interpolation stays within it.
const ROW: usize = TILE + 1;
/// Second derivatives of a smoothed picture, computed tile by tile on demand: a search along a wire
/// visits a small part of the picture.
pub struct RidgeMap<'a> {
    picture: &'a Picture,
    /// Gaussian, its first and its second derivative.
    kernels: [Vec<f32>; 3],
    columns: usize,
    /// xx, xy, yy a pixel.
    tiles: Vec<OnceCell<Vec<[f32; 3]>>>,
}

/// Adds a row convolved with a kernel.
fn convolve(source: &[f32], kernel: &[f32], target: &mut [f32]) {
    target.fill(0.0);
    let length = target.len();
    for (k, &weight) in kernel.iter().enumerate() {
        for (t, &s) in target.iter_mut().zip(&source[k..k + length]) {
            *t += weight * s;
        }
    }
}

impl<'a> RidgeMap<'a> {
    /// The map at a scale (sd of the Gaussian, px).
    pub fn new(picture: &'a Picture, scale_px: f64) -> Self {
        // Beyond 3.5 sd lie 5e-4 of a Gaussian.
        let reach = (3.5 * scale_px).ceil() as i64;
        let kernel = |order: u8| -> Vec<f32> {
            (-reach..=reach)
                .map(|k| {
                    let x = k as f64 / scale_px;
                    let g = (-0.5 * x * x).exp() / (scale_px * (2.0 * std::f64::consts::PI).sqrt());
                    (match order {
                        0 => g,
                        // Correlated, not convolved: the odd kernel has the other sign.
                        1 => x / scale_px * g,
                        _ => (x * x - 1.0) / (scale_px * scale_px) * g,
                    }) as f32
                })
                .collect()
        };
        let columns = picture.width.div_ceil(TILE);
        let tiles = vec![OnceCell::new(); columns * picture.height.div_ceil(TILE)];
        Self {
            picture,
            kernels: [kernel(0), kernel(1), kernel(2)],
            columns,
            tiles,
        }
    }

    fn tile(&self, index: usize) -> &[[f32; 3]] {
        self.tiles[index].get_or_init(|| self.compute(index))
    }

    /// Rows first, then columns; the picture's border is continued outwards.
    fn compute(&self, index: usize) -> Vec<[f32; 3]> {
        let (x0, y0) = (
            (index % self.columns * TILE) as i64,
            (index / self.columns * TILE) as i64,
        );
        let reach = self.kernels[0].len() / 2;
        let side = ROW + 2 * reach;
        let mut source = vec![0.0f32; side];
        // Every row of the source by the three kernels.
        let mut rows = vec![0.0f32; 3 * side * ROW];
        for (j, row) in rows.chunks_exact_mut(3 * ROW).enumerate() {
            let y =
                (y0 + j as i64 - reach as i64).clamp(0, self.picture.height as i64 - 1) as usize;
            let line = &self.picture.data[y * self.picture.width..(y + 1) * self.picture.width];
            for (i, s) in source.iter_mut().enumerate() {
                let x = (x0 + i as i64 - reach as i64).clamp(0, line.len() as i64 - 1) as usize;
                *s = f32::from(line[x]);
            }
            for (kernel, target) in self.kernels.iter().zip(row.chunks_exact_mut(ROW)) {
                convolve(&source, kernel, target);
            }
        }
        let mut out = vec![[0.0f32; 3]; ROW * ROW];
        for (j, target) in out.chunks_exact_mut(ROW).enumerate() {
            let mut sums = [[0.0f32; ROW]; 3];
            for k in 0..=2 * reach {
                let row = &rows[(j + k) * 3 * ROW..(j + k + 1) * 3 * ROW];
                // xx: second derivative along the row, smoothed across; xy: first of both; yy: the
                // other way round.
                for (which, sum) in sums.iter_mut().enumerate() {
                    let (weight, from) = (self.kernels[which][k], (2 - which) * ROW);
                    for (s, v) in sum.iter_mut().zip(&row[from..from + ROW]) {
                        *s += weight * v;
                    }
                }
            }
            for (i, t) in target.iter_mut().enumerate() {
                *t = [sums[0][i], sums[1][i], sums[2][i]];
            }
        }
        out
    }

    /// Second derivative across a line with this unit normal; positive on dark lines. None outside
    /// the picture.
    pub fn across(&self, p: &Vector2<f64>, normal: &Vector2<f64>) -> Option<f64> {
        let (w, h) = (self.picture.width as f64, self.picture.height as f64);
        if !(p.x >= 1.0 && p.y >= 1.0 && p.x < w - 2.0 && p.y < h - 2.0) {
            return None;
        }
        let (x, y) = (p.x as usize, p.y as usize);
        let (u, v) = ((p.x - x as f64) as f32, (p.y - y as f64) as f32);
        let tile = self.tile(y / TILE * self.columns + x / TILE);
        let at = |i: usize, j: usize| &tile[(y % TILE + j) * ROW + x % TILE + i];
        let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
        let mix = |k: usize| {
            (1.0 - v) * ((1.0 - u) * a[k] + u * b[k]) + v * ((1.0 - u) * c[k] + u * d[k])
        };
        let (nx, ny) = (normal.x as f32, normal.y as f32);
        Some(f64::from(
            nx * nx * mix(0) + 2.0 * nx * ny * mix(1) + ny * ny * mix(2),
        ))
    }

    /// Responses at places and in directions spread evenly over the picture (an R2 sequence): its
    /// responses without a wire. One tile in [`SAMPLED`] is evaluated, on a lattice that leaves out
    /// no row or column of tiles.
    pub fn background(&self, count: usize) -> Vec<f64> {
        (0..count)
            .filter_map(|k| {
                let part = |ratio: f64| (0.5 + k as f64 * ratio).fract();
                let x = part(0.754_877_666_246_69) * self.picture.width as f64;
                let y = part(0.569_840_290_998_05) * self.picture.height as f64;
                let tile = x as usize / TILE + 2 * (y as usize / TILE);
                if !tile.is_multiple_of(SAMPLED) {
                    return None;
                }
                let angle = part(0.618_033_988_749_89) * std::f64::consts::PI;
                self.across(&Vector2::new(x, y), &Vector2::new(angle.cos(), angle.sin()))
            })
            .collect()
    }
}

/// Log likelihood ratio of a response: wire of a reference strength against the picture's own
/// background.
pub struct Evidence {
    /// +1 dark wire, -1 bright.
    pub polarity: f64,
    reference: f64,
    table: Vec<f64>,
}

/// Relative spread of the wire's response: uneven background and light along the wire.
const SPREAD: f64 = 0.35;
/// Score of a place where the wire may be hidden: no evidence, less the log odds of being hidden (1
/// in 2).
pub(crate) const HIDDEN: f64 = -0.69;

/// Bins of a tenth of the reference, from -1 to 3 references.
fn bin(response: f64, reference: f64) -> usize {
    ((response + reference) / (0.1 * reference)).clamp(0.0, 39.0) as usize
}

impl Evidence {
    /// From the responses of the background and the strength that a wire has. `polarity` +1: dark
    /// wire.
    pub fn new(background: &[f64], reference: f64, polarity: f64) -> Self {
        // One count is added to each bin (Laplace).
        let mut counts = vec![1.0; 40];
        for r in background {
            counts[bin(polarity * r, reference)] += 1.0;
        }
        let total: f64 = counts.iter().sum();
        let table = counts
            .iter()
            .enumerate()
            .map(|(k, count)| {
                let z = (k as f64 + 0.5) * 0.1 - 1.0;
                // Density of a wire's response about its reference.
                let d = (z - 1.0) / SPREAD;
                // Probability of a bin: density times its width of 0.1.
                let wire =
                    0.1 / (SPREAD * (2.0 * std::f64::consts::PI).sqrt()) * (-0.5 * d * d).exp();
                // Clamped, so that no single place decides the search.
                ((wire + 1e-4) / (count / total)).ln().clamp(-4.0, 4.0)
            })
            .collect();
        Self {
            polarity,
            reference,
            table,
        }
    }

    /// Score of a response; outside the picture counts as hidden.
    pub fn score(&self, response: Option<f64>) -> f64 {
        response.map_or(HIDDEN, |r| {
            self.table[bin(self.polarity * r, self.reference)].max(HIDDEN)
        })
    }
}
