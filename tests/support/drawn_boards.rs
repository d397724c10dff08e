//! Boards drawn in pairs of small pictures (SIMULATED): pinhole cameras without distortion, 4x4
//! points a pixel, a blur of the neighbours, noise.

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::path::Path;
use wcal_vision::calibrate::board::TagOrder;
use wcal_vision::tags::apriltag_ffi::draw_tag;

const WIDTH: usize = 560;
const HEIGHT: usize = 420;
const FOCAL_PX: f64 = 640.0;
const SUB: usize = 4;

/// Grey value of a printed board at a place on it, mm from its middle, x right, y down; none beyond
/// its edge.
pub(crate) type Print = Box<dyn Fn(f64, f64) -> Option<u8> + Sync>;

/// Squares of this side (mm) with this many inner corners, stretched along the columns.
pub(crate) fn chessboard([columns, rows]: [usize; 2], side_mm: f64, stretch: f64) -> Print {
    let [width, height] = [columns + 1, rows + 1].map(|n| n as f64 * side_mm);
    Box::new(move |x, y| {
        let (u, v) = (x + 0.5 * width, y / stretch + 0.5 * height);
        if u < -8.0 || v < -8.0 || u > width + 8.0 || v > height + 8.0 {
            return None;
        }
        let inside = (0.0..width).contains(&u) && (0.0..height).contains(&v);
        let dark = inside && ((u / side_mm) as usize + (v / side_mm) as usize).is_multiple_of(2);
        Some(if dark { 40 } else { 210 })
    })
}

/// 4 x 3 upright tags of 26 mm with gaps of 7.8 mm, numbered in this order.
pub(crate) fn april_grid(order: TagOrder) -> Print {
    grid_of(order, std::array::from_fn(|k| k as u32))
}

/// The same with tags of other numbers.
pub(crate) fn grid_of(order: TagOrder, numbers: [u32; 12]) -> Print {
    let tags = numbers.map(|number| draw_tag("tag36h11", number).unwrap());
    Box::new(move |x, y| {
        let (u, v) = (x / 33.8 + 1.5, y / 33.8 + 1.0);
        if !(-0.7..3.7).contains(&u) || !(-0.7..2.7).contains(&v) {
            return None;
        }
        let (column, row) = (u.round().clamp(0.0, 3.0), v.round().clamp(0.0, 2.0));
        let i = if order.from_right {
            3.0 - column
        } else {
            column
        } as usize;
        let j = if order.from_top { row } else { 2.0 - row } as usize;
        let tag = &tags[if order.by_columns {
            3 * i + j
        } else {
            4 * j + i
        }];
        // Ten cells with the white margin, eight between the corners.
        let cell = |d: f64| (d * 33.8 / 26.0 * 8.0 + 5.0).floor();
        let (p, q) = (cell(u - column), cell(v - row));
        let inside = (0.0..10.0).contains(&p) && (0.0..10.0).contains(&q);
        let dark = inside && tag.data[q as usize * tag.width + p as usize] < 128;
        Some(if dark { 40 } else { 210 })
    })
}

/// Poses of a board before the left camera, tilted to all sides; `roll`: share of the rolls that
/// tell fx from fy.
pub(crate) fn tilted(roll: f64) -> Vec<Isometry3<f64>> {
    (0..8)
        .map(|k| {
            let t = f64::from(k);
            let tilt = Vector3::new(0.45 * (1.9 * t).sin(), 0.45 * (1.1 * t + 1.0).cos(), 0.0);
            let turn = UnitQuaternion::from_axis_angle(
                &Vector3::z_axis(),
                roll * (0.9 * (2.3 * t).sin() + 0.07),
            );
            let (x, y) = (24.0 + 12.0 * (1.3 * t).sin(), 10.0 * (2.1 * t).cos());
            let place = Vector3::new(x, y, 240.0 + 20.0 * (0.7 * t).sin());
            Isometry3::from_parts(place.into(), UnitQuaternion::from_scaled_axis(tilt) * turn)
        })
        .collect()
}

/// Writes the pairs into `left` and `right` of a folder as 40.pgm and following.
pub(crate) fn write_pairs(
    folder: &Path,
    print: &Print,
    views: &[Isometry3<f64>],
    right_from_left: &Isometry3<f64>,
) {
    for side in ["left", "right"] {
        std::fs::create_dir_all(folder.join(side)).unwrap();
    }
    views.par_iter().enumerate().for_each(|(k, left)| {
        for (camera, side) in ["left", "right"].into_iter().enumerate() {
            let pose = if camera == 0 {
                *left
            } else {
                right_from_left * left
            };
            let data = drawn(print, &pose, (2 * k + camera) as u64);
            let mut bytes = format!("P5\n{WIDTH} {HEIGHT}\n255\n").into_bytes();
            bytes.extend(data);
            std::fs::write(folder.join(side).join(format!("{}.pgm", 40 + k)), bytes).unwrap();
        }
    });
}

fn drawn(print: &Print, camera_from_board: &Isometry3<f64>, seed: u64) -> Vec<u8> {
    let turn = camera_from_board.rotation.to_rotation_matrix();
    let at = camera_from_board.translation.vector;
    let (cx, cy) = (0.5 * WIDTH as f64 - 0.5, 0.5 * HEIGHT as f64 - 0.5);
    let k = Matrix3::new(FOCAL_PX, 0.0, cx, 0.0, FOCAL_PX, cy, 0.0, 0.0, 1.0);
    let plane = Matrix3::from_columns(&[
        turn.matrix().column(0).into(),
        turn.matrix().column(1).into(),
        at,
    ]);
    let back = (k * plane).try_inverse().unwrap();
    let m: [f64; 9] = std::array::from_fn(|i| back[(i / 3, i % 3)]);
    let level = |x: f64, y: f64| {
        let w = m[6] * x + m[7] * y + m[8];
        let (u, v) = (
            (m[0] * x + m[1] * y + m[2]) / w,
            (m[3] * x + m[4] * y + m[5]) / w,
        );
        f64::from(print(u, v).unwrap_or(120))
    };
    let mut sharp = vec![0.0; WIDTH * HEIGHT];
    for (p, value) in sharp.iter_mut().enumerate() {
        let (x, y) = ((p % WIDTH) as f64, (p / WIDTH) as f64);
        let ends = [
            level(x - 0.5, y - 0.5),
            level(x + 0.5, y - 0.5),
            level(x - 0.5, y + 0.5),
            level(x + 0.5, y + 0.5),
        ];
        *value = ends[0];
        if ends.iter().any(|e| *e != ends[0]) {
            let step = |s: usize| (s as f64 + 0.5) / SUB as f64 - 0.5;
            let all = (0..SUB * SUB).map(|s| level(x + step(s % SUB), y + step(s / SUB)));
            *value = all.sum::<f64>() / (SUB * SUB) as f64;
        }
    }
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let blurred = |p: usize| {
        let at =
            |q: isize| sharp[(p as isize + q).clamp(0, (WIDTH * HEIGHT - 1) as isize) as usize];
        let row = |q: isize| 0.25 * at(q - 1) + 0.5 * at(q) + 0.25 * at(q + 1);
        let w = WIDTH as isize;
        0.25 * row(-w) + 0.5 * row(0) + 0.25 * row(w)
    };
    (0..WIDTH * HEIGHT)
        .map(|p| {
            // A uniform draw of 10 DN on either side: sd 5.8 DN.
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let draw = (state >> 40) as f64 / (1u64 << 24) as f64;
            (blurred(p) + 20.0 * draw - 10.0).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}
