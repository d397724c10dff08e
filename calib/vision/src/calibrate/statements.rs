//! Whether the board is what its user states: the solve's RMS against the corners' own noise, and
//! where it does not fit, the same solve with every other statement about the board.
//!
//! ```text
//! excess^2 = RMS^2 - noise^2;   asked where RMS > 1.3 noise;   another statement fits where excess'^2 < excess^2 / 4
//! stretch s of the print along its columns: the vertex of the parabola through the costs at s - h, s, s + h
//! ```
//! Pictures know no length: a factor common to all sizes changes no residual, and the baseline
//! follows it.

use crate::calibrate::alternatives::alternatives;
use crate::calibrate::bundle::{BoardView, Free, solve};
use crate::calibrate::markers::BoardLayout;
use crate::calibrate::noise::{CornerNoise, corner_noise};
use crate::calibrate::solution::{StereoSolution, calibrate_stereo};
use crate::calibrate::views::board_pairs;
use crate::camera::Lens;
use crate::error::VisionError;
use crate::pairs::PairFiles;
use nalgebra::Vector3;
use rayon::prelude::*;

/// RMS over the corners' noise from which other statements are tried: rendered boards have 0.97 to
/// 1.03, the thirteen pairs of OpenCV's sample (a bent print) 1.83.
const ASKED: f64 = 1.3;
/// RMS over the corners' noise beyond which a board does not fit, whether another statement does or
/// not.
const MISFIT: f64 = 4.0;
/// Share of the squares beyond the noise that another statement may leave.
const LEFT_OVER: f64 = 0.25;
/// Noise beyond which the corners are in no grid as stated, px: corners are good to tenths.
const NO_GRID_PX: f64 = 1.0;
/// Difference of fx and fy, as a share, from which it is asked where it comes from: sensors' pixels
/// are square to far less.
const NOT_SQUARE: f64 = 0.004;
/// Change of chi2 that decides between two prints.
const DECIDED: f64 = 16.0;

/// Solves for a stated board that pairs of pictures show. Where it does not fit, the statement that
/// does is named: in a warning, or in the error of a solve that failed.
///
/// # Errors
/// As `calibrate_stereo`.
pub(crate) fn calibrate_as_stated(
    files: &[PairFiles],
    stated: &BoardLayout,
    views: Result<Vec<BoardView>, VisionError>,
    image_size: [usize; 2],
    lens: &'static dyn Lens,
) -> Result<(StereoSolution, CornerNoise), VisionError> {
    let points = &stated.points;
    let seen = views.as_ref().map_or_else(|_| Vec::new(), Clone::clone);
    let outcome = views.and_then(|v| calibrate_stereo(points, v, image_size, lens));
    let noise = corner_noise(&stated.places, outcome.as_ref().map_or(&seen, |s| &s.views));
    let stated_rms = outcome
        .as_ref()
        .map_or(f64::INFINITY, |s| s.bundle.rms_px());
    let asked = stated_rms > ASKED * noise.rms_px || noise.rms_px > NO_GRID_PX || outcome.is_err();
    let others = if asked {
        alternatives(stated, &noise)
    } else {
        Vec::new()
    };
    let mut fitting: Vec<Other> = others
        .into_par_iter()
        .filter_map(|(says, board)| {
            // Tags are read without their places, markers' corners with them.
            let views = match stated.corners_by_number() {
                true => seen.clone(),
                false => board_pairs(files, &board).views.ok()?,
            };
            let solution = calibrate_stereo(&board.points, views, image_size, lens).ok()?;
            let noise_px = corner_noise(&board.places, &solution.views).rms_px;
            Some(Other {
                rms_px: solution.bundle.rms_px(),
                noise_px,
                says,
            })
        })
        .collect();
    if asked && let Ok(solution) = &outcome {
        let (stretch, rms_px) = stretched(points, solution);
        fitting.push(Other {
            rms_px,
            noise_px: noise.rms_px,
            says: print_stretched(stretch),
        });
    }
    fitting.retain(|o| o.fits(stated_rms));
    // Among statements that fit alike the first one: a plain mistake before a number that is free.
    let least = fitting.iter().fold(f64::INFINITY, |a, f| a.min(f.rms_px));
    let found = fitting.into_iter().find(|f| f.rms_px < 1.05 * least);
    let better = found.map(|o| format!("With {} RMS is {:.3} px", o.says, o.rms_px));
    match outcome {
        Ok(mut solution) => {
            let beside = format!(
                "the stated board does not fit: RMS {stated_rms:.3} px where the corners' own noise is {:.3} px",
                noise.rms_px
            );
            solution.warnings.extend(match better {
                Some(better) => Some(format!("{beside}. {better}")),
                None if stated_rms > MISFIT * noise.rms_px => Some(format!(
                    "{beside}, and no other statement about it does (bent, moved while pictured, another lens model?)"
                )),
                None => not_square(points, &solution),
            });
            Ok((solution, noise))
        }
        Err(e) => Err(match better {
            Some(better) => e.and(&format!(". The stated board does not fit. {better}")),
            None => e,
        }),
    }
}

