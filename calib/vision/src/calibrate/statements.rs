//! Whether the board is what its user states: the solve's RMS against the corners' own noise, and where it does not fit, the same solve with every
//! other statement about the board.
//!
//! ```text
//! excess^2 = RMS^2 - noise^2;   asked where RMS > 1.3 noise;   another statement fits where excess'^2 < excess^2 / 4
//! stretch s of the print along its columns: the vertex of the parabola through the costs at s - h, s, s + h
//! ```
//! Pictures know no length: a factor common to all sizes changes no residual, and the baseline follows it.

use crate::calibrate::bundle::{BoardView, Free, solve};
use crate::calibrate::noise::{CornerNoise, GridPlace, corner_noise};
use crate::calibrate::solution::{StereoSolution, calibrate_stereo};
use crate::camera::lens::Lens;
use crate::error::VisionError;
use nalgebra::Vector3;
use rayon::prelude::*;

/// RMS over the corners' noise from which other statements are tried: rendered boards have 0.97 to 1.03, the thirteen pairs of OpenCV's sample
/// (a bent print) 1.83.
const ASKED: f64 = 1.3;
/// RMS over the corners' noise beyond which a board does not fit, whether another statement does or not.
const MISFIT: f64 = 4.0;
/// Share of the squares beyond the noise that another statement may leave.
const LEFT_OVER: f64 = 0.25;
/// Noise beyond which the corners are in no grid as stated, px: corners are good to tenths.
const NO_GRID_PX: f64 = 1.0;
/// Difference of fx and fy, as a share, from which it is asked where it comes from: sensors' pixels are square to far less.
const NOT_SQUARE: f64 = 0.004;
/// Change of chi2 that decides between two prints.
const DECIDED: f64 = 16.0;

/// A board and what the pictures show of it.
pub(crate) struct BoardStatement {
    /// Completes "with ... RMS is".
    pub says: String,
    pub points: Vec<Vector3<f64>>,
    pub places: Vec<GridPlace>,
    /// Views with its corners, or why there are none.
    pub views: Result<Vec<BoardView>, VisionError>,
}

/// Other statements about a board, once its corners' noise is known.
pub(crate) type Others<'a> = dyn Fn(&CornerNoise) -> Vec<BoardStatement> + 'a;

