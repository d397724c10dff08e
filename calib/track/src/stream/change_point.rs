//! When an event happened: posterior of its time over a least-squares fit, and the ring-down that follows it.
//!
//! ```text
//! onset, release   y(t) = a + b max(t - t0, 0)                        broken line (hinge), a and b free
//! abrupt change    y(t) = (1 - c) (a0 + a1 t) + c (b0 + b1 t + ring),   c raised cosine from t0 over a length of up to 26 ms
//! ring             exp(-pi f t / Q) (A cos 2 pi f t + B sin 2 pi f t)   f, Q by search, A and B by least squares
//! time             p(t0) ~ exp(-RSS(t0) / 2 sigma^2);   mean and standard deviation, block width / sqrt(12) added
//! ```
//!
//! Source: profile likelihood of a change point, D. V. Hinkley, Biometrika 57 (1970) 1; two-phase regression, Biometrics 25 (1969) 495.

use super::noise::{Block, LEVEL_BLOCKS};
use nalgebra::{DMatrix, Vector2};

/// A time with its standard deviation, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventTime {
    /// Time, s.
    pub t_s: f64,
    /// Standard deviation, s.
    pub sd_s: f64,
}

/// A decaying vibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ring {
    /// Frequency, Hz.
    pub hz: f64,
    /// Quality factor.
    pub q: f64,
    /// Amplitude at the start of the fit, as the moments that it was fitted to.
    pub amplitude: f64,
    /// Start of the fit, s.
    pub from_s: f64,
}

impl Ring {
    /// Envelope at a time.
    pub fn envelope(&self, t_s: f64) -> f64 {
        let decay = std::f64::consts::PI * self.hz / self.q;
        self.amplitude * (-decay * (t_s - self.from_s)).exp()
    }
}

/// Mean and standard deviation of a time under exp(-rss / 2 sigma^2), on candidates one block apart.
fn posterior(candidates: &[(f64, f64)], variance: f64) -> Option<EventTime> {
    let best = candidates.iter().map(|c| c.1).fold(f64::INFINITY, f64::min);
    let weight = |rss: f64| (-(rss - best) / (2.0 * variance)).exp();
    let total: f64 = candidates.iter().map(|c| weight(c.1)).sum();
    if !(total > 0.0) {
        return None;
    }
    let mean = candidates.iter().map(|c| weight(c.1) * c.0).sum::<f64>() / total;
    let spread = candidates.iter().map(|c| weight(c.1) * (c.0 - mean).powi(2)).sum::<f64>() / total;
    // Within a block the time is uniform: width / sqrt(12).
    let step_s = candidates.windows(2).next().map_or(0.0, |w| w[1].0 - w[0].0);
    Some(EventTime { t_s: mean, sd_s: (spread + step_s * step_s / 12.0).sqrt() })
}

/// The part of a ramp's projection up to 70 % of it: beyond may be a plateau, which would be a second corner of the broken line.
pub fn ramp_part(projected: &[(f64, f64)], rising: bool) -> &[(f64, f64)] {
    let mean = |part: &[(f64, f64)]| part.iter().map(|p| p.1).sum::<f64>() / part.len() as f64;
    let windows = || projected.windows(LEVEL_BLOCKS).map(mean);
    let (Some(first), Some(last)) = (windows().next(), windows().next_back()) else { return projected };
    if rising {
        let high = windows().position(|m| m > first + 0.7 * (last - first));
        high.map_or(projected, |k| &projected[..k + LEVEL_BLOCKS])
    } else {
        let high = windows().rposition(|m| m > last + 0.7 * (first - last));
        high.map_or(projected, |k| &projected[k..])
    }
}

