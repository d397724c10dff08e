//! The corners' own noise: what no smooth picture of a regular grid explains, whatever sizes, lens
//! and flatness are.
//!
//! ```text
//! px_k = q_k + P3(q_k) + e_k,   q_k = H (c_k + o_kind),   sd^2 = sum |e|^2 / sum (n - 10)      per picture: H, P3; all pictures: o
//! ```
//! Corners of one kind (all of a chessboard; the lower left ones of all tags) lie at whole steps c
//! of a regular grid. The homography H takes the steps to the picture, the offsets o of the kinds
//! are measured with it, and the cubic P3 in both coordinates is what lens and bent paper do over a
//! board. None of them knows a length, so that the noise holds beside any statement about the
//! board. Source of the idea: the residuals of calibration-free line and grid checks, Hartley and
//! Zisserman, Multiple View Geometry, 2nd ed., 4.1 and 7.4.

use crate::calibrate::bundle::{BoardView, Corners};
use crate::homography::{homography, mapped};
use crate::median::median;
use nalgebra::{DMatrix, DVector, Matrix3, Vector2};

/// Terms of a cubic in two coordinates.
const POWERS: [[i32; 2]; 10] = [
    [0, 0],
    [1, 0],
    [0, 1],
    [2, 0],
    [1, 1],
    [0, 2],
    [3, 0],
    [2, 1],
    [1, 2],
    [0, 3],
];
const TERMS: usize = POWERS.len();
/// Corners of one picture from which their scatter about the cubic is estimated.
const FEWEST: usize = 2 * TERMS;
/// Rounds in which homographies and the kinds' offsets settle.
const ROUNDS: usize = 3;

/// Place of a board's point: step of the grid, and kind.
#[derive(Clone, Copy)]
pub(crate) struct GridPlace {
    pub cell: Vector2<f64>,
    pub kind: usize,
}

/// The corners' noise, and where each kind of corner is off its step of the grid, in steps.
pub(crate) struct CornerNoise {
    /// Per-corner RMS (both coordinates), px, as the solve's `rms_px`; NaN where no picture shows
    /// enough corners.
    pub rms_px: f64,
    pub offsets: Vec<Vector2<f64>>,
}

/// Noise of the corners of all pictures.
pub(crate) fn corner_noise(places: &[GridPlace], views: &[BoardView]) -> CornerNoise {
    let kinds = places.iter().map(|p| p.kind + 1).max().unwrap_or(1);
    let mut offsets = vec![Vector2::zeros(); kinds];
    let pictures = || views.iter().flat_map(|v| &v.corners);
    for _ in 0..if kinds > 1 { ROUNDS } else { 0 } {
        let mut found: Vec<[Vec<f64>; 2]> = vec![Default::default(); kinds];
        for corners in pictures() {
            let Some((h, seen)) = grid_in_picture(places, &offsets, corners) else {
                continue;
            };
            let back = h.try_inverse();
            for (place, px) in seen {
                if let Some(at) = back.and_then(|back| mapped(&back, &px)) {
                    let [x, y] = &mut found[place.kind];
                    x.push(at.x - place.cell.x);
                    y.push(at.y - place.cell.y);
                }
            }
        }
        // Medians: a corner that was taken wrongly does not move a kind.
        offsets = found
            .iter()
            .map(|f| Vector2::new(median(&f[0]), median(&f[1])))
            .collect();
    }
    let (sum, freedom) = pictures()
        .filter_map(|corners| scatter(places, &offsets, corners))
        .fold((0.0, 0), |(s, n), one| (s + one.0, n + one.1));
    CornerNoise {
        rms_px: (sum / freedom as f64).sqrt(),
        offsets,
    }
}

type Seen = Vec<(GridPlace, Vector2<f64>)>;

/// The homography from steps to pixels in one picture, and the corners seen.
fn grid_in_picture(
    places: &[GridPlace],
    offsets: &[Vector2<f64>],
    corners: &Corners,
) -> Option<(Matrix3<f64>, Seen)> {
    let seen: Seen = places
        .iter()
        .zip(corners)
        .filter_map(|(p, c)| Some((*p, (*c)?)))
        .collect();
    let from: Vec<_> = seen.iter().map(|(p, _)| p.cell + offsets[p.kind]).collect();
    let to: Vec<_> = seen.iter().map(|s| s.1).collect();
    Some((homography(&from, &to)?, seen))
}

/// Sum of squares about the smooth picture of the grid, px^2, and the corners that are left to
/// judge it.
fn scatter(
    places: &[GridPlace],
    offsets: &[Vector2<f64>],
    corners: &Corners,
) -> Option<(f64, usize)> {
    let (h, seen) = grid_in_picture(places, offsets, corners)?;
    if seen.len() < FEWEST {
        return None;
    }
    let predicted: Vec<Vector2<f64>> = seen
        .iter()
        .map(|(p, _)| mapped(&h, &(p.cell + offsets[p.kind])))
        .collect::<Option<_>>()?;
    let centre = predicted.iter().sum::<Vector2<f64>>() / predicted.len() as f64;
    let reach = predicted
        .iter()
        .map(|q| (q - centre).amax())
        .fold(f64::MIN_POSITIVE, f64::max);
    // Within -1..1 the powers stay of one size, and the normal matrix well conditioned.
    let design = DMatrix::from_fn(seen.len(), TERMS, |k, t| {
        let at = (predicted[k] - centre) / reach;
        at.x.powi(POWERS[t][0]) * at.y.powi(POWERS[t][1])
    });
    // Least squares in both coordinates with one design.
    let normal = (design.transpose() * &design).cholesky()?;
    let squares = (0..2)
        .map(|axis| {
            let off = DVector::from_fn(seen.len(), |k, _| seen[k].1[axis] - predicted[k][axis]);
            let by = normal.solve(&(design.transpose() * &off));
            (off - &design * by).norm_squared()
        })
        .sum();
    // Each coordinate loses its own ten terms; the sum is divided by corners, not by coordinates.
    Some((squares, seen.len() - TERMS))
}
