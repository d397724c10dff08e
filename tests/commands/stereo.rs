//! The picture commands as a user runs them, on ray-traced pictures of the bench (simulated by an
//! outside renderer).

use crate::support::copy::copy_folder;
use crate::support::{fixture, program};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::LazyLock;

fn bench_file(name: &str) -> PathBuf {
    fixture("stereo_bench").join(name)
}

fn wcal(arguments: &[&str]) -> (i32, Output, String) {
    let output = program().args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    (output.status.code().unwrap(), output, text)
}

/// Cameras and shapes that several tests read, made once: the fixture's pictures, and in each
/// folder a pair of which both files are empty. The board's pictures have no mark, the scene's are
/// marked as rendered.
struct Made {
    folder: PathBuf,
    /// Exit code, messages and document of `stereo-calibrate`.
    calibrated: (i32, String, Value),
    /// Exit code, standard output and messages of `stereo-shape`.
    shaped: (i32, Vec<u8>, String),
    shapes: Value,
}

impl Made {
    fn at(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }
}

fn made() -> &'static Made {
    static MADE: LazyLock<Made> = LazyLock::new(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("stereo-made");
        let _ = std::fs::remove_dir_all(&folder);
        let at = |name: &str| folder.join(name).display().to_string();
        for (kind, broken) in [("board", "99.png"), ("scene", "t9.png")] {
            for side in ["left", "right"] {
                let to = folder.join(kind).join(side);
                copy_folder(&bench_file(&format!("{kind}/{side}")), &to);
                std::fs::write(to.join(broken), b"").unwrap();
            }
        }
        let calibrate = [
            "stereo-calibrate",
            &at("board/left"),
            &at("board/right"),
            "--square-mm",
            "6",
        ];
        let more = ["--board", "9x6", "--out", &at("calibration"), "--json"];
        let (code, output, text) = wcal(&[&calibrate[..], &more].concat());
        let document =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
        let calibrated = (code, text, document);
        std::fs::copy(
            bench_file("scene/SIMULATED"),
            folder.join("scene/SIMULATED"),
        )
        .unwrap();
        let cameras = at("calibration/stereo.json");
        let shape = [
            "stereo-shape",
            &at("scene/left"),
            &at("scene/right"),
            "--cameras",
            &cameras,
        ];
        let more = ["--rig", &rig(), "--out", &at("shapes")];
        let (code, output, text) = wcal(&[&shape[..], &more].concat());
        let shapes = std::fs::read(folder.join("shapes/shapes.json"))
            .unwrap_or_else(|e| panic!("{e}: {text}"));
        let shapes = serde_json::from_slice(&shapes).unwrap();
        Made {
            folder,
            calibrated,
            shaped: (code, output.stdout, text),
            shapes,
        }
    });
    &MADE
}

fn rig() -> String {
    bench_file("rig.toml").display().to_string()
}

#[test]
fn board_pictures_become_cameras_and_empty_files_are_named() {
    let (code, text, document) = &made().calibrated;
    assert_eq!(*code, 3, "a pair was left out: {text}");
    assert!(text.contains("99") && text.contains("zero bytes"), "{text}");
    assert_eq!(document["format"], "wcal-stereo/1");
    assert!(document["rms_px"].as_f64().unwrap() < 0.03);
    assert!(
        !document["provenance"]["inputs"]
            .as_array()
            .unwrap()
            .is_empty()
    );
    assert!(
        document["provenance"].get("simulated").is_none() && !text.contains("SIMULATED"),
        "no mark"
    );
}

#[test]
fn a_wrong_board_is_refused_and_a_side_in_metres_is_asked_about() {
    let place = tempfile::tempdir().unwrap();
    let refused = place.path().join("refused").display().to_string();
    // As few pairs as a calibration takes: where no board is found, each picture is searched by
    // both finders.
    let names: Vec<_> = std::fs::read_dir(bench_file("board/left"))
        .unwrap()
        .map(|f| f.unwrap().file_name())
        .collect();
    let side = |side: &str| {
        let few = place.path().join(side);
        std::fs::create_dir(&few).unwrap();
        for name in names.iter().take(3) {
            std::fs::copy(bench_file("board").join(side).join(name), few.join(name)).unwrap();
        }
        few.display().to_string()
    };
    let (left, right) = (side("left"), side("right"));
    let calibrate = |side_mm: &str, board: &str| {
        let pictures = ["stereo-calibrate", &left, &right, "--square-mm", side_mm];
        wcal(&[&pictures[..], &["--board", board, "--out", &refused]].concat())
    };
    let (code, _, text) = calibrate("6", "8x6");
    assert_eq!(code, 1, "{text}");
    assert!(
        text.contains("board of 8x6") && text.contains("--board 9x6"),
        "{text}"
    );
    assert!(!Path::new(&refused).join("stereo.json").exists());
    assert_eq!(calibrate("6", "6").0, 2);
    let (code, _, text) = calibrate("0.006", "9x6");
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("6 mm"), "{text}");
    assert!(!Path::new(&refused).exists());
}

