//! Pictures and files that cannot be used: one clear reason each, the rest of the batch goes on.

use crate::common;
use wcal_vision::calibrate::board::{Board, Pattern};
use wcal_vision::calibrate::chessboard::BoardSize;
use wcal_vision::calibrate::document::StereoDocument;
use wcal_vision::calibrate::folders::calibrate_folders;
use wcal_vision::calibrate::import::read_cameras;
use wcal_vision::camera::OPENCV5;
use wcal_vision::picture::Picture;

fn board() -> Board {
    Board {
        size: BoardSize {
            columns: 9,
            rows: 6,
        },
        square_mm: 1.0,
        pattern: Pattern::Chessboard,
    }
}

fn copy_pairs(to: &std::path::Path, names: &[&str]) {
    for name in names {
        for side in ["left", "right"] {
            let file = format!("{side}{name}.jpg");
            std::fs::copy(
                common::fixture("opencv_stereo_chessboard").join(&file),
                to.join(&file),
            )
            .unwrap();
        }
    }
}

fn run(folder: &std::path::Path) -> Result<StereoDocument, String> {
    let side = |s: &str| folder.join(format!("{s}*")).display().to_string();
    calibrate_folders(&side("left"), &side("right"), &board(), OPENCV5, &|_| {})
        .map(|r| r.0)
        .map_err(|e| e.to_string())
}

#[test]
fn each_bad_picture_costs_its_own_pair_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    copy_pairs(
        path,
        &["01", "02", "03", "04", "05", "06", "07", "08", "09"],
    );
    std::fs::write(path.join("left01.jpg"), b"").unwrap();
    let bytes = std::fs::read(path.join("right02.jpg")).unwrap();
    std::fs::write(path.join("right02.jpg"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::remove_file(path.join("right03.jpg")).unwrap();
    std::fs::copy(path.join("left04.jpg"), path.join("right04.jpg")).unwrap();
    let document = run(path).unwrap();
    let why = |name: &str| {
        document
            .rejected_views
            .iter()
            .find(|r| r.view == name)
            .map(|r| r.why.clone())
            .unwrap_or_default()
    };
    assert!(why("left01").contains("zero bytes"), "{}", why("left01"));
    assert!(why("left02").contains("cut off"), "{}", why("left02"));
    assert!(why("left03").contains("missing"), "{}", why("left03"));
    assert!(why("left04").contains("same"), "{}", why("left04"));
    assert_eq!(document.views.len(), 5);
}

/// A picture of the fixture with a change to its pixels, written as PGM in place of the JPEG.
fn changed(folder: &std::path::Path, name: &str, change: impl Fn(&mut Picture)) {
    let jpeg = folder.join(format!("{name}.jpg"));
    let mut picture = Picture::read(&jpeg).unwrap();
    change(&mut picture);
    std::fs::remove_file(&jpeg).unwrap();
    common::write_pgm(&folder.join(format!("{name}.pgm")), &picture);
}

#[test]
fn every_kind_of_unusable_view_is_named_and_the_rest_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    copy_pairs(
        path,
        &[
            "01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14",
        ],
    );
    changed(path, "left01", |p| {
        let half: Vec<u8> = p
            .data
            .chunks(p.width)
            .step_by(2)
            .flat_map(|r| r.iter().copied().step_by(2))
            .collect();
        *p = Picture::new(p.width / 2, p.height / 2, half).unwrap();
    });
    // 16 bits a pixel.
    let sixteen: Vec<u8> = [b"P5\n640 480\n65535\n".to_vec(), vec![7; 2 * 640 * 480]].concat();
    std::fs::remove_file(path.join("left02.jpg")).unwrap();
    std::fs::write(path.join("left02.pgm"), sixteen).unwrap();
    let photo = common::fixture("apriltag_images").join("33369213973_9d9bb4cc96_c.jpg");
    std::fs::copy(photo, path.join("right03.jpg")).unwrap();
    changed(path, "left04", |p| p.data.fill(255));
    changed(path, "right05", |p| p.data.fill(0));
    // No board: a plain gradient. A board that is cut off: its right part is painted over.
    changed(path, "left06", |p| {
        p.data = (0..640 * 480).map(|k| (k % 640 / 4) as u8 + 40).collect()
    });
    changed(path, "left07", |p| {
        p.data.chunks_mut(640).for_each(|r| r[330..].fill(120))
    });
    for side in ["left", "right"] {
        std::fs::copy(
            path.join(format!("{side}14.jpg")),
            path.join(format!("{side}15.jpg")),
        )
        .unwrap();
    }
    let document = run(path).unwrap();
    for (name, word) in [
        ("left01", "different sizes"),
        ("left02", "no contrast"),
        ("left03", "different sizes"),
        ("left04", "saturated"),
        ("left05", "no contrast"),
        ("left06", "no board"),
        ("left07", "cut off"),
        ("left15", "shares a picture with left14"),
    ] {
        let found = document.rejected_views.iter().find(|r| r.view == name);
        let why = found.map_or("not rejected", |r| r.why.as_str());
        assert!(why.contains(word), "{name}: {why}");
    }
    assert_eq!(document.views.len(), 6, "{:?}", document.rejected_views);
}

#[test]
fn one_view_only_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    copy_pairs(folder.path(), &["01"]);
    let why = run(folder.path()).unwrap_err();
    assert!(
        why.contains("at least 3 pairs") && why.contains("1 of 1"),
        "{why}"
    );
}

#[test]
fn a_folder_without_pictures_and_a_missing_one_are_named() {
    let folder = tempfile::tempdir().unwrap();
    assert!(run(folder.path()).unwrap_err().contains("no such picture"));
    assert!(
        run(&folder.path().join("nowhere"))
            .unwrap_err()
            .contains("nowhere")
    );
}

#[test]
fn black_and_white_pictures_are_told_apart_and_colours_become_grey() {
    let flat = |v: u8| Picture::new(40, 30, vec![v; 1200]).unwrap();
    assert!(flat(0).unusable().unwrap().contains("no contrast"));
    assert!(flat(255).unusable().unwrap().contains("saturated"));
    let photo = common::fixture("apriltag_images").join("33369213973_9d9bb4cc96_c.jpg");
    let grey = Picture::read(&photo).unwrap();
    let colours = image::open(&photo).unwrap().into_rgb8();
    assert!(
        colours.pixels().any(|p| p[0].abs_diff(p[2]) > 60),
        "control: the photograph is coloured"
    );
    for (pixel, value) in colours.pixels().zip(&grey.data) {
        let luma =
            0.299 * f64::from(pixel[0]) + 0.587 * f64::from(pixel[1]) + 0.114 * f64::from(pixel[2]);
        assert!(
            (luma - f64::from(*value)).abs() <= 0.51,
            "{pixel:?} became {value}"
        );
    }
    assert!(Picture::new(3, 3, vec![0; 8]).is_err());
}

#[test]
fn a_broken_stereo_json_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stereo.json");
    for (text, word) in [
        ("", "none of these"),
        ("{}", "wcal-stereo/1"),
        ("{\"format\": 3}", "wcal-stereo/1"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = read_cameras(std::slice::from_ref(&path))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(word) && error.contains("stereo.json"),
            "{error}"
        );
    }
}