/// Start (`rising`) or end of a ramp between a level and something else: a broken line, level and slope free.
///
/// `variance`: of a block's projection, (N mm)^2.
pub fn hinge(projected: &[(f64, f64)], rising: bool, variance: f64) -> Option<EventTime> {
    let n = projected.len();
    if n < 12 {
        return None;
    }
    // RSS of the line in x = max(t - t0, 0) from its sums: S_yy - S_xy^2 / S_xx.
    let rss_at = |t0: f64| {
        let x = |t: f64| if rising { (t - t0).max(0.0) } else { (t0 - t).max(0.0) };
        let (mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (t, y) in projected {
            let x = x(*t);
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
            syy += y * y;
        }
        let n = n as f64;
        let (cxx, cxy, cyy) = (sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n);
        if cxx > 0.0 { cyy - cxy * cxy / cxx } else { cyy }
    };
    let candidates: Vec<(f64, f64)> = projected[3..n - 3].iter().map(|(t, _)| (*t, rss_at(*t))).collect();
    posterior(&candidates, variance)
}

/// Lengths of an abrupt change that are tried, s.
const CHANGES_S: [f64; 6] = [0.0, 0.004, 0.008, 0.012, 0.018, 0.026];

/// Beginning of an abrupt change between `blocks[from]` and `blocks[to]`: a transition from one line to another (and its ring, where there is
/// one) along a raised cosine of unknown length, or at once where the wire rings free: its ring begins at the old level.
///
/// Blocks are whitened: both components have variance 1. `None` where a kink, a broken line without a step, explains them as well to
/// within `min_drop`: the load began or ceased to change there.
pub fn step(
    blocks: &[Block],
    [from, to]: [usize; 2],
    ring: Option<&Ring>,
    rings_free: bool,
    min_drop: f64,
) -> Option<EventTime> {
    let lengths = if rings_free { &CHANGES_S[..1] } else { &CHANGES_S[..] };
    let (mut candidates, mut kink) = (Vec::new(), f64::INFINITY);
    let mut best = (f64::INFINITY, 0.0);
    for k in from.max(4)..to.min(blocks.len().saturating_sub(8)) {
        let start_s = (blocks[k - 1].t_s + blocks[k].t_s) / 2.0;
        kink = kink.min(kink_rss(blocks, start_s)?);
        let mut here = f64::INFINITY;
        for length in lengths {
            let rss = change_rss(blocks, start_s, *length, ring)?;
            here = here.min(rss);
            if rss < best.0 {
                best = (rss, *length);
            }
        }
        candidates.push((start_s, here));
    }
    if kink - best.0 < min_drop {
        return None;
    }
    let when = posterior(&candidates, 1.0)?;
    // The beginning of a gradual change depends on the assumed shape: a quarter of its length, a block at least.
    let shape_s = if rings_free { 0.0 } else { (best.1 / 4.0).max(super::noise::BLOCK_S) };
    Some(EventTime { sd_s: when.sd_s.hypot(shape_s), ..when })
}

fn least_squares(design: &DMatrix<f64>, blocks: &[Block]) -> Option<(f64, DMatrix<f64>)> {
    let data = DMatrix::from_fn(blocks.len(), 2, |i, c| blocks[i].moment[c]);
    let coefficients = design.tr_mul(design).cholesky()?.solve(&design.tr_mul(&data));
    Some(((data - design * &coefficients).norm_squared(), coefficients))
}

fn kink_rss(blocks: &[Block], start_s: f64) -> Option<f64> {
    let design = DMatrix::from_fn(blocks.len(), 3, |i, j| {
        let t = 10.0 * (blocks[i].t_s - start_s);
        [1.0, t, t.max(0.0)][j]
    });
    Some(least_squares(&design, blocks)?.0)
}

fn change_rss(blocks: &[Block], start_s: f64, change_s: f64, ring: Option<&Ring>) -> Option<f64> {
    let columns = if ring.is_some() { 6 } else { 4 };
    let design = DMatrix::from_fn(blocks.len(), columns, |i, j| {
        let t = blocks[i].t_s - start_s;
        let share = if t <= 0.0 {
            0.0
        } else if t >= change_s {
            1.0
        } else {
            (1.0 - (std::f64::consts::PI * t / change_s).cos()) / 2.0
        };
        match (j, ring) {
            (0, _) => 1.0 - share,
            (1, _) => (1.0 - share) * t * 10.0,
            (2, _) => share,
            (3, _) => share * t * 10.0,
            (_, Some(r)) => {
                let turn = std::f64::consts::TAU * r.hz * t;
                let decay = (-std::f64::consts::PI * r.hz / r.q * t).exp();
                share * decay * if j == 4 { turn.cos() } else { turn.sin() }
            }
            (_, None) => 0.0,
        }
    });
    Some(least_squares(&design, blocks)?.0)
}

/// Residual sum of squares and coefficients: the polynomial over the window's length, then the ring's cosine and sine.
fn fit(blocks: &[Block], ring: Option<(f64, f64)>, degree: usize) -> Option<(f64, DMatrix<f64>)> {
    let first_s = blocks.first()?.t_s;
    let columns = degree + 1 + if ring.is_some() { 2 } else { 0 };
    if blocks.len() <= columns {
        return None;
    }
    let span_s = (blocks.last()?.t_s - first_s).max(1e-9);
    let design = DMatrix::from_fn(blocks.len(), columns, |i, j| {
        let t = blocks[i].t_s - first_s;
        if j <= degree {
            return (t / span_s).powi(j as i32);
        }
        let (hz, q) = ring.unwrap_or((1.0, 1.0));
        let turn = std::f64::consts::TAU * hz * t;
        let decay = (-std::f64::consts::PI * hz / q * t).exp();
        decay * if j == degree + 1 { turn.cos() } else { turn.sin() }
    });
    least_squares(&design, blocks)
}

/// Quality factors of the first search, and factors around the best one.
const QS: [f64; 2] = [4.0, 15.0];
const Q_FACTORS: [f64; 8] = [0.5, 0.6, 0.75, 0.9, 1.1, 1.35, 2.0, 4.0];

/// The ring in whitened `blocks`, where it is significant: it lowers the RSS of a parabola by `min_drop`. Its amplitude is in standard
/// deviations of a block.
pub fn ring(blocks: &[Block], [low_hz, high_hz]: [f64; 2], min_drop: f64) -> Option<Ring> {
    let span_s = blocks.last()?.t_s - blocks.first()?.t_s;
    let plain = fit(blocks, None, 2)?.0;
    let best = |tried: &mut dyn Iterator<Item = (f64, f64)>| {
        let scored = tried.filter_map(|(hz, q)| Some((fit(blocks, Some((hz, q)), 2)?.0, hz, q)));
        scored.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    // Grid at half of the window's frequency resolution 1 / span, refined to a sixteenth of it.
    let steps = ((high_hz - low_hz) * span_s * 2.0).ceil().max(2.0);
    let pitch_hz = (high_hz - low_hz) / steps;
    let coarse = (0..=steps as usize).flat_map(|k| QS.map(|q| (low_hz + pitch_hz * k as f64, q)));
    let (_, hz, q) = best(&mut coarse.into_iter())?;
    let fine = (-6..=6).flat_map(|k| Q_FACTORS.map(|f| (hz + pitch_hz / 8.0 * f64::from(k), q * f)));
    let (_, hz, q) = best(&mut fine.into_iter())?;
    let (left, coefficients) = fit(blocks, Some((hz, q)), 2)?;
    let amplitude = coefficients.rows(3, 2).norm();
    (plain - left >= min_drop).then_some(Ring { hz, q, amplitude, from_s: blocks.first()?.t_s })
}

/// Level at the end of `blocks`, the ring subtracted.
pub fn level(blocks: &[Block], ring: Option<&Ring>) -> Option<Vector2<f64>> {
    let (_, c) = fit(blocks, ring.map(|r| (r.hz, r.q)), 1)?;
    Some(Vector2::new(c[(0, 0)] + c[(1, 0)], c[(0, 1)] + c[(1, 1)]))
}
