//! Line evidence: second derivatives of the picture at the wire's scale (Steger, IEEE PAMI 20(2), 1998), and what the response
//! is worth as a likelihood ratio of wire against everything else that this very picture shows.

use crate::picture::Picture;
use nalgebra::Vector2;

/// Second derivatives of a smoothed picture.
pub struct RidgeMap {
    width: usize,
    height: usize,
    /// xx, xy, yy a pixel.
    hessian: Vec<[f32; 3]>,
}

/// Rows convolved with a kernel; the border is continued.
fn convolve_rows(source: &[f32], width: usize, kernel: &[f32]) -> Vec<f32> {
    let reach = kernel.len() / 2;
    let mut out = vec![0.0f32; source.len()];
    let mut padded = vec![0.0f32; width + 2 * reach];
    for (row, target) in source.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        padded[..reach].fill(row[0]);
        padded[reach..reach + width].copy_from_slice(row);
        padded[reach + width..].fill(row[width - 1]);
        for (k, &weight) in kernel.iter().enumerate() {
            for (t, &s) in target.iter_mut().zip(&padded[k..k + width]) {
                *t += weight * s;
            }
        }
    }
    out
}

/// Columns convolved with a kernel; the border is continued.
fn convolve_columns(source: &[f32], width: usize, kernel: &[f32]) -> Vec<f32> {
    let height = source.len() / width;
    let reach = kernel.len() as i64 / 2;
    let mut out = vec![0.0f32; source.len()];
    for (y, target) in out.chunks_exact_mut(width).enumerate() {
        for (k, &weight) in kernel.iter().enumerate() {
            let from = (y as i64 + k as i64 - reach).clamp(0, height as i64 - 1) as usize;
            for (t, &s) in target.iter_mut().zip(&source[from * width..(from + 1) * width]) {
                *t += weight * s;
            }
        }
    }
    out
}

impl RidgeMap {
    /// The map at a scale (sd of the Gaussian, px).
    #[must_use]
    pub fn new(picture: &Picture, scale_px: f64) -> Self {
        let reach = (3.5 * scale_px).ceil() as i64;
        let kernel = |order: u8| -> Vec<f32> {
            (-reach..=reach)
                .map(|k| {
                    let x = k as f64 / scale_px;
                    let g = (-0.5 * x * x).exp() / (scale_px * (2.0 * std::f64::consts::PI).sqrt());
                    (match order {
                        0 => g,
                        1 => x / scale_px * g,
                        _ => (x * x - 1.0) / (scale_px * scale_px) * g,
                    }) as f32
                })
                .collect()
        };
        let (g, d, dd) = (kernel(0), kernel(1), kernel(2));
        let source: Vec<f32> = picture.data.iter().map(|&v| f32::from(v)).collect();
        let w = picture.width;
        let smooth_x = convolve_rows(&source, w, &g);
        let xx = convolve_columns(&convolve_rows(&source, w, &dd), w, &g);
        let yy = convolve_columns(&smooth_x, w, &dd);
        let xy = convolve_columns(&convolve_rows(&source, w, &d), w, &d);
        let hessian = xx.into_iter().zip(xy).zip(yy).map(|((a, b), c)| [a, b, c]).collect();
        Self { width: w, height: picture.height, hessian }
    }

    /// Second derivative across a line with this unit normal; positive on dark lines. None outside the picture.
    #[must_use]
    pub fn across(&self, p: &Vector2<f64>, normal: &Vector2<f64>) -> Option<f64> {
        if !(p.x >= 1.0 && p.y >= 1.0 && p.x < self.width as f64 - 2.0 && p.y < self.height as f64 - 2.0) {
            return None;
        }
        let (x, y) = (p.x as usize, p.y as usize);
        let (u, v) = ((p.x - x as f64) as f32, (p.y - y as f64) as f32);
        let at = |i: usize, j: usize| &self.hessian[(y + j) * self.width + x + i];
        let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
        let mix = |k: usize| (1.0 - v) * ((1.0 - u) * a[k] + u * b[k]) + v * ((1.0 - u) * c[k] + u * d[k]);
        let (nx, ny) = (normal.x as f32, normal.y as f32);
        Some(f64::from(nx * nx * mix(0) + 2.0 * nx * ny * mix(1) + ny * ny * mix(2)))
    }

    /// Responses at places and in directions spread evenly over the picture (an R2 sequence): what it shows where nobody
    /// says there is a wire.
    #[must_use]
    pub fn background(&self, count: usize) -> Vec<f64> {
        (0..count)
            .filter_map(|k| {
                let k = k as f64;
                let x = (0.5 + k * 0.754_877_666_246_69).fract() * self.width as f64;
                let y = (0.5 + k * 0.569_840_290_998_05).fract() * self.height as f64;
                let angle = (k * 0.618_033_988_749_89).fract() * std::f64::consts::PI;
                self.across(&Vector2::new(x, y), &Vector2::new(angle.cos(), angle.sin()))
            })
            .collect()
    }
}

/// Log likelihood ratio of a response: wire of a reference strength against the picture's own background.
pub struct Evidence {
    /// +1 dark wire, -1 bright.
    pub polarity: f64,
    reference: f64,
    bin: f64,
    table: Vec<f64>,
}

/// Relative spread of the wire's response: uneven background and light along the wire.
const SPREAD: f64 = 0.35;
/// Score of a place where the wire may be hidden: neither for nor against, less the odds of being hidden (1 in 2).
pub const HIDDEN: f64 = -0.69;

impl Evidence {
    /// From the responses of the background and the strength that a wire has. `polarity` +1: dark wire.
    #[must_use]
    pub fn new(background: &[f64], reference: f64, polarity: f64) -> Self {
        // Bins of a tenth of the reference from -1 to 3 references; one count is added to each bin (Laplace).
        let bin = 0.1 * reference;
        let mut counts = vec![1.0; 40];
        for r in background {
            let k = ((polarity * r + reference) / bin).floor().clamp(0.0, 39.0) as usize;
            counts[k] += 1.0;
        }
        let total: f64 = counts.iter().sum();
        let table = counts
            .iter()
            .enumerate()
            .map(|(k, count)| {
                let z = (k as f64 + 0.5) * 0.1 - 1.0;
                let d = (z - 1.0) / SPREAD;
                let wire = 0.1 / (SPREAD * (2.0 * std::f64::consts::PI).sqrt()) * (-0.5 * d * d).exp();
                ((wire + 1e-4) / (count / total)).ln().clamp(-4.0, 4.0)
            })
            .collect();
        Self { polarity, reference, bin, table }
    }

    /// Score of a response; outside the picture counts as hidden.
    #[must_use]
    pub fn score(&self, response: Option<f64>) -> f64 {
        response.map_or(HIDDEN, |r| {
            let k = ((self.polarity * r + self.reference) / self.bin).floor().clamp(0.0, 39.0) as usize;
            self.table[k].max(HIDDEN)
        })
    }
}
