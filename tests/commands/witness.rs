//! The plant's cameras and the picture commands: what the program finds in pictures of a bench that
//! shares no code with it (SIMULATED).

use crate::support::{code_and_messages, fixture};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;
use std::path::Path;
use wcal_bench::cameras::{
    Appearance, CameraFaults, Groove, Lens, RigGeometry, View, clean, default_pair, exposed,
};
use wcal_bench::rod::Wire;
use wcal_bench::table::{Path as GroovePath, equilibrium};

type V3 = Vector3<f64>;

const SIZE: [usize; 2] = [640, 480];

/// What was drawn of a pose.
struct Pose {
    groove_mm: V3,
    arclength_mm: f64,
    line_mm: Vec<V3>,
    view: View,
}

/// Three pushes of the bench's own wire: near the root, on the bend, out on the arc; toward and
/// away from the cameras.
fn poses(rig: &RigGeometry) -> Vec<Pose> {
    let wire = Wire::new(0.3, 60.0, 30.0, 20.0, 75.0, 28.2);
    let pushes = [
        (18.0, V3::new(0.0, 0.0, 1.0), 4.0),
        (31.0, V3::new(0.025, 0.866, 0.499), 7.0),
        (45.0, V3::new(0.341, -0.866, 0.366), 9.0),
    ];
    pushes
        .iter()
        .map(|(s, direction, depth_mm)| {
            let (origin_mm, _) = wire.rest(*s);
            let direction = direction.normalize();
            let path = GroovePath {
                origin_mm,
                direction,
                arclength_mm: *s,
                offset_mm: V3::zeros(),
            };
            let at = path.at(*depth_mm);
            let found = equilibrium(&wire, &path, 0.4 * s, *depth_mm).unwrap();
            let line_mm = wire.centre_line(Some((&at, &found)), 0.25);
            let groove = Groove {
                position_mm: at,
                axis: found.tangent,
                push: direction,
            };
            let view = rig.scene(line_mm.clone(), Some(&groove));
            Pose {
                groove_mm: at,
                arclength_mm: found.arclength_mm,
                line_mm,
                view,
            }
        })
        .collect()
}

/// Draws one pair into `folder`/left and right.
fn draw(folder: &Path, name: &str, cameras: &[Lens; 2], view: &View, look: &Appearance, seed: u64) {
    for (k, (side, lens)) in ["left", "right"].iter().zip(cameras).enumerate() {
        let grey = exposed(&clean(lens, view, look), look, 2 * seed + k as u64);
        let place = folder.join(side);
        std::fs::create_dir_all(&place).unwrap();
        let bytes = [
            format!("P5 {} {} 255\n", SIZE[0], SIZE[1]).as_bytes(),
            &grey,
        ]
        .concat();
        std::fs::write(place.join(format!("{name}.pgm")), bytes).unwrap();
    }
    std::fs::write(folder.join("SIMULATED"), "").unwrap();
}

