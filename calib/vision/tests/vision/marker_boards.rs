//! ChArUco boards and AprilGrids, whole and partly hidden, on drawn pictures (simulated): the
//! cameras come back as drawn.

use crate::common;
use crate::common::bench::cameras;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector2, Vector3};
use opencv::aruco::{CharucoBoard, get_predefined_dictionary_i32};
use opencv::core::{Mat, Size};
use opencv::prelude::*;
use rayon::prelude::*;
use wcal_vision::calibrate::board::{Board, Pattern, TagOrder};
use wcal_vision::calibrate::chessboard::BoardSize;
use wcal_vision::calibrate::document::StereoDocument;
use wcal_vision::calibrate::folders::calibrate_folders;
use wcal_vision::camera::Camera;
use wcal_vision::camera::OPENCV5;
use wcal_vision::tags::apriltag_ffi::draw_tag;

const WIDTH: usize = 1280;
const HEIGHT: usize = 960;
const PAIRS: u64 = 6;

/// Grey value of a printed board at a place on it (mm from its middle, x right, y down), 255 beyond
/// its edge.
type Print = Box<dyn Fn(Vector2<f64>) -> f64 + Sync>;

/// OpenCV's own drawing of its board of 10 x 7 squares of 6 mm.
fn charuco() -> Print {
    let dictionary = get_predefined_dictionary_i32(0).unwrap();
    let mut board = CharucoBoard::create(10, 7, 6.0, 4.4, &dictionary).unwrap();
    const PX_A_MM: f64 = 20.0;
    let (width, height) = (60.0 * PX_A_MM, 42.0 * PX_A_MM);
    let mut mat = Mat::default();
    board
        .draw(Size::new(width as i32, height as i32), &mut mat, 0, 1)
        .unwrap();
    let pixels = mat.data_bytes().unwrap().to_vec();
    Box::new(move |p| {
        let (u, v) = (p.x * PX_A_MM + 0.5 * width, p.y * PX_A_MM + 0.5 * height);
        let inside = (0.0..width).contains(&u) && (0.0..height).contains(&v);
        if inside {
            f64::from(pixels[v as usize * width as usize + u as usize])
        } else {
            255.0
        }
    })
}

/// 5 x 4 upright tags of 9 mm with gaps of 3 mm; the first number at the lower left as in Kalibr's
/// grids, whose border may be of two cells and whose gaps cross in black squares then.
fn april_grid(first: u32, wide_border: bool) -> Print {
    let (family, cells) = if wide_border {
        ("tag36h11-border2", 10.0)
    } else {
        ("tag36h11", 8.0)
    };
    let tags: Vec<_> = (first..first + 20)
        .map(|k| draw_tag(family, k).unwrap())
        .collect();
    Box::new(move |p| {
        let (x, y) = (p.x + 2.0 * 12.0, -p.y + 1.5 * 12.0);
        let crossing = |d: f64| ((d / 12.0 - 0.5) - (d / 12.0 - 0.5).round()).abs() < 1.5 / 12.0;
        if wide_border && crossing(x) && crossing(y) {
            return 0.0;
        }
        let (column, row) = ((x / 12.0).round(), (y / 12.0).round());
        if !(0.0..5.0).contains(&column) || !(0.0..4.0).contains(&row) {
            return 255.0;
        }
        // With the white margin there are two cells more than between the corners.
        let cell = |d: f64| (d / 9.0 * cells + 0.5 * cells + 1.0).floor();
        let (u, v) = (cell(x - column * 12.0), cell(row * 12.0 - y));
        let inside = (0.0..cells + 2.0).contains(&u) && (0.0..cells + 2.0).contains(&v);
        let tag = &tags[row as usize * 5 + column as usize];
        if inside {
            f64::from(tag.data[v as usize * tag.width + u as usize])
        } else {
            255.0
        }
    })
}

fn right_from_left() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.414, 0.02));
    Isometry3::from_parts(Vector3::new(-118.0, 2.0, 25.0).into(), turn)
}

/// Where every pixel's centre meets the board, mm.
fn on_board(eye: &Camera, pose: &Isometry3<f64>) -> Vec<Vector2<f64>> {
    (0..WIDTH * HEIGHT)
        .map(|k| common::on_plane(eye, pose, (k % WIDTH) as f64, (k / WIDTH) as f64).unwrap())
        .collect()
}

/// Place on the board within a pixel, by its slopes there.
fn between(places: &[Vector2<f64>], x: f64, y: f64) -> Vector2<f64> {
    let (i, j) = (
        (x.round() as usize).min(WIDTH - 2),
        (y.round() as usize).min(HEIGHT - 2),
    );
    let here = places[j * WIDTH + i];
    let (right, below) = (
        places[j * WIDTH + i + 1] - here,
        places[(j + 1) * WIDTH + i] - here,
    );
    here + right * (x - i as f64) + below * (y - j as f64)
}

