//! The way of refining a chessboard's corners, chosen from the data: window and method whose corners fit one rigid board best.

use crate::calibrate::bundle::BoardView;
use crate::calibrate::chessboard::{BoardSize, Refinement, refine};
use crate::calibrate::initial::Corners;
use crate::calibrate::solution::calibrate_stereo;
use crate::camera::lens::Lens;
use crate::error::VisionError;
use crate::picture::Picture;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A pair of pictures that can be used.
pub(crate) struct View {
    pub name: String,
    pub pictures: [Picture; 2],
    pub coarse: [Vec<Vector2<f64>>; 2],
}

/// Ways of refining that are tried on a chessboard.
const CANDIDATES: [Refinement; 4] =
    [Refinement::Model(0.3), Refinement::Model(0.5), Refinement::Model(0.7), Refinement::Gradient(5)];

/// Views, the RMS of every way tried (px), the way chosen.
pub(crate) type Refined = (Vec<BoardView>, BTreeMap<String, f64>, String);

/// Refines in every way and keeps the one whose corners fit one rigid board best. All ways solve for the same parameters, so
/// that their RMS may be compared; a way that loses more than one corner in a hundred does not take part.
pub(crate) fn choose_refinement(
    points: &[Vector3<f64>],
    size: BoardSize,
    views: &[View],
    (image_size, lens): ([usize; 2], &'static dyn Lens),
    progress: &(dyn Fn(&str) + Sync),
) -> Result<Refined, VisionError> {
    let mut tried = BTreeMap::new();
    let mut best: Option<(f64, Vec<BoardView>, String)> = None;
    let mut failure = None;
    let mut starts: Vec<[Vec<Vector2<f64>>; 2]> = views.iter().map(|v| v.coarse.clone()).collect();
    for how in CANDIDATES {
        let corners: Vec<[Corners; 2]> = views
            .par_iter()
            .zip(&starts)
            .map(|(v, start)| {
                let one = |k: usize| -> Result<Corners, VisionError> {
                    Ok(refine(&v.pictures[k], size, &start[k], how)?
                        .into_iter()
                        .map(|c| c.map(|c| c.position_px))
                        .collect())
                };
                Ok([one(0)?, one(1)?])
            })
            .collect::<Result<_, VisionError>>()?;
        let lost = corners.iter().flatten().flatten().filter(|c| c.is_none()).count();
        if lost * 100 > corners.len() * 2 * points.len() {
            continue;
        }
        let bundle: Vec<BoardView> = views
            .iter()
            .zip(&corners)
            .map(|(v, [l, r])| BoardView { name: v.name.clone(), left: l.clone(), right: r.clone() })
            .collect();
        match calibrate_stereo(points, bundle.clone(), image_size, lens) {
            Ok(solution) => {
                // Views left out would flatter a way: each costs as if it had four times the RMS.
                let rms =
                    solution.bundle.rms_px() * (1.0 + solution.rejected.len() as f64 / views.len() as f64);
                progress(&format!("{how}: {:.4} px", solution.bundle.rms_px()));
                tried.insert(how.to_string(), solution.bundle.rms_px());
                if best.as_ref().is_none_or(|b| rms < b.0) {
                    best = Some((rms, bundle, how.to_string()));
                }
            }
            Err(e) => failure = Some(e),
        }
        // The next window starts from what this one found.
        if matches!(how, Refinement::Model(_)) {
            for (start, found) in starts.iter_mut().zip(&corners) {
                for (s, f) in start.iter_mut().zip(found) {
                    for (p, q) in s.iter_mut().zip(f) {
                        if let Some(q) = q {
                            *p = *q;
                        }
                    }
                }
            }
        }
    }
    match (best, failure) {
        (Some((_, views, chosen)), _) => Ok((views, tried, chosen)),
        (None, Some(e)) => Err(e),
        (None, None) => Err(VisionError::result("refine corners", "corners that can be refined", "none")),
    }
}