/// How far the program is from the truth: greatest error of the groove, of the contact's arc
/// length, RMS of the centre line, mm; or its words.
fn judged(rig: &RigGeometry, moved: Isometry3<f64>, look: &Appearance) -> Result<[f64; 3], String> {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let cameras = default_pair(SIZE);
    for k in 0..12 {
        draw(
            &place.path().join("board"),
            &k.to_string(),
            &cameras,
            &rig.board_view(k),
            &Appearance::default(),
            k as u64,
        );
    }
    let poses = poses(rig);
    let later = [cameras[0].clone(), cameras[1].moved(&moved)];
    for (k, pose) in poses.iter().enumerate() {
        draw(
            &place.path().join("scene"),
            &k.to_string(),
            &later,
            &pose.view,
            look,
            100 + k as u64,
        );
    }
    let (left, right, out) = (at("board/left"), at("board/right"), at("cameras"));
    let board = ["--board", "9x6", "--square-mm", "6", "--out", &out];
    let (code, text) =
        code_and_messages(&[&["stereo-calibrate", &left, &right][..], &board].concat());
    assert!(code == 0 || code == 3, "{text}");
    let rig_file = fixture("stereo_bench/rig.toml");
    let (left, right, shapes) = (at("scene/left"), at("scene/right"), at("shapes"));
    let stereo = at("cameras/stereo.json");
    let rest = [
        "--cameras",
        &stereo,
        "--rig",
        rig_file.to_str().unwrap(),
        "--out",
        &shapes,
    ];
    let (code, text) = code_and_messages(&[&["stereo-shape", &left, &right][..], &rest].concat());
    if code == 1 {
        return Err(text);
    }
    assert!(text.contains("SIMULATED"), "{text}");
    let document: Value =
        serde_json::from_slice(&std::fs::read(Path::new(&shapes).join("shapes.json")).unwrap())
            .unwrap();
    let mut worst = [0.0_f64; 3];
    for (pair, pose) in document["pairs"].as_array().unwrap().iter().zip(&poses) {
        if pair["status"] != "ok" {
            return Err(pair["why"].to_string());
        }
        let vector = |v: &Value| V3::from_iterator((0..3).map(|k| v[k].as_f64().unwrap()));
        let groove = (vector(&pair["groove"]["by_tag_mm"]) - pose.groove_mm).norm();
        let arc = pair["groove"]["contact_arclength_mm"].as_f64().unwrap() - pose.arclength_mm;
        let squares: Vec<f64> = pair["centreline_mm"]
            .as_array()
            .unwrap()
            .iter()
            .map(|p| distance(&vector(p), &pose.line_mm).powi(2))
            .collect();
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        println!(
            "groove {groove:.4} mm, arc length {:.4} mm, centre line RMS {rms:.4} mm",
            arc.abs()
        );
        for (w, v) in worst.iter_mut().zip([groove, arc.abs(), rms]) {
            *w = w.max(v);
        }
    }
    Ok(worst)
}

fn distance(p: &V3, line: &[V3]) -> f64 {
    let to = |w: &[V3]| {
        let run = w[1] - w[0];
        let share = ((p - w[0]).dot(&run) / run.norm_squared()).clamp(0.0, 1.0);
        (p - w[0] - run * share).norm()
    };
    line.windows(2).map(to).fold(f64::INFINITY, f64::min)
}

fn good(found: &Result<[f64; 3], String>) -> bool {
    found
        .as_ref()
        .is_ok_and(|[groove, arc, rms]| *groove < 0.05 && *arc < 0.1 && *rms < 0.05)
}

fn shift(mm: [f64; 3], deg: [f64; 3]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(V3::from(deg).map(f64::to_radians));
    Isometry3::from_parts(Translation3::from(mm), turn)
}

#[test]
fn the_program_finds_the_plants_wire_and_groove() {
    let found = judged(
        &RigGeometry::default(),
        Isometry3::identity(),
        &Appearance::default(),
    );
    assert!(good(&found), "{found:?}");
}

#[test]
fn moved_cameras_wrong_boards_askew_tags_and_overexposure_show() {
    let (rig, look) = (RigGeometry::default(), Appearance::default());
    let with = |faults: CameraFaults| RigGeometry {
        faults,
        ..RigGeometry::default()
    };
    let none = CameraFaults::default();
    let still = Isometry3::identity();
    let board = with(CameraFaults {
        board_scale: 1.01,
        ..none
    });
    let askew = with(CameraFaults {
        rig_tag_moved: shift([0.1, 0.0, 0.0], [0.0, 0.0, 0.5]),
        ..none
    });
    let bright = Appearance {
        exposure_dn: 3.0 * look.exposure_dn,
        ..look
    };
    for (name, found) in [
        (
            "moved camera",
            judged(&rig, shift([0.3, 0.0, 0.0], [0.0, 0.1, 0.0]), &look),
        ),
        ("board of 6.06 mm", judged(&board, still, &look)),
        ("askew tag", judged(&askew, still, &look)),
        ("overexposed", judged(&rig, still, &bright)),
    ] {
        println!("{name}: {found:?}");
        assert!(!good(&found), "{name}: {found:?}");
    }
}
