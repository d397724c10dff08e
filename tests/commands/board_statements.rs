//! What `stereo-calibrate` says of boards that are not what is stated, on pictures drawn here
//! (SIMULATED): each mistake is named with the option that mends it, and the same pictures with the
//! right statement pass without a word.

use crate::support::drawn_boards::{Print, april_grid, chessboard, grid_of, tilted, write_pairs};
use crate::support::program;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::Value;
use std::path::Path;
use wcal_vision::calibrate::board::TagOrder;

/// Distance of the cameras as drawn, mm.
const BASELINE_MM: f64 = 60.0;

fn right_from_left() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.12, 0.0));
    Isometry3::from_parts((turn * Vector3::new(-BASELINE_MM, 0.0, 0.0)).into(), turn)
}

/// The right camera mounted upside down.
fn upside_down() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    Isometry3::from_parts(Vector3::zeros().into(), turn) * right_from_left()
}

/// Pairs of a board in a folder of their own.
fn pictured(print: &Print, views: &[Isometry3<f64>], right: &Isometry3<f64>) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_pairs(folder.path(), print, views, right);
    folder
}

/// Exit code, messages, and `stereo.json` where there is one.
fn calibrate(folder: &Path, arguments: &[&str]) -> (i32, String, Option<Value>) {
    let [left, right, out] = ["left", "right", "out"].map(|n| folder.join(n).display().to_string());
    let output = program()
        .args(["stereo-calibrate", &left, &right, "--force", "--out", &out])
        .args(arguments)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    let document = std::fs::read(Path::new(&out).join("stereo.json")).ok();
    let _ = std::fs::remove_dir_all(&out);
    (
        output.status.code().unwrap(),
        text,
        document.map(|d| serde_json::from_slice(&d).unwrap()),
    )
}

fn baseline_mm(document: &Value) -> f64 {
    let row = |k: usize| document["right_from_left"][k][3].as_f64().unwrap();
    Vector3::new(row(0), row(1), row(2)).norm()
}

/// The right statement passes without a word and gives the baseline that was drawn.
fn passes(folder: &Path, arguments: &[&str]) {
    let (code, text, document) = calibrate(folder, arguments);
    assert_eq!(code, 0, "{arguments:?}: {text}");
    let document = document.unwrap();
    let baseline = baseline_mm(&document);
    assert!(
        (baseline - BASELINE_MM).abs() < 0.3,
        "{baseline} mm: {text}"
    );
    let [rms, noise] = ["rms_px", "corner_noise_px"].map(|k| document[k].as_f64().unwrap());
    assert!(rms < 1.2 * noise, "RMS {rms} px, noise {noise} px");
}

/// Another statement is not taken in silence, and the words name it.
fn is_named(folder: &Path, arguments: &[&str], words: &[&str]) {
    let (code, text, _) = calibrate(folder, arguments);
    assert!(code == 3 || code == 1, "{arguments:?}: exit {code}: {text}");
    for word in words {
        assert!(
            text.contains(word),
            "{arguments:?}: expected \"{word}\": {text}"
        );
    }
}

const GRID: [&str; 2] = ["--pattern", "aprilgrid"];

fn grid<'a>(board: &'a str, side: &'a str, gap: &'a str) -> Vec<&'a str> {
    [
        &GRID[..],
        &["--board", board, "--square-mm", side, "--marker-mm", gap],
    ]
    .concat()
}

#[test]
fn sides_gaps_and_numbers_of_tags_that_are_stated_wrongly_are_named() {
    let folder = pictured(
        &april_grid(TagOrder::default()),
        &tilted(1.0),
        &right_from_left(),
    );
    let folder = folder.path();
    passes(folder, &grid("4x3", "26", "7.8"));
    is_named(
        folder,
        &grid("4x3", "33.8", "7.8"),
        &["does not fit", "--square-mm 26", "own noise"],
    );
    is_named(
        folder,
        &grid("4x3", "26", "33.8"),
        &["does not fit", "--marker-mm 7.8"],
    );
    is_named(
        folder,
        &grid("4x3", "26", "0.3"),
        &["does not fit", "--marker-mm 7.8", "share of the side"],
    );
    is_named(
        folder,
        &grid("4x3", "7.8", "26"),
        &["does not fit", "--square-mm 26 --marker-mm 7.8"],
    );
    is_named(
        folder,
        &grid("4x3", "26", "6.5"),
        &["does not fit", "gaps of 7.8"],
    );
    is_named(
        folder,
        &grid("3x4", "26", "7.8"),
        &["does not fit", "--board 4x3"],
    );
    is_named(
        folder,
        &grid("5x3", "26", "7.8"),
        &["does not fit", "4 columns"],
    );
    // No picture shows a factor that all sizes have in common: it is said what the scale follows.
    let (code, text, document) = calibrate(folder, &grid("4x3", "26.26", "7.878"));
    assert!(code == 0 && text.contains("26.26 mm"), "{text}");
    assert!((baseline_mm(&document.unwrap()) / BASELINE_MM - 1.01).abs() < 0.005);
}

#[test]
fn tags_that_are_turned_against_their_numbers_are_named_with_the_order_that_fits() {
    let (name, order) = TagOrder::all()
        .find(|o| o.0 == "aprilgrid-columns-from-upper-left")
        .unwrap();
    let folder = pictured(&april_grid(order), &tilted(1.0), &right_from_left());
    let stated = grid("4x3", "26", "7.8");
    is_named(
        folder.path(),
        &stated,
        &["does not fit", &format!("--pattern {name}")],
    );
    passes(
        folder.path(),
        &[&["--pattern", name], &stated[2..]].concat(),
    );
}

