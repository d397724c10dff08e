//! The wire's end: where the bar stops along its own line. The depth of the bar at t along the line
//! is fitted by a blurred step, `d(t) = d1 (1 - S(t - t0)) + d2 S(t - t0)`, by Gauss-Newton on (t0,
//! d1, d2); `S` as in `bar`. Source: ISO 12233 (slanted-edge method: an edge as the integral of the
//! line spread function).

use crate::picture::Picture;
use crate::profile::blurred_step;
use crate::wire::piece::{Appearance, Station};
use nalgebra::{Matrix3, Vector2, Vector3};

/// An end found in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    /// Arc length, mm.
    pub arc_mm: f64,
    /// Standard deviation, mm.
    pub sd_mm: f64,
    /// The part of it that every picture of this end shares: its unknown form, mm.
    pub shared_mm: f64,
}

/// Half length of the window along the line, px.
const WINDOW_PX: f64 = 18.0;
/// Standard deviation from the unknown form of the end (flat, round) and of the blur, px.
const FLOOR_PX: f64 = 0.15;

/// Fits the end of a bar near `around_mm`. `line`: stations that continue beyond the end. None
/// where the picture does not show it.
pub(crate) fn find_tip(
    picture: &Picture,
    line: &[Station],
    appearance: Appearance,
    around_mm: f64,
) -> Option<Tip> {
    let off = |s: &Station| (s.arc_mm - around_mm).abs();
    let (i, at) = line
        .iter()
        .enumerate()
        .min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
    let (before, after) = (
        line.get(i.saturating_sub(4))?,
        line.get((i + 4).min(line.len() - 1))?,
    );
    let mm_per_px =
        (after.arc_mm - before.arc_mm) / (after.position_px - before.position_px).norm().max(1e-9);
    let (normal, width) = (at.normal(), at.width_px * appearance.width_scale);
    if !picture.contains(at.position_px.x, at.position_px.y, WINDOW_PX + width + 4.0) {
        return None;
    }
    // Depth of the bar at every pixel along the line: both sides minus the middle.
    let side_px = 0.5 * width + 2.0 * appearance.blur_px + 1.5;
    let samples: Vec<(f64, f64)> = (-(WINDOW_PX as i64)..=WINDOW_PX as i64)
        .map(|k| {
            let t = k as f64;
            let centre = at.position_px + at.tangent * t + normal * (0.5 * at.bend_per_px * t * t);
            let at_offset = |u: f64| {
                let p: Vector2<f64> = centre + normal * u;
                picture.sample(p.x, p.y)
            };
            let middle: f64 = [-0.25, 0.0, 0.25]
                .iter()
                .map(|f| at_offset(f * width))
                .sum();
            (
                t,
                0.5 * (at_offset(side_px) + at_offset(-side_px)) - middle / 3.0,
            )
        })
        .collect();
    // Coarse: the best split into two levels; then Gauss-Newton on place and levels of a blurred
    // step.
    let mut place = 0.0;
    let mut smallest = f64::INFINITY;
    for k in 4..samples.len() - 4 {
        let level = |part: &[(f64, f64)]| -> f64 {
            let mean = part.iter().map(|s| s.1).sum::<f64>() / part.len() as f64;
            part.iter().map(|s| (s.1 - mean).powi(2)).sum()
        };
        let cost = level(&samples[..k]) + level(&samples[k..]);
        if cost < smallest {
            (smallest, place) = (cost, samples[k].0 - 0.5);
        }
    }
    let mean = |f: &dyn Fn(f64) -> bool| {
        let part: Vec<f64> = samples.iter().filter(|s| f(s.0)).map(|s| s.1).collect();
        part.iter().sum::<f64>() / part.len().max(1) as f64
    };
    let mut p = Vector3::new(
        place,
        mean(&|t| t < place - 1.0),
        mean(&|t| t > place + 1.0),
    );
    let mut covariance = Matrix3::identity();
    let mut variance = 0.0;
    for _ in 0..15 {
        let (mut m, mut g, mut cost) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for &(t, value) in &samples {
            let (f, slope) = blurred_step(t - p[0], appearance.blur_px.hypot(0.4));
            let r = value - (p[1] * (1.0 - f) + p[2] * f);
            let j = Vector3::new((p[1] - p[2]) * slope, 1.0 - f, f);
            m += j * j.transpose();
            g += j * r;
            cost += r * r;
        }
        // Gauss-Newton; the place moves by two pixels a step at most.
        covariance = m.try_inverse()?;
        variance = cost / (samples.len() as f64 - 3.0);
        let mut step = covariance * g;
        step[0] = step[0].clamp(-2.0, 2.0);
        p += step;
        if step[0].abs() < 1e-4 {
            break;
        }
    }
    // The step must be significant against the samples' scatter, and the bar must vanish beyond it.
    let contrast = (p[1] - p[2]).abs();
    if p[0].abs() > WINDOW_PX - 3.0
        || contrast < 4.0 * variance.sqrt()
        || p[2].abs() > 0.35 * p[1].abs()
    {
        return None;
    }
    let sd_px = (variance * covariance[(0, 0)]).sqrt().hypot(FLOOR_PX);
    Some(Tip {
        arc_mm: at.arc_mm + p[0] * mm_per_px,
        sd_mm: sd_px * mm_per_px,
        shared_mm: FLOOR_PX * mm_per_px,
    })
}
