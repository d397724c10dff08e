//! Chessboards that look alike after half a turn: the order of their corners is arbitrary in each picture, and pairs have to agree on it.
//!
//! ```text
//! T = argmin over v, o of median over w of min over o' of RMS_k |px_w,o'(k) - pi(T T_left,w p_k)|,   T_v,o = T_right,v F_o T_left,v^-1
//! ```
//! with F the half turn about the board's middle, for which the order o of the right corners is reversed. As boards are held differently, only the
//! right orders give one relative pose of the cameras.

use crate::calibrate::bundle::BoardView;
use crate::calibrate::initial::{Corners, calibrate_alone, median, view_rms};
use crate::calibrate::statements::Optics;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

/// Of every view whether the right corners run from the other end than the left ones; none where no order is better than that found.
pub(crate) fn half_turned(
    points: &[Vector3<f64>],
    views: &[BoardView],
    (image_size, lens): Optics,
) -> Option<Vec<bool>> {
    let sides: [Vec<Corners>; 2] =
        [views.iter().map(|v| v.left.clone()).collect(), views.iter().map(|v| v.right.clone()).collect()];
    let alone = |k: usize| calibrate_alone(points, &sides[k], image_size, lens).ok();
    let (left, right) = (alone(0)?, alone(1)?);
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let half = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    let turn = Isometry3::from_parts((middle - half * middle).into(), half);
    // RMS of each view in both orders, by one relative pose.
    let errors = |relative: &Isometry3<f64>| -> Vec<[f64; 2]> {
        let one = |w: usize, reversed: bool| {
            let pose = relative * left.camera_from_board[w];
            let seen: Box<dyn Iterator<Item = _>> =
                if reversed { Box::new(sides[1][w].iter().rev()) } else { Box::new(sides[1][w].iter()) };
            let off: Vec<_> = seen
                .zip(points)
                .map(|(c, p)| Some((*c)? - right.camera.project(&(pose * Point3::from(*p)).coords)?))
                .collect();
            view_rms(&off)
        };
        (0..views.len()).map(|w| [one(w, false), one(w, true)]).collect()
    };
    let relative = |v: usize, reversed: bool| {
        let board = if reversed { turn } else { Isometry3::identity() };
        right.camera_from_board[v] * board * left.camera_from_board[v].inverse()
    };
    let best = (0..views.len())
        .flat_map(|v| [false, true].map(|reversed| errors(&relative(v, reversed))))
        .min_by(|a, b| {
            let least = |e: &[[f64; 2]]| median(&e.iter().map(|e| e[0].min(e[1])).collect::<Vec<_>>());
            least(a).total_cmp(&least(b))
        })?;
    let reversed: Vec<bool> = best.iter().map(|e| e[1] < e[0]).collect();
    reversed.contains(&true).then_some(reversed)
}