/// Writes pairs of a board that tilts and moves; every third is partly hidden by a grey card.
fn write_pairs(folder: &std::path::Path, print: &Print) {
    (0..PAIRS).into_par_iter().for_each(|k| {
        let t = k as f64;
        // Always turned a little: six samples a pixel would put edges along the rows off by up to a
        // twelfth of one.
        let tilt = Vector3::new(
            0.4 * (1.9 * t).sin(),
            0.4 * (1.1 * t + 1.0).cos() - 0.2,
            0.1 * t + 0.1,
        );
        let place = Vector3::new(
            4.0 * (1.3 * t).sin(),
            4.0 * (2.1 * t).cos(),
            280.0 + 12.0 * (0.7 * t).sin(),
        );
        let left = Isometry3::from_parts(place.into(), UnitQuaternion::from_scaled_axis(tilt));
        for (camera, side) in ["left", "right"].into_iter().enumerate() {
            let pose = if camera == 0 {
                left
            } else {
                right_from_left() * left
            };
            let places = on_board(&cameras()[camera], &pose);
            let picture = common::draw(WIDTH, HEIGHT, 0.75, 1.2, 10 * k + camera as u64, |x, y| {
                let p = between(&places, x, y);
                if p.x.abs() > 34.0 || p.y.abs() > 26.0 || (k % 3 == 0 && p.x > 14.0) {
                    return 120.0;
                }
                35.0 + 0.65 * print(p)
            });
            common::write_pgm(&folder.join(format!("{side}{k:02}.pgm")), &picture);
        }
    });
}

fn calibrated(folder: &std::path::Path, board: &Board) -> Result<StereoDocument, String> {
    let side = |s: &str| folder.join(format!("{s}*")).display().to_string();
    calibrate_folders(&side("left"), &side("right"), board, OPENCV5, &|_| {})
        .map(|r| r.0)
        .map_err(|e| e.to_string())
}

fn assert_as_drawn(document: &StereoDocument) {
    assert_eq!(
        document.views.len(),
        PAIRS as usize,
        "{:?}",
        document.rejected_views
    );
    assert!(document.rms_px < 0.06, "{}", document.rms_px);
    for (found, drawn) in document.cameras.iter().zip(cameras()) {
        let focal = found.k[0][0];
        assert!(
            (focal - drawn.focal_px[0]).abs() < 0.002 * focal,
            "{focal} against {}",
            drawn.focal_px[0]
        );
    }
    let m = document.right_from_left;
    let found = Matrix3::from_fn(|i, j| m[i][j]);
    let truth = right_from_left();
    let turned = truth.rotation.to_rotation_matrix().matrix().transpose() * found;
    let angle = ((turned.trace() - 1.0) / 2.0).clamp(-1.0, 1.0).acos();
    assert!(angle < 3e-3, "{angle} rad");
    let base = Vector3::new(m[0][3], m[1][3], m[2][3]);
    assert!(
        (base.norm() - truth.translation.vector.norm()).abs() < 0.2,
        "{base}"
    );
}

#[test]
fn a_charuco_board_that_is_partly_hidden_calibrates_both_cameras() {
    let folder = tempfile::tempdir().unwrap();
    write_pairs(folder.path(), &charuco());
    let board =
        |marker_mm: f64, dictionary: &str| charuco_board([9, 6], marker_mm, dictionary, false);
    assert_as_drawn(&calibrated(folder.path(), &board(4.4, "DICT_4X4_50")).unwrap());
    // The square's side as the marker's, another marker: the ratio of both contradicts the
    // pictures.
    for (marker_mm, contradicted) in [(4.4, false), (4.5, false), (3.2, true), (5.5, true)] {
        let warnings = calibrated(folder.path(), &board(marker_mm, "DICT_4X4_50"))
            .unwrap()
            .warnings;
        let found = warnings
            .iter()
            .any(|w| w.contains("one of --square-mm and --marker-mm is wrong"));
        assert_eq!(found, contradicted, "{marker_mm}: {warnings:?}");
    }
    // Negative controls: markers of another dictionary, markers larger than their squares.
    let why = calibrated(folder.path(), &board(4.4, "DICT_6X6_250")).unwrap_err();
    assert!(why.contains("found 0"), "{why}");
    assert!(
        calibrated(folder.path(), &board(6.5, "DICT_4X4_50"))
            .unwrap_err()
            .contains("smaller")
    );
    assert!(
        calibrated(folder.path(), &board(4.4, "DICT_9X9"))
            .unwrap_err()
            .contains("DICT_4X4_50")
    );
}

fn charuco_board(
    [columns, rows]: [usize; 2],
    marker_mm: f64,
    dictionary: &str,
    legacy: bool,
) -> Board {
    Board {
        size: BoardSize { columns, rows },
        square_mm: 6.0,
        pattern: Pattern::Charuco {
            marker_mm,
            dictionary: dictionary.into(),
            legacy,
        },
    }
}

