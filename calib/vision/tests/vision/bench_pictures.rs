//! The whole way on ray-traced pictures of the bench (simulated by an outside renderer): against
//! what was drawn.

use crate::common;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use serde_json::Value;
use std::path::Path;
use std::sync::OnceLock;
use wcal_core::shapes_document::ShapesDocument;
use wcal_vision::calibrate::board::{Board, Pattern};
use wcal_vision::calibrate::chessboard::BoardSize;
use wcal_vision::calibrate::folders::calibrate_folders;
use wcal_vision::camera::OPENCV5;
use wcal_vision::pairs::{list_pictures, pair_files};
use wcal_vision::picture::Picture;
use wcal_vision::rig::Rig;
use wcal_vision::shape::folder::shapes_of_pairs;
use wcal_vision::stereo::StereoCameras;

fn folder(name: &str) -> String {
    common::fixture("stereo_bench")
        .join(name)
        .display()
        .to_string()
}

/// The cameras, calibrated once from the board pictures.
fn stereo() -> &'static StereoCameras {
    static CAMERAS: OnceLock<StereoCameras> = OnceLock::new();
    CAMERAS.get_or_init(|| {
        let board = Board {
            size: BoardSize {
                columns: 9,
                rows: 6,
            },
            square_mm: 6.0,
            pattern: Pattern::Chessboard,
        };
        let (document, _) = calibrate_folders(
            &folder("board/left"),
            &folder("board/right"),
            &board,
            OPENCV5,
            &|_| {},
        )
        .unwrap();
        document.stereo_cameras().unwrap()
    })
}

fn rig_text() -> String {
    std::fs::read_to_string(folder("rig.toml")).unwrap()
}

fn truth() -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder("truth.json")).unwrap()).unwrap()
}

fn run_on(left: &str, right: &str, rig_text: &str) -> ShapesDocument {
    let rig = Rig::parse("rig.toml", rig_text).unwrap();
    let files = pair_files(
        &list_pictures(left).unwrap(),
        &list_pictures(right).unwrap(),
    )
    .unwrap();
    shapes_of_pairs(stereo(), &rig, &files, &|_| {}).document
}

fn run(rig_text: &str) -> ShapesDocument {
    run_on(&folder("scene/left"), &folder("scene/right"), rig_text)
}

fn pose(rows: &Value) -> Isometry3<f64> {
    let m = |r: usize, c: usize| rows[r][c].as_f64().unwrap();
    let turn = Matrix3::from_fn(m);
    Isometry3::from_parts(
        Vector3::from_fn(|r, _| m(r, 3)).into(),
        UnitQuaternion::from_matrix(&turn),
    )
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_iterator(v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()))
}

#[test]
fn wire_tip_and_groove_lie_where_they_were_drawn_and_a_wrong_rig_is_noticed() {
    let (rig, truth) = (rig_text(), truth());
    let shapes = run(&rig);
    assert_eq!(shapes.pairs.len(), 3);
    let (mut inside, mut all) = (0, 0);
    for pair in &shapes.pairs {
        assert_eq!(pair.status, "ok", "{}: {}", pair.name, pair.why);
        let t = truth["scene"]
            .as_array()
            .unwrap()
            .iter()
            .find(|t| t["name"] == pair.name.as_str())
            .unwrap();
        let line: Vec<Vector3<f64>> = t["centreline"]
            .as_array()
            .unwrap()
            .iter()
            .map(vector)
            .collect();
        let found: Vec<Vector3<f64>> = pair
            .centreline_mm
            .iter()
            .map(|p| Vector3::from(*p))
            .collect();
        // Drawn points, not the chords between them, against the curve; the sd is the 95 % radius
        // across the wire over 2.4477.
        all += line.len();
        let inside_region = |p: &&Vector3<f64>| {
            let near =
                |a: &usize, b: &usize| (found[*a] - *p).norm().total_cmp(&(found[*b] - *p).norm());
            let nearest = (0..found.len()).min_by(near).unwrap();
            common::distance(p, &found) <= 2.4477 * pair.centreline_sd_mm[nearest]
        };
        inside += line.iter().filter(inside_region).count();
        let rows: Vec<[f64; 4]> = pair.left_from_base.clone();
        let found_pose = pose(&serde_json::to_value(rows).unwrap());
        let off = pose(&truth["cameras"]["left"]["T"]) * found_pose;
        let (shift, turn) = (
            off.translation.vector.norm(),
            off.rotation.angle().to_degrees(),
        );
        assert!(
            shift <= 0.03 && turn <= 0.05,
            "{}: base {shift} mm, {turn} deg",
            pair.name
        );
        let rms = (found
            .iter()
            .map(|p| common::distance(p, &line).powi(2))
            .sum::<f64>()
            / found.len() as f64)
            .sqrt();
        assert!(rms <= 0.03, "{}: wire {rms} mm", pair.name);
        let tip = (found.last().unwrap() - line.last().unwrap()).norm();
        assert!(tip <= 0.05, "{}: tip {tip} mm", pair.name);
        if let (Some(g), Some(drawn)) = (&pair.groove, t["groove"].as_object()) {
            let d = (Vector3::from(g.position_mm) - vector(&drawn["position"])).norm();
            assert!(d <= 0.05, "{}: groove {d} mm", pair.name);
            let arc = g.contact_arclength_mm - drawn["contact_arclength"].as_f64().unwrap();
            assert!(arc.abs() <= 0.1, "{}: contact {arc} mm", pair.name);
            assert_eq!(g.contact, "vertex");
        }
    }
    assert!(
        inside as f64 >= 0.95 * all as f64,
        "{inside} of {all} inside the stated region"
    );
    // Negative control: a base tag that is said to stand 1 mm off is noticed, not silently
    // believed.
    let wrong = run(&rig.replace("[0, 0, 1, -9]", "[0, 0, 1, -10]"));
    assert!(
        wrong.warnings.iter().any(|w| w.contains("disagree")),
        "{:?}",
        wrong.warnings
    );
}