#[test]
fn scene_pictures_become_shapes_with_the_reason_of_each_rejected_pair() {
    let made = made();
    let (code, output, text) = &made.shaped;
    assert_eq!(*code, 3, "a pair was rejected: {text}");
    assert!(output.is_empty());
    for pair in made.shapes["pairs"].as_array().unwrap() {
        let broken = pair["name"] == "t9";
        assert_eq!(
            pair["status"],
            if broken { "rejected" } else { "ok" },
            "{pair}"
        );
        assert_eq!(
            broken,
            pair["why"].as_str().unwrap().contains("zero bytes"),
            "{pair}"
        );
    }
    let report = std::fs::read_to_string(made.at("shapes/report.html")).unwrap();
    let outside = report.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    assert!(
        report.contains("<canvas") && report.contains("zero bytes") && !outside.contains("://")
    );
    assert!(
        report.contains("SIMULATED") && text.contains("SIMULATED"),
        "{text}"
    );
    assert_eq!(made.shapes["provenance"]["simulated"], true);
}

#[test]
fn without_a_base_tag_in_any_pair_there_are_no_shapes() {
    let (place, made) = (tempfile::tempdir().unwrap(), made());
    let at = |name: &str| place.path().join(name).display().to_string();
    let other = std::fs::read_to_string(rig())
        .unwrap()
        .replace("id = 0", "id = 17");
    std::fs::write(at("other.toml"), other).unwrap();
    let cameras = made.at("calibration/stereo.json");
    let shape = [
        "stereo-shape",
        &made.at("scene/left"),
        &made.at("scene/right"),
        "--cameras",
        &cameras,
    ];
    let (code, _, text) = wcal(
        &[
            &shape[..],
            &["--rig", &at("other.toml"), "--out", &at("none")],
        ]
        .concat(),
    );
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("base tag"), "{text}");
}

/// The rest geometry that the shapes are of: drawn with 30, 20 and 60 mm; nominal here 29, 21 and
/// 61.
#[test]
fn shapes_become_the_rest_geometry_and_a_model() {
    let (place, made) = (tempfile::tempdir().unwrap(), made());
    let mut other: toml::Table = std::fs::read_to_string(rig()).unwrap().parse().unwrap();
    let nominal = other["whisker"].as_table_mut().unwrap();
    for (key, value) in [
        ("straight_mm", 29.0),
        ("arc_radius_mm", 21.0),
        ("length_mm", 61.0),
    ] {
        nominal.insert(key.to_owned(), value.into());
    }
    let at = |name: &str| place.path().join(name).display().to_string();
    std::fs::write(at("nominal.toml"), other.to_string()).unwrap();
    let whisker = at("whisker");
    let fit = [
        "fit-whisker",
        &made.at("shapes/shapes.json"),
        "--out",
        &whisker,
        "--json",
    ];
    let (code, output, text) = wcal(&[&fit[..], &["--rig", &at("nominal.toml")]].concat());
    assert_eq!(code, 3, "one shape was left out: {text}");
    assert!(
        text.contains("t9 is omitted: ") && text.contains("zero bytes"),
        "{text}"
    );
    let fitted: Value = serde_json::from_slice(&output.stdout).unwrap();
    let truth: Value =
        serde_json::from_slice(&std::fs::read(bench_file("truth.json")).unwrap()).unwrap();
    for (key, drawn, limit) in [
        ("straight_mm", "straight", 0.2),
        ("arc_radius_mm", "radius", 0.1),
        ("length_mm", "length", 0.2),
    ] {
        let off = fitted["whisker"][key].as_f64().unwrap() - truth["spec"][drawn].as_f64().unwrap();
        assert!(off.abs() < limit, "{key}: {off} mm off");
        // What all shapes share (cameras, light, the end's form) is in the sd.
        let k = fitted["fit"]["parameters"]
            .as_array()
            .unwrap()
            .iter()
            .position(|p| p == key)
            .unwrap();
        let by = |matrix: &str| fitted["fit"][matrix][k][k].as_f64().unwrap();
        let (sd, between) = (
            by("covariance").sqrt(),
            (by("covariance") - by("covariance_shared")).sqrt(),
        );
        println!("{key}: {off:.4} mm off, sd {sd:.4} mm, between shapes alone {between:.4} mm");
        assert!(off.abs() < 3.0 * sd, "{key}: {off} mm off, sd {sd}");
        // The end's form is common to all pictures: without it the length's sd would be a fraction.
        assert!(key != "length_mm" || sd > 2.0 * between, "{sd} {between}");
    }
    let written = std::fs::read_to_string(Path::new(&whisker).join("whisker.toml")).unwrap();
    let model = std::fs::read_to_string(Path::new(&whisker).join("whisker.xml")).unwrap();
    assert!(model.starts_with("<mujoco") && model.matches("<body ").count() == 41);
    let written: toml::Table = written.parse().unwrap();
    assert_eq!(written["format"].as_str(), Some("wcal-whisker/1"));
    // The model says what it was made from.
    let inputs = written["provenance"]["inputs"].as_array().unwrap();
    assert!(
        inputs.len() == 2
            && inputs
                .iter()
                .all(|i| model.contains(i["sha256"].as_str().unwrap()))
    );
}

