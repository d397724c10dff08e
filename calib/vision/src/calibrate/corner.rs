//! Sub-pixel corners of a chessboard by a model of the picture around them: two blurred edges that
//! cross, `I = a + b erf(e1/s) erf(e2/s) + g.x`, fitted to every pixel of the window by
//! Levenberg-Marquardt. Unequal exposure moves the two edges in opposite directions on the two
//! sides of the corner, so it does not move the corner.

use crate::picture::Picture;
use crate::profile::erf_with_slope;
use nalgebra::{Const, SMatrix, SVector, Vector2};
use wcal_core::least_squares::{Damping, Ending, NormalEquations, minimise};

const PARAMETERS: usize = 9;

/// Fits the corner near `start`. `sides` are the directions (px, any length) of the two rows of the
/// board through the corner; `radius_px` the radius of the round window.
///
/// Returns none where the window leaves the picture or the fit wanders off by more than half the
/// radius.
pub(crate) fn fit_corner(
    picture: &Picture,
    start: &Vector2<f64>,
    sides: [Vector2<f64>; 2],
    radius_px: f64,
) -> Option<Vector2<f64>> {
    if !picture.contains(start.x, start.y, radius_px + 2.0) {
        return None;
    }
    let (cx0, cy0) = (start.x.round(), start.y.round());
    let reach = radius_px.ceil() as i64;
    let mut pixels = Vec::new();
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            // A smooth edge of the window keeps the objective continuous as pixels enter.
            let r = ((dx * dx + dy * dy) as f64).sqrt();
            let weight = ((radius_px + 0.5 - r).clamp(0.0, 1.0)).sqrt();
            if weight > 0.0 {
                let value = picture.at(cx0 as i64 + dx, cy0 as i64 + dy);
                pixels.push((dx as f64, dy as f64, value, weight));
            }
        }
    }
    let count = pixels.len() as f64;
    let mean = pixels.iter().map(|p| p.2).sum::<f64>() / count;
    let sd = (pixels.iter().map(|p| (p.2 - mean).powi(2)).sum::<f64>() / count).sqrt();
    let angles = sides.map(|s| s.y.atan2(s.x));
    let mut p = SVector::<f64, PARAMETERS>::from_row_slice(&[
        start.x - cx0,
        start.y - cy0,
        angles[0],
        angles[1],
        mean,
        sd,
        // The blur as a logarithm: it stays positive.
        1.0_f64.ln(),
        0.0,
        0.0,
    ]);
    // Which diagonal is dark is not known: the correlation with the model tells the sign.
    let sign: f64 = pixels
        .iter()
        .map(|q| model(&p, q.0, q.1) * (q.2 - mean))
        .sum();
    p[5] = sd.copysign(sign);
    let settled = |step: &SVector<f64, PARAMETERS>, [before, after]: [f64; 2]| {
        step.fixed_rows::<2>(0).norm() < 1e-5 && before - after <= 1e-7 * before
    };
    let linearised = |p: &SVector<f64, PARAMETERS>| Some(linearise(p, &pixels));
    let first = (p, linearise(&p, &pixels));
    let found = minimise(
        first,
        &Damping::default(),
        linearised,
        |p, _, step| p + step,
        settled,
    );
    if found.ending == Ending::Singular {
        return None;
    }
    let (p, cost) = (found.place, found.at.cost);
    let moved = Vector2::new(p[0] + cx0 - start.x, p[1] + cy0 - start.y);
    let sound = cost.is_finite() && moved.norm() <= 0.5 * radius_px && p[6].exp() <= radius_px;
    sound.then(|| start + moved)
}

/// Product of the profiles of the two edges.
fn model(p: &SVector<f64, PARAMETERS>, x: f64, y: f64) -> f64 {
    let (dx, dy, s) = (x - p[0], y - p[1], p[6].exp() * std::f64::consts::SQRT_2);
    let profile = |angle: f64| erf_with_slope((angle.cos() * dy - angle.sin() * dx) / s).0;
    profile(p[2]) * profile(p[3])
}

fn linearise(
    p: &SVector<f64, PARAMETERS>,
    pixels: &[(f64, f64, f64, f64)],
) -> NormalEquations<Const<PARAMETERS>> {
    let mut cost = 0.0;
    let mut normal = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    let mut gradient = SVector::<f64, PARAMETERS>::zeros();
    let s = p[6].exp() * std::f64::consts::SQRT_2;
    let (sin, cos) = ([p[2].sin(), p[3].sin()], [p[2].cos(), p[3].cos()]);
    for &(x, y, value, weight) in pixels {
        let (dx, dy) = (x - p[0], y - p[1]);
        let e = [-sin[0] * dx + cos[0] * dy, -sin[1] * dx + cos[1] * dy];
        let ((f0, s0), (f1, s1)) = (erf_with_slope(e[0] / s), erf_with_slope(e[1] / s));
        let (f, slope) = ([f0, f1], [s0 / s, s1 / s]);
        let b = p[5];
        // Product rule: an edge moves the picture only where the other one is not 0.
        let (d0, d1) = (b * slope[0] * f[1], b * slope[1] * f[0]);
        let row = SVector::<f64, PARAMETERS>::from_row_slice(&[
            d0 * sin[0] + d1 * sin[1],
            -d0 * cos[0] - d1 * cos[1],
            d0 * (-cos[0] * dx - sin[0] * dy),
            d1 * (-cos[1] * dx - sin[1] * dy),
            1.0,
            f[0] * f[1],
            -(d0 * e[0] + d1 * e[1]),
            x,
            y,
        ]) * weight;
        // Residual against the two crossing edges on a tilted plane of light.
        let residual = weight * (value - (p[4] + b * f[0] * f[1] + p[7] * x + p[8] * y));
        cost += residual * residual;
        normal += row * row.transpose();
        gradient.axpy(residual, &row, 1.0);
    }
    NormalEquations {
        cost,
        matrix: normal,
        descent: gradient,
    }
}