#[test]
fn without_the_base_tag_a_pair_is_rejected_with_the_reason() {
    for (from, to, wanted) in [
        ("id = 0", "id = 17", "tag36h11 17"),
        ("tag36h11", "tag25h9", "tag25h9 0"),
    ] {
        for pair in &run(&rig_text().replace(from, to)).pairs {
            assert_eq!(pair.status, "rejected");
            assert!(
                pair.why
                    .contains(&format!("expected the base tag ({wanted})")),
                "{}",
                pair.why
            );
        }
    }
}

/// The picture with all but the part about its base tag painted grey: the tag stays, the wire is
/// gone.
fn without_wire(side: &str, name: &str, tag: &[[f64; 2]; 4]) -> Picture {
    let mut picture =
        Picture::read(Path::new(&folder(&format!("scene/{side}/{name}.png")))).unwrap();
    let range = |d: usize| {
        let v = tag.map(|c| c[d]);
        let (lo, hi) = v
            .iter()
            .fold((f64::MAX, f64::MIN), |(a, b), &x| (a.min(x), b.max(x)));
        (lo - 14.0)..(hi + 14.0)
    };
    let (columns, rows) = (range(0), range(1));
    for k in 0..picture.data.len() {
        let (x, y) = ((k % picture.width) as f64, (k / picture.width) as f64);
        if !(columns.contains(&x) && rows.contains(&y)) {
            // A little speckle, so that the picture is no dead plane.
            picture.data[k] = 150 + ((k * 2_654_435_761) >> 7 & 3) as u8;
        }
    }
    picture
}

#[test]
fn bad_pairs_are_rejected_with_their_reasons_and_the_batch_goes_on() {
    let place = tempfile::tempdir().unwrap();
    let sides = ["left", "right"].map(|s| place.path().join(s));
    let seen = run(&rig_text());
    let rest = seen.pairs.iter().find(|p| p.name == "rest").unwrap();
    for (side, path) in ["left", "right"].iter().zip(&sides) {
        std::fs::create_dir(path).unwrap();
        std::fs::copy(
            folder(&format!("scene/{side}/rest.png")),
            path.join("good.png"),
        )
        .unwrap();
        let tag = rest
            .tags
            .iter()
            .find(|t| t.id == 0 && t.camera == *side)
            .unwrap();
        common::write_pgm(
            &path.join("nowire.pgm"),
            &without_wire(side, "rest", &tag.corners_px),
        );
        common::write_pgm(
            &path.join("black.pgm"),
            &Picture::new(1280, 960, vec![0; 1280 * 960]).unwrap(),
        );
        common::write_pgm(
            &path.join("white.pgm"),
            &Picture::new(1280, 960, vec![255; 1280 * 960]).unwrap(),
        );
        let photo = common::fixture("apriltag_images").join("33369213973_9d9bb4cc96_c.jpg");
        std::fs::copy(photo, path.join("colour.jpg")).unwrap();
        common::write_pgm(
            &path.join("small.pgm"),
            &Picture::new(64, 48, (0..3072).map(|k| k as u8).collect()).unwrap(),
        );
        std::fs::copy(folder("scene/left/t1.png"), path.join("twice.png")).unwrap();
        let sixteen = [&b"P5\n1280 960\n65535\n"[..], &vec![7; 2 * 1280 * 960]].concat();
        std::fs::write(path.join("sixteen.pgm"), sixteen).unwrap();
        let whole = std::fs::read(folder(&format!("scene/{side}/t1.png"))).unwrap();
        std::fs::write(path.join("torn.png"), &whole[..whole.len() / 2]).unwrap();
        std::fs::write(
            path.join("empty.png"),
            if *side == "left" { &b""[..] } else { &b"x"[..] },
        )
        .unwrap();
    }
    // Left and right pictures exchanged: the base tag fits no pose that both cameras share.
    std::fs::copy(folder("scene/right/t5.png"), sides[0].join("swapped.png")).unwrap();
    std::fs::copy(folder("scene/left/t5.png"), sides[1].join("swapped.png")).unwrap();
    std::fs::copy(folder("scene/left/t5.png"), sides[0].join("alone.png")).unwrap();
    let text = |p: &Path| p.display().to_string();
    let shapes = run_on(&text(&sides[0]), &text(&sides[1]), &rig_text());
    for (name, word) in [
        ("nowire", "no wire"),
        ("black", "no contrast"),
        ("white", "saturated"),
        ("colour", "as calibrated"),
        ("small", "1280x960"),
        ("twice", "the same"),
        ("sixteen", "no contrast"),
        ("torn", "cut off"),
        ("empty", "zero bytes"),
        ("alone", "right picture is missing"),
        ("swapped", "swapped"),
    ] {
        let pair = shapes.pairs.iter().find(|p| p.name == name).unwrap();
        assert_eq!(pair.status, "rejected", "{name}");
        assert!(pair.why.contains(word), "{name}: {}", pair.why);
        assert!(pair.centreline_mm.is_empty());
    }
    let good = shapes.pairs.iter().find(|p| p.name == "good").unwrap();
    assert_eq!(good.status, "ok", "{}", good.why);
}