/// Size of the pictures and model of the lenses.
pub(crate) type Optics = ([usize; 2], &'static dyn Lens);

/// Solves with the stated board. Where it does not fit, the statement that does is named: in a warning, or in the error of a solve that failed.
///
/// # Errors
/// As `calibrate_stereo`.
pub(crate) fn calibrate_as_stated(
    stated: BoardStatement,
    (image_size, lens): Optics,
    others: &Others<'_>,
) -> Result<(StereoSolution, CornerNoise), VisionError> {
    let BoardStatement { points, places, views, .. } = stated;
    let seen = views.as_ref().map_or_else(|_| Vec::new(), Clone::clone);
    let outcome = views.and_then(|v| calibrate_stereo(&points, v, image_size, lens));
    let noise = corner_noise(&places, outcome.as_ref().map_or(&seen, |s| &s.views));
    let asked = match &outcome {
        Ok(solution) => solution.bundle.rms_px() > ASKED * noise.rms_px || noise.rms_px > NO_GRID_PX,
        Err(_) => true,
    };
    if !asked {
        return outcome.map(|mut solution| {
            solution.warnings.extend(not_square(&points, &solution));
            (solution, noise)
        });
    }
    let excess = |rms: f64, noise: f64| (rms * rms - noise * noise).max(0.0);
    let stated = outcome.as_ref().map_or(f64::INFINITY, |s| s.bundle.rms_px());
    let mut fitting: Vec<(f64, f64, String)> = others(&noise)
        .into_par_iter()
        .filter_map(|other| {
            let solution = calibrate_stereo(&other.points, other.views.ok()?, image_size, lens).ok()?;
            let own = corner_noise(&other.places, &solution.views).rms_px;
            Some((solution.bundle.rms_px(), own, other.says))
        })
        .collect();
    if let Ok(solution) = &outcome {
        let (stretch, rms) = stretched(&points, solution);
        fitting.push((rms, noise.rms_px, print_stretched(stretch)));
    }
    fitting.retain(|(rms, own, _)| {
        *rms < MISFIT * own && *own < NO_GRID_PX && excess(*rms, *own) < LEFT_OVER * excess(stated, *own)
    });
    // Among statements that fit alike the first one: a plain mistake before a number that is free.
    let least = fitting.iter().map(|f| f.0).fold(f64::INFINITY, f64::min);
    let found = fitting.into_iter().find(|f| f.0 < 1.05 * least);
    match (outcome, found) {
        (Ok(mut solution), found) => {
            let beside = format!(
                "the stated board does not fit: RMS {stated:.3} px where the corners' own noise is {:.3} px",
                noise.rms_px
            );
            solution.warnings.extend(match found {
                Some((rms, _, says)) => Some(format!("{beside}. With {says} RMS is {rms:.3} px")),
                None if stated > MISFIT * noise.rms_px => Some(format!(
                    "{beside}, and no other statement about it does (bent, moved while pictured, another lens model?)"
                )),
                None => not_square(&points, &solution),
            });
            Ok((solution, noise))
        }
        (Err(VisionError::Result { action, expected, found }), Some((rms, _, says))) => {
            let found = format!("{found}. The stated board does not fit. With {says} RMS is {rms:.3} px");
            Err(VisionError::Result { action, expected, found })
        }
        (Err(e), _) => Err(e),
    }
}

/// RMS (px) and cost (px^2) with a print that is longer along its columns by a factor.
fn with_stretch(points: &[Vector3<f64>], solution: &StereoSolution, factor: f64) -> (f64, f64) {
    let longer: Vec<_> = points.iter().map(|p| Vector3::new(p.x, p.y * factor, p.z)).collect();
    let free = Free::all(solution.warp_used);
    let solved = solve(&longer, &solution.views, solution.bundle.state.clone(), free);
    (solved.rms_px(), solved.cost_px2)
}

/// The stretch that fits best, and its RMS, px.
fn stretched(points: &[Vector3<f64>], solution: &StereoSolution) -> (f64, f64) {
    let mut middle = 1.0;
    for step in [0.01, 0.003] {
        let costs: Vec<f64> = [-step, 0.0, step]
            .into_par_iter()
            .map(|by| with_stretch(points, solution, middle + by).1)
            .collect();
        let bend = costs[0] - 2.0 * costs[1] + costs[2];
        if bend > 0.0 {
            middle += (0.5 * step * (costs[0] - costs[2]) / bend).clamp(-0.1, 0.1);
        }
    }
    (middle, with_stretch(points, solution, middle).0)
}

fn print_stretched(factor: f64) -> String {
    let (along, percent) =
        if factor > 1.0 { ("columns", factor - 1.0) } else { ("rows", 1.0 / factor - 1.0) };
    format!("a print that is {:.2} % longer along its {along} than across", 100.0 * percent)
}

/// Both cameras' fx and fy differ alike: pixels that are not square, or a print that is stretched. Boards rolled differently tell; others do not.
fn not_square(points: &[Vector3<f64>], solution: &StereoSolution) -> Option<String> {
    let aspects = [0, 1].map(|k| {
        let [fx, fy] = solution.bundle.state.cameras[k].focal_px;
        fy / fx
    });
    let both = 0.5 * (aspects[0] + aspects[1]);
    if (both - 1.0).abs() < NOT_SQUARE || (aspects[0] - aspects[1]).abs() > 0.5 * (both - 1.0).abs() {
        return None;
    }
    // Square pixels see a print that is longer along y by that factor.
    let variance = solution.bundle.cost_px2 / (2 * solution.bundle.corners) as f64;
    let change = (with_stretch(points, solution, both).1 - solution.bundle.cost_px2) / variance;
    let print = print_stretched(both);
    (change < DECIDED).then(|| {
        let decided = if change < -DECIDED { "the pictures fit" } else { "these views do not tell it from" };
        format!("fy/fx is {both:.4} in both cameras: pixels that are not square? {decided} {print}; boards rolled by 90 degrees tell")
    })
}