/// A board of 9 x 6 squares as OpenCV drew it before 4.6: the first square is light, the markers'
/// numbers run through the light squares.
fn legacy_charuco() -> Print {
    let dictionary = get_predefined_dictionary_i32(0).unwrap();
    const SIDE: usize = 44;
    let markers: Vec<Vec<u8>> = (0..27)
        .map(|id| {
            let mut mat = Mat::default();
            opencv::aruco::draw_marker(&dictionary, id, SIDE as i32, &mut mat, 1).unwrap();
            mat.data_bytes().unwrap().to_vec()
        })
        .collect();
    Box::new(move |p| {
        let (u, v) = (p.x / 6.0 + 4.5, p.y / 6.0 + 3.0);
        if !(0.0..9.0).contains(&u) || !(0.0..6.0).contains(&v) {
            return 255.0;
        }
        let (column, row) = (u as usize, v as usize);
        if (column + row) % 2 == 1 {
            return 0.0;
        }
        let within = |d: f64| ((d.fract() - 0.5) * 6.0 / 4.4 + 0.5) * SIDE as f64;
        let (x, y) = (within(u), within(v));
        let inside = (0.0..SIDE as f64).contains(&x) && (0.0..SIDE as f64).contains(&y);
        let before = (0..row).map(|r| 5 - r % 2).sum::<usize>() + column / 2;
        if inside {
            f64::from(markers[before][y as usize * SIDE + x as usize])
        } else {
            255.0
        }
    })
}

#[test]
fn charuco_boards_of_another_layout_are_named() {
    let folder = tempfile::tempdir().unwrap();
    write_pairs(folder.path(), &legacy_charuco());
    let stated = |size: [usize; 2], legacy: bool| charuco_board(size, 4.4, "DICT_4X4_50", legacy);
    let named = |board: &Board| match calibrated(folder.path(), board) {
        Ok(document) => document.warnings.join(" "),
        Err(why) => why,
    };
    let as_drawn = calibrated(folder.path(), &stated([8, 5], true)).unwrap();
    assert_as_drawn(&as_drawn);
    assert!(
        !as_drawn.warnings.iter().any(|w| w.contains("does not fit")),
        "{:?}",
        as_drawn.warnings
    );
    let why = named(&stated([8, 5], false));
    assert!(
        why.contains("does not fit") && why.contains("--pattern charuco-legacy"),
        "{why}"
    );
    let why = named(&stated([5, 8], false));
    assert!(
        why.contains("does not fit") && why.contains("--board 8x5"),
        "{why}"
    );
    // Another dictionary's numbers are no board.
    let why = named(&charuco_board([8, 5], 4.4, "DICT_5X5_50", true));
    assert!(why.contains("found 0 of 6 pairs"), "{why}");
}

#[test]
fn an_april_grid_that_is_partly_hidden_calibrates_both_cameras() {
    let folder = tempfile::tempdir().unwrap();
    write_pairs(folder.path(), &april_grid(0, false));
    let board = |gap_mm: f64| Board {
        size: BoardSize {
            columns: 5,
            rows: 4,
        },
        square_mm: 9.0,
        pattern: Pattern::AprilGrid {
            gap_mm,
            family: "tag36h11".into(),
            order: TagOrder::default(),
        },
    };
    assert_as_drawn(&calibrated(folder.path(), &board(3.0)).unwrap());
    // Negative control: a gap stated wrongly fits no cameras, or not well.
    let wrong = calibrated(folder.path(), &board(4.0));
    assert!(wrong.is_err() || wrong.unwrap().rms_px > 0.5);
}

/// As `kalibr_create_target_pdf` prints it, numbered from 40: nobody has to say either.
#[test]
fn a_grid_of_kalibr_with_other_numbers_calibrates_both_cameras() {
    let folder = tempfile::tempdir().unwrap();
    write_pairs(folder.path(), &april_grid(40, true));
    let board = |columns, first| Board {
        size: BoardSize { columns, rows: 4 },
        square_mm: 9.0,
        pattern: Pattern::AprilGrid {
            gap_mm: 3.0,
            family: "tag36h11".into(),
            order: TagOrder {
                first,
                ..TagOrder::default()
            },
        },
    };
    let stated = calibrated(folder.path(), &board(5, 40)).unwrap();
    assert_as_drawn(&stated);
    assert!(
        !stated.warnings.iter().any(|w| w.contains("first-tag")),
        "{:?}",
        stated.warnings
    );
    let found = calibrated(folder.path(), &board(5, 0)).unwrap();
    assert_as_drawn(&found);
    assert!(
        found
            .warnings
            .iter()
            .any(|w| w.contains("taken as --first-tag 40")),
        "{:?}",
        found.warnings
    );
    // Negative control: numbers that fit no board of the stated size are named.
    let why = calibrated(folder.path(), &board(4, 0)).unwrap_err();
    assert!(
        why.contains("tags 40 to 59 are seen") && why.contains("--first-tag"),
        "{why}"
    );
}