/// Another statement about the board: the solve's RMS with it, and the corners' own noise.
struct Other {
    rms_px: f64,
    noise_px: f64,
    /// Completes "with ... RMS is".
    says: String,
}

impl Other {
    /// Whether it explains what a statement with this RMS does not.
    fn fits(&self, stated_rms: f64) -> bool {
        // Misfit and noise are independent: their squares add.
        let excess = |rms: f64| (rms * rms - self.noise_px * self.noise_px).max(0.0);
        self.rms_px < MISFIT * self.noise_px
            && self.noise_px < NO_GRID_PX
            && excess(self.rms_px) < LEFT_OVER * excess(stated_rms)
    }
}

/// RMS (px) and cost (px^2) with a print that is longer along its columns by a factor.
fn with_stretch(points: &[Vector3<f64>], solution: &StereoSolution, factor: f64) -> (f64, f64) {
    let longer: Vec<_> = points
        .iter()
        .map(|p| Vector3::new(p.x, p.y * factor, p.z))
        .collect();
    let (state, free) = (solution.bundle.state.clone(), Free::All(solution.warp_used));
    let solved = solve(&longer, &solution.views, state, free);
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
        // Vertex of the parabola through three costs.
        let bend = costs[0] - 2.0 * costs[1] + costs[2];
        if bend > 0.0 {
            middle += (0.5 * step * (costs[0] - costs[2]) / bend).clamp(-0.1, 0.1);
        }
    }
    (middle, with_stretch(points, solution, middle).0)
}

fn print_stretched(factor: f64) -> String {
    let (along, percent) = if factor > 1.0 {
        ("columns", factor - 1.0)
    } else {
        ("rows", 1.0 / factor - 1.0)
    };
    format!(
        "a print that is {:.2} % longer along its {along} than across",
        100.0 * percent
    )
}

/// Both cameras' fx and fy differ alike: pixels that are not square, or a print that is stretched.
/// Boards rolled differently tell; others do not.
fn not_square(points: &[Vector3<f64>], solution: &StereoSolution) -> Option<String> {
    let aspects = [0, 1].map(|k| {
        let [fx, fy] = solution.bundle.state.cameras[k].focal_px;
        fy / fx
    });
    let both = 0.5 * (aspects[0] + aspects[1]);
    if (both - 1.0).abs() < NOT_SQUARE || (aspects[0] - aspects[1]).abs() > 0.5 * (both - 1.0).abs()
    {
        return None;
    }
    // Square pixels see a print that is longer along y by that factor.
    let variance = solution.bundle.cost_px2 / (2 * solution.bundle.corners) as f64;
    let change = (with_stretch(points, solution, both).1 - solution.bundle.cost_px2) / variance;
    let print = print_stretched(both);
    (change < DECIDED).then(|| {
        let decided = if change < -DECIDED { "the pictures fit" } else { "these views cannot distinguish it from" };
        format!("fy/fx is {both:.4} in both cameras: pixels that are not square? {decided} {print}; boards rolled by 90 degrees decide")
    })
}
