//! Method of refinement of a chessboard's corners, chosen from the data: window and model whose corners fit one rigid board best.
//!
//! `method = argmin RMS |corner - pi(T p)|` of the joint solve (`bundle`): all methods have the same parameters, so that their RMS compare
//! without a penalty for complexity.

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

impl View {
    /// Corners as the finder gave them.
    pub fn coarse_corners(&self) -> BoardView {
        let [left, right] = [0, 1].map(|k| self.coarse[k].iter().copied().map(Some).collect());
        BoardView { name: self.name.clone(), left, right }
    }
}

/// Methods of refinement that are tried on a chessboard.
const CANDIDATES: [Refinement; 4] =
    [Refinement::Model(0.3), Refinement::Model(0.5), Refinement::Model(0.7), Refinement::Gradient(5)];

/// Views, the RMS of every method tried (px), the method chosen.
pub(crate) type Refined = (Vec<BoardView>, BTreeMap<String, f64>, String);

/// Refines with every method and keeps the one whose corners fit one rigid board best. A method that loses more than one corner in a
/// hundred is excluded.
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
                // Left-out views would favour a method: each costs as if it had four times the RMS.
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
