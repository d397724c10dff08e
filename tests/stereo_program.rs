//! The picture commands as a user runs them, on ray-traced pictures of the bench (simulated by an outside renderer).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that fails should say where")]

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/stereo_bench").join(name)
}

fn wcal(arguments: &[&str]) -> (i32, Output, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_wcal")).args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    (output.status.code().unwrap(), output, text)
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
    }
}

#[test]
fn board_pictures_to_cameras_to_shapes_with_broken_files_among_them() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    for (kind, broken) in [("board", "99.png"), ("scene", "t9.png")] {
        for side in ["left", "right"] {
            let to = place.path().join(kind).join(side);
            copy_folder(&fixture(&format!("{kind}/{side}")), &to);
            std::fs::write(to.join(broken), b"").unwrap();
        }
    }
    let (left, right) = (at("board/left"), at("board/right"));
    let board = ["stereo-calibrate", &left, &right, "--square-mm", "6", "--board"];

    let refused = at("refused");
    let (code, _, text) = wcal(&[&board[..], &["8x6", "--out", &refused]].concat());
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("wrong board size"), "{text}");
    assert!(!Path::new(&refused).join("stereo.json").exists());
    assert_eq!(wcal(&[&board[..], &["6", "--out", &refused]].concat()).0, 2);

    let calibration = at("calibration");
    let (code, output, text) = wcal(&[&board[..], &["9x6", "--out", &calibration, "--json"]].concat());
    assert_eq!(code, 3, "a pair was left out: {text}");
    assert!(text.contains("99") && text.contains("zero bytes"), "{text}");
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["format"], "wcal-stereo/1");
    assert!(document["rms_px"].as_f64().unwrap() < 0.03);
    assert!(!document["provenance"]["inputs"].as_array().unwrap().is_empty());

    let (cameras, rig, out) =
        (format!("{calibration}/stereo.json"), fixture("rig.toml").display().to_string(), at("shapes"));
    let shape = ["stereo-shape", &at("scene/left"), &at("scene/right"), "--cameras", &cameras, "--out", &out];
    let (code, output, text) = wcal(&[&shape[..], &["--rig", &rig, "--overlays", "--report"]].concat());
    assert_eq!(code, 3, "a pair was rejected: {text}");
    assert!(output.stdout.is_empty());
    let shapes: Value =
        serde_json::from_slice(&std::fs::read(Path::new(&out).join("shapes.json")).unwrap()).unwrap();
    for pair in shapes["pairs"].as_array().unwrap() {
        let broken = pair["name"] == "t9";
        assert_eq!(pair["status"], if broken { "rejected" } else { "ok" }, "{pair}");
        assert_eq!(broken, pair["why"].as_str().unwrap().contains("zero bytes"), "{pair}");
    }
    assert!(Path::new(&out).join("overlay-t1-right.png").exists());
    let report = std::fs::read_to_string(Path::new(&out).join("report.html")).unwrap();
    assert!(report.contains("<canvas") && report.contains("zero bytes") && !report.contains("://"));

    // The rest geometry that the shapes are of: drawn with 30, 20 and 60 mm; nominal here 29, 21 and 61.
    let nominal = std::fs::read_to_string(&rig).unwrap();
    let table: toml::Table = nominal.parse().unwrap();
    let mut other = table.clone();
    let whisker = other["whisker"].as_table_mut().unwrap();
    for (key, value) in [("straight_mm", 29.0), ("arc_radius_mm", 21.0), ("length_mm", 61.0)] {
        whisker.insert(key.to_owned(), value.into());
    }
    std::fs::write(place.path().join("nominal.toml"), other.to_string()).unwrap();
    let (shapes, whisker) = (format!("{out}/shapes.json"), at("whisker"));
    let fit = ["fit-whisker", &shapes, "--out", &whisker, "--json", "--rig"];
    let (code, output, text) = wcal(&[&fit[..], &[&at("nominal.toml")]].concat());
    assert_eq!(code, 3, "one shape was left out: {text}");
    assert!(text.contains("t9 is left out: ") && text.contains("zero bytes"), "{text}");
    let fitted: Value = serde_json::from_slice(&output.stdout).unwrap();
    let truth: Value = serde_json::from_slice(&std::fs::read(fixture("truth.json")).unwrap()).unwrap();
    for (key, drawn, limit) in
        [("straight_mm", "straight", 0.2), ("arc_radius_mm", "radius", 0.1), ("length_mm", "length", 0.2)]
    {
        let off = fitted["whisker"][key].as_f64().unwrap() - truth["spec"][drawn].as_f64().unwrap();
        assert!(off.abs() < limit, "{key}: {off} mm off");
    }
    let written = std::fs::read_to_string(Path::new(&whisker).join("whisker.toml")).unwrap();
    let model = std::fs::read_to_string(Path::new(&whisker).join("whisker.xml")).unwrap();
    assert!(model.starts_with("<mujoco") && model.matches("<body ").count() == 41);
    let written: toml::Table = written.parse().unwrap();
    assert_eq!(written["format"].as_str(), Some("wcal-whisker/1"));
    std::fs::write(place.path().join("none.json"), "{}").unwrap();
    let none = ["fit-whisker", &at("none.json"), "--out", &whisker, "--rig", &rig];
    assert_eq!(wcal(&none).0, 1);

    // No base tag in any pair: an error, and the reasons are on file.
    let text = std::fs::read_to_string(&rig).unwrap().replace("id = 0", "id = 17");
    std::fs::write(place.path().join("other.toml"), text).unwrap();
    let (code, _, text) = wcal(&[&shape[..], &["--rig", &at("other.toml")]].concat());
    assert_eq!(code, 1, "{text}");
    assert!(text.contains("base tag"), "{text}");
}