#[test]
fn fit_whisker_refuses_other_documents_and_targets_that_no_wire_can_have() {
    let (place, made) = (tempfile::tempdir().unwrap(), made());
    let at = |name: &str| place.path().join(name).display().to_string();
    std::fs::write(at("none.json"), "{}").unwrap();
    let none = [
        "fit-whisker",
        &at("none.json"),
        "--out",
        &at("refused"),
        "--rig",
        &rig(),
    ];
    let (code, _, text) = wcal(&none);
    assert!(
        code == 1 && text.contains("none.json: expected shapes.json"),
        "{text}"
    );
    for (target, words) in [
        (
            ["--ripple-nmm", "nan"],
            "--ripple-nmm: expected 0 or more, found NaN",
        ),
        (
            ["--speed-bias", "-3"],
            "--speed-bias: expected a share between -1 and 1",
        ),
        (
            ["--bounce-ratio", "5"],
            "--bounce-ratio: expected above 0 and at most 1, found 5",
        ),
    ] {
        let shapes = made.at("shapes/shapes.json");
        let refused = [
            "fit-whisker",
            &shapes,
            "--rig",
            &rig(),
            "--out",
            &at("refused"),
            "--dynamics",
        ];
        let (code, _, text) = wcal(&[&refused[..], &target].concat());
        assert!(code == 1 && text.contains(words), "{text}");
        assert!(
            !place.path().join("refused").exists(),
            "{target:?} left something behind"
        );
    }
}

/// Calibrated from rendered pictures, the other tools' files say so; from others they do not.
#[test]
fn files_for_other_programs_say_where_pictures_are_rendered() {
    let (place, made) = (tempfile::tempdir().unwrap(), made());
    let at = |name: &str| place.path().join(name).display().to_string();
    copy_folder(&made.folder.join("board"), &place.path().join("board"));
    std::fs::copy(
        bench_file("scene/SIMULATED"),
        place.path().join("board/SIMULATED"),
    )
    .unwrap();
    let marked = at("marked");
    let (left, right) = (at("board/left"), at("board/right"));
    let (code, _, text) = wcal(&[
        "stereo-calibrate",
        &left,
        &right,
        "--square-mm",
        "6",
        "--board",
        "9x6",
        "--out",
        &marked,
    ]);
    assert_eq!(code, 3, "{text}");
    let exports = |folder: &str| {
        let files = std::fs::read_dir(folder)
            .unwrap()
            .map(|f| f.unwrap().path());
        let yaml = files.filter(|f| f.extension().is_some_and(|e| e == "yml" || e == "yaml"));
        yaml.map(|f| std::fs::read_to_string(f).unwrap())
            .collect::<Vec<_>>()
    };
    assert!(
        exports(&marked).len() == 4 && exports(&marked).iter().all(|f| f.contains("# SIMULATED"))
    );
    assert!(
        exports(&made.at("calibration"))
            .iter()
            .all(|f| !f.contains("SIMULATED")),
        "negative control"
    );
    // A reader of the other tool's file takes the remark as one.
    let cameras = at("marked/opencv.yml");
    let (rig, out) = (rig(), at("by-marked"));
    let (code, _, text) = wcal(&[
        "stereo-shape",
        &made.at("scene/left"),
        &made.at("scene/right"),
        "--cameras",
        &cameras,
        "--rig",
        &rig,
        "--out",
        &out,
    ]);
    assert_eq!(code, 3, "{text}");
}