#[test]
fn a_tag_that_is_printed_twice_counts_once() {
    let numbers = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 5];
    let folder = pictured(
        &grid_of(TagOrder::default(), numbers),
        &tilted(1.0),
        &right_from_left(),
    );
    let (code, text, document) = calibrate(folder.path(), &grid("4x3", "26", "7.8"));
    assert!(code == 3 && text.contains("tag 5"), "{text}");
    assert!(!text.contains("does not fit"), "{text}");
    assert!((baseline_mm(&document.unwrap()) - BASELINE_MM).abs() < 0.3);
}

const CHESS: [&str; 4] = ["--board", "7x6", "--square-mm", "14"];

#[test]
fn a_stretched_print_is_named_or_said_to_be_undecided() {
    let square = pictured(
        &chessboard([7, 6], 14.0, 1.0),
        &tilted(1.0),
        &right_from_left(),
    );
    passes(square.path(), &CHESS);
    let rolled = pictured(
        &chessboard([7, 6], 14.0, 1.02),
        &tilted(1.0),
        &right_from_left(),
    );
    is_named(
        rolled.path(),
        &CHESS,
        &["does not fit", "longer along its columns", "own noise"],
    );
    // Boards that are all held upright: fx and fy take most of the stretch up, and the residuals
    // hardly show it.
    let upright = pictured(
        &chessboard([7, 6], 14.0, 1.01),
        &tilted(0.0),
        &right_from_left(),
    );
    is_named(
        upright.path(),
        &CHESS,
        &["fy/fx is 1.0", "longer along its columns"],
    );
}

/// Corners that are counted as squares, one side by one too many, and tags of another family: said
/// from two pictures, before all are searched.
#[test]
fn another_board_is_named_with_the_option_that_states_it() {
    let folder = pictured(
        &chessboard([7, 6], 14.0, 1.0),
        &tilted(1.0),
        &right_from_left(),
    );
    for board in ["8x7", "7x5", "6x6"] {
        is_named(
            folder.path(),
            &["--board", board, "--square-mm", "14"],
            &["7x6 inner corners", "--board 7x6"],
        );
    }
    let folder = pictured(
        &april_grid(TagOrder::default()),
        &tilted(1.0),
        &right_from_left(),
    );
    let family = [&grid("4x3", "26", "7.8")[..], &["--dictionary", "tag25h9"]].concat();
    is_named(
        folder.path(),
        &family,
        &["none of tag25h9", "--dictionary tag36h11"],
    );
}

/// Boards that are only shifted: no tilt tells the focal length from the distance.
#[test]
fn boards_that_are_all_parallel_are_not_taken_in_silence() {
    let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.03, 0.0));
    let flat: Vec<_> = tilted(1.0)
        .iter()
        .map(|pose| Isometry3::from_parts(pose.translation, tilt))
        .collect();
    let folder = pictured(&chessboard([7, 6], 14.0, 1.0), &flat, &right_from_left());
    is_named(folder.path(), &CHESS, &["nearly parallel", "tilt them"]);
}

#[test]
fn a_camera_upside_down_is_taken_unless_the_board_looks_alike_after_half_a_turn() {
    let unique = pictured(&chessboard([7, 6], 14.0, 1.0), &tilted(1.0), &upside_down());
    passes(unique.path(), &CHESS);
    let alike = ["--board", "7x7", "--square-mm", "13"];
    let print = chessboard([7, 7], 13.0, 1.0);
    passes(
        pictured(&print, &tilted(1.0), &right_from_left()).path(),
        &alike,
    );
    let (code, text, document) = calibrate(
        pictured(&print, &tilted(1.0), &upside_down()).path(),
        &alike,
    );
    assert!(
        code == 1 && text.contains("looks alike after half a turn") && document.is_none(),
        "{text}"
    );
}

#[test]
fn cameras_that_are_swapped_are_still_remarked_on() {
    let swapped = pictured(
        &chessboard([7, 6], 14.0, 1.0),
        &tilted(1.0),
        &right_from_left().inverse(),
    );
    is_named(swapped.path(), &CHESS, &["swapped cameras"]);
}

/// Names as a recorder with two cameras writes them, files of macOS beside them, and colours.
#[test]
fn pictures_come_as_other_programs_write_them() {
    let folder = pictured(
        &chessboard([7, 6], 14.0, 1.0),
        &tilted(1.0),
        &right_from_left(),
    );
    let other = tempfile::tempdir().unwrap();
    for (camera, side) in ["left", "right"].into_iter().enumerate() {
        let to = other.path().join(side);
        std::fs::create_dir(&to).unwrap();
        for entry in std::fs::read_dir(folder.path().join(side)).unwrap() {
            let path = entry.unwrap().path();
            let number = path.file_stem().unwrap().to_str().unwrap();
            let grey = std::fs::read(&path).unwrap();
            let header = grey
                .iter()
                .enumerate()
                .filter(|(_, b)| **b == b'\n')
                .nth(2)
                .unwrap()
                .0
                + 1;
            let size = String::from_utf8(grey[2..header].to_vec()).unwrap();
            // Blue walls and yellow light: green is the darkest of what the grey value is made of.
            let colours = grey[header..]
                .iter()
                .flat_map(|v| [*v, v.saturating_sub(9), *v]);
            let bytes: Vec<u8> = format!("P6{size}")
                .into_bytes()
                .into_iter()
                .chain(colours)
                .collect();
            std::fs::write(to.join(format!("IMG_000{number}_{camera}.ppm")), bytes).unwrap();
            std::fs::write(
                to.join(format!("._IMG_000{number}_{camera}.ppm")),
                b"\0\x05\x16\x07",
            )
            .unwrap();
        }
    }
    passes(folder.path(), &CHESS);
    passes(other.path(), &CHESS);
}