/// The exported cameras give the same shapes, with a warning that their errors are not known.
#[test]
fn cameras_come_back_from_the_files_of_other_programs() {
    let (place, made) = (tempfile::tempdir().unwrap(), made());
    let at = |name: &str| place.path().join(name).display().to_string();
    let one = |shapes: &Value| -> Vec<f64> {
        let pair = shapes["pairs"]
            .as_array()
            .unwrap()
            .iter()
            .find(|p| p["name"] == "t1")
            .unwrap();
        pair["centreline_mm"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|p| p.as_array().unwrap())
            .map(|v| v.as_f64().unwrap())
            .collect()
    };
    for side in ["left", "right"] {
        copy_folder(
            &bench_file("board").join(side),
            &place.path().join("whole").join(side),
        );
    }
    let rig = rig();
    let export = |name: &str| made.at(&format!("calibration/{name}"));
    for cameras in [
        vec![export("opencv.yml")],
        vec![export("ros-left.yaml"), export("ros-right.yaml")],
    ] {
        let out = at("imported");
        let mut shape = vec![
            "stereo-shape".to_owned(),
            made.at("scene/left"),
            made.at("scene/right"),
            "--rig".into(),
            rig.clone(),
        ];
        shape.extend(["--out".into(), out.clone(), "--cameras".into()]);
        shape.extend(cameras.clone());
        let (code, _, text) = wcal(&shape.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(code == 3 && text.contains("camera uncertainties"), "{text}");
        let found: Value =
            serde_json::from_slice(&std::fs::read(Path::new(&out).join("shapes.json")).unwrap())
                .unwrap();
        let (found, expected) = (one(&found), one(&made.shapes));
        let off = found
            .iter()
            .zip(&expected)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(
            found.len() == expected.len() && off < 0.01,
            "{cameras:?}: {off} mm"
        );
    }
}

/// Moments that a wire of 68 GPa has at nine poses (SIMULATED by the rod), one of them wrong: the
/// modulus comes back, the wrong one is named.
#[test]
fn known_moments_give_the_stiffness_and_a_wrong_one_is_named() {
    let place = tempfile::tempdir().unwrap();
    let (shapes, rig) = (&made().at("shapes/shapes.json")[..], &rig()[..]);
    let at = |name: &str| place.path().join(name).to_str().unwrap().to_owned();
    std::fs::create_dir(at("moments")).unwrap();
    let mut session = "format = \"wcal-session/1\"\nid = \"moments\"\nkind = \"whisker\"\nmedium = \"air\"\n\
        [files]\npoints = \"points.csv\"\ntwin = \"twin.csv\"\n[whisker]\ndiameter_mm = 0.3\nlength_mm = 60.0\nstraight_mm = 30.0\n\
        arc_radius_mm = 20.0\nyoungs_gpa = 68.0\nshear_gpa = 25.568\n[fbg]\ntemperature_compensated = true\n"
        .to_owned();
    let mut points = "point,role,trajectory,stage_mm,groove_x_mm,groove_y_mm,groove_z_mm,fbg_1_shift_nm,fbg_2_shift_nm\n0,rest,,,,,,0,0\n".to_owned();
    for t in 1..=3 {
        let x = 15.0 + 5.0 * f64::from(t);
        let direction = [0.0, 0.6, if t == 2 { -0.8 } else { 0.8 }];
        session += &format!(
            "[[trajectory]]\nid = {t}\norigin_mm = [{x}, 0.0, 0.0]\ndirection = {direction:?}\n"
        );
        for k in 1..=3 {
            let s = 2.0 * f64::from(k);
            points += &format!(
                "{},calibration,{t},{s},{x},{},{},0.1,0.1\n",
                10 * t + k,
                0.6 * s,
                direction[2] * s
            );
        }
    }
    std::fs::write(at("moments/session.toml"), &session).unwrap();
    std::fs::write(at("moments/points.csv"), points).unwrap();
    std::fs::write(
        at("moments/twin.csv"),
        "point,moment_1_nmm,moment_2_nmm\n0,0,0\n",
    )
    .unwrap();
    let (code, _, text) = wcal(&[
        "twin",
        &at("moments"),
        "--engine",
        "rod",
        "--out",
        &at("rod.csv"),
    ]);
    assert_eq!(code, 0, "{text}");
    let rod = std::fs::read_to_string(at("rod.csv")).unwrap();
    let labels = |wrong: bool| {
        let mut lines = rod
            .lines()
            .map(|l| l.splitn(4, ',').take(3).collect::<Vec<_>>().join(","))
            .collect::<Vec<_>>();
        if wrong {
            let broken = lines.iter().position(|l| l.starts_with("22,")).unwrap();
            lines[broken] = "22,0.9,-0.7".to_owned();
        }
        std::fs::write(at("moments/twin.csv"), lines.join("\n") + "\n").unwrap();
        let fit = [
            "fit-whisker",
            shapes,
            "--rig",
            rig,
            "--moments",
            &at("moments"),
            "--json",
            "--out",
            &at("stiff"),
        ];
        let (_, output, text) = wcal(&fit);
        let json: Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
        (json["stiffness"].clone(), text)
    };
    for wrong in [false, true] {
        let (found, text) = labels(wrong);
        let [e, sd] = ["youngs_gpa", "sd_gpa"].map(|k| found[k].as_f64().unwrap());
        println!("Young's modulus {e:.3} GPa, sd {sd:.3}, wrong label: {wrong}");
        assert!(
            (e - 68.0).abs() < (3.0 * sd).max(0.05) && sd < 0.5,
            "{found}"
        );
        assert_eq!(found["points"], if wrong { 8 } else { 9 }, "{found}");
        assert_eq!(text.contains("point 22"), wrong, "{text}");
    }
    let written = std::fs::read_to_string(at("stiff/whisker.toml")).unwrap();
    assert!(written.contains("youngs_gpa = 6"), "{written}");
    // A session without known moments is told so.
    std::fs::write(
        at("moments/session.toml"),
        session.replace("twin = \"twin.csv\"\n", ""),
    )
    .unwrap();
    let (code, _, text) = wcal(&[
        "fit-whisker",
        shapes,
        "--rig",
        rig,
        "--moments",
        &at("moments"),
        "--out",
        &at("stiff"),
    ]);
    assert!(code == 1 && text.contains("known moments"), "{text}");
}

/// A rig with other lines, in a folder of its own.
fn rig_with(changes: &[(&str, &str)]) -> (tempfile::TempDir, String) {
    let place = tempfile::tempdir().unwrap();
    let mut text = std::fs::read_to_string(rig()).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    let path = place.path().join("rig.toml");
    std::fs::write(&path, text).unwrap();
    let rig = path.display().to_string();
    (place, rig)
}

/// Shapes of two folders with a rig.
fn shapes_with(left: &str, right: &str, rig: &str) -> (i32, String, Value) {
    let cameras = made().at("calibration/stereo.json");
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("out").display().to_string();
    let (code, _, text) = wcal(&[
        "stereo-shape",
        left,
        right,
        "--cameras",
        &cameras,
        "--rig",
        rig,
        "--out",
        &out,
    ]);
    let shapes = std::fs::read(Path::new(&out).join("shapes.json"));
    (
        code,
        text,
        shapes.map_or(Value::Null, |s| serde_json::from_slice(&s).unwrap()),
    )
}

/// End of the centre line of a pair, mm.
fn tip(shapes: &Value, name: &str) -> Vec<f64> {
    let pair = shapes["pairs"]
        .as_array()
        .unwrap()
        .iter()
        .find(|p| p["name"] == name)
        .unwrap();
    let line = pair["centreline_mm"]
        .as_array()
        .unwrap_or_else(|| panic!("{pair}"));
    line.last()
        .unwrap()
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}

#[test]
fn a_tag_side_that_is_stated_wrongly_is_named_and_the_shapes_stay_right() {
    let scene = bench_file("scene");
    let (left, right) = (
        scene.join("left").display().to_string(),
        scene.join("right").display().to_string(),
    );
    let (code, text, control) = shapes_with(&left, &right, &rig());
    assert!(code == 0 && !text.contains("tag size"), "{text}");
    const SIDE: &str = "size_mm = 10.0";
    let both = [(SIDE, "size_mm = 10.1"), (SIDE, "size_mm = 10.1")];
    let base = [(SIDE, "size_mm = 12.5")];
    let held = [(
        "size_mm = 10.0\nbody = \"rig\"",
        "size_mm = 9.0\nbody = \"rig\"",
    )];
    for (changes, named, all) in [
        (&both[..], &["0", "1"][..], true),
        (&base, &["0"], false),
        (&held, &["1"], false),
    ] {
        let (_place, rig) = rig_with(changes);
        let (code, text, shapes) = shapes_with(&left, &right, &rig);
        assert_eq!(code, 3, "{text}");
        for id in ["0", "1"] {
            let line = format!("tag size: tag36h11 {id} has a side of ");
            assert_eq!(
                text.contains(&line),
                named.contains(&id),
                "{changes:?}: {text}"
            );
        }
        assert!(!text.contains("rig tag turns"), "{text}");
        assert_eq!(text.contains("the cameras' scale is right"), all, "{text}");
        for name in ["rest", "t1", "t5"] {
            let off: Vec<f64> = tip(&shapes, name)
                .iter()
                .zip(tip(&control, name))
                .map(|(a, b)| a - b)
                .collect();
            assert!(
                off.iter().all(|d| d.abs() < 0.02),
                "{changes:?}, {name}: {off:?} mm"
            );
        }
    }
}

#[test]
fn a_pair_that_mixes_two_poses_is_left_out_by_its_length() {
    let place = tempfile::tempdir().unwrap();
    let [left, right] = ["left", "right"].map(|side| {
        let to = place.path().join(side);
        copy_folder(&bench_file("scene").join(side), &to);
        to
    });
    // Without a rig tag only the wire tells that the pictures show two poses.
    let text = std::fs::read_to_string(rig()).unwrap();
    let rig = place.path().join("rig.toml").display().to_string();
    std::fs::write(&rig, &text[..text.find("[[tags]]\nid = 1").unwrap()]).unwrap();
    std::fs::copy(left.join("rest.png"), left.join("x.png")).unwrap();
    std::fs::copy(right.join("t5.png"), right.join("x.png")).unwrap();
    let [left, right] = [left, right].map(|p| p.display().to_string());
    let (code, text, shapes) = shapes_with(&left, &right, &rig);
    assert_eq!(code, 3, "{text}");
    for pair in shapes["pairs"].as_array().unwrap() {
        let mixed = pair["name"] == "x";
        assert_eq!(
            pair["status"],
            if mixed { "rejected" } else { "ok" },
            "{pair}"
        );
        assert_eq!(
            mixed,
            pair["why"].as_str().unwrap().contains("other pairs"),
            "{pair}"
        );
    }
}

#[test]
fn a_tag_that_a_rig_states_twice_counts_once_or_is_refused() {
    let scene = bench_file("scene");
    let (left, right) = (
        scene.join("left").display().to_string(),
        scene.join("right").display().to_string(),
    );
    let text = std::fs::read_to_string(rig()).unwrap();
    let second = &text[text.find("[[tags]]\nid = 1").unwrap()..text.find("[groove]").unwrap()];
    let (_place, twice) = rig_with(&[("[groove]", &format!("{second}[groove]"))]);
    let (code, text, shapes) = shapes_with(&left, &right, &twice);
    assert!(code == 3 && text.contains("tag36h11 1"), "{text}");
    let (_, _, control) = shapes_with(&left, &right, &rig());
    assert_eq!(tip(&shapes, "t1"), tip(&control, "t1"));
    let other = second.replace("10.0", "8.0");
    let (_place, contradictory) = rig_with(&[("[groove]", &format!("{other}[groove]"))]);
    let (code, text, _) = shapes_with(&left, &right, &contradictory);
    assert!(
        code == 1 && text.contains("tag36h11 1") && text.contains("8"),
        "{text}"
    );
}
