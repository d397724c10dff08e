//! The program on its own recordings, end to end, with negative controls.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

fn copy(from: &Path) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("temporary folder");
    for entry in std::fs::read_dir(from).expect("fixture") {
        let path = entry.expect("entry").path();
        if path.is_file() {
            std::fs::copy(&path, folder.path().join(path.file_name().expect("name"))).expect("copied");
        }
    }
    folder
}

fn verify(session: &Path) -> (i32, Value) {
    let out = tempfile::tempdir().expect("temporary folder");
    let run = Command::new(env!("CARGO_BIN_EXE_wcal"))
        .arg("verify")
        .arg(session)
        .arg("--out")
        .arg(out.path())
        .arg("--json")
        .output()
        .expect("wcal runs");
    let stderr = String::from_utf8_lossy(&run.stderr).into_owned();
    let json = serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {stderr}"));
    for file in ["verify.json", "report.html"] {
        assert!(out.path().join(file).is_file(), "{file} is written");
    }
    (run.status.code().unwrap_or(-1), json)
}

fn points(v: &Value, kind: &str) -> Vec<i64> {
    let faults = v["twin"]["faults"].as_array().expect("faults");
    let of_kind = faults.iter().filter(|f| f["kind"] == kind);
    of_kind.flat_map(|f| f["points"].as_array().expect("points").iter().filter_map(Value::as_i64)).collect()
}

#[test]
fn whiskerfbg_faulty_labels_are_found_and_the_error_falls() {
    let (code, v) = verify(&fixture("whiskerfbg"));
    assert_eq!(code, 4);
    // The six deepest poses of the outer trajectories, where the released twin's wire snapped aside.
    assert_eq!(points(&v, "branch"), [11, 14, 17, 20, 23, 26]);
    let before = v["before"]["wavelength_rmse_pm"].as_f64().expect("before");
    let after = v["after"]["wavelength_rmse_pm"].as_f64().expect("after");
    assert!((before - 24.1).abs() < 0.2, "released labels with K and zero leave about 24 pm, found {before}");
    assert!(after < 0.5 * before, "{before} -> {after}");
}

#[test]
fn a_perturbed_label_is_found() {
    let folder = copy(&fixture("whiskerfbg"));
    let path = folder.path().join("twin.csv");
    let text = std::fs::read_to_string(&path).expect("twin.csv");
    // Point 4 sits on a symmetric trajectory: a large first moment is impossible there.
    let changed: Vec<String> = text
        .lines()
        .map(|l| if l.starts_with("4,") { "4,0.9,-1.0".to_owned() } else { l.to_owned() })
        .collect();
    assert_ne!(changed.join("\n"), text.trim_end());
    std::fs::write(&path, changed.join("\n") + "\n").expect("written");
    let (_, v) = verify(folder.path());
    assert!(points(&v, "branch").contains(&4), "{}", v["twin"]);
}

#[test]
fn a_simulated_null_session_is_adequate() {
    let (code, v) = verify(&fixture("practice/case-004"));
    assert_eq!((code, v["verdict"].as_str()), (0, Some("adequate")), "{}", v["reason"]);
    assert_eq!(v["effects"].as_array().map(Vec::len), Some(0));
}

#[test]
fn undeclared_friction_is_named_and_a_copied_holdout_refused() {
    let (code, v) = verify(&fixture("practice/case-008"));
    assert_eq!((code, v["verdict"].as_str()), (4, Some("effect")), "{}", v["reason"]);
    assert_eq!(v["effects"][0]["id"], "groove-friction");
    let mu = v["effects"][0]["parameters"][0]["value"].as_f64().expect("value");
    assert!((mu - 0.1746).abs() < 0.03, "true coefficient 0.1746 (fixtures/practice/truth.json), found {mu}");

    // Negative control: sealed rows that were in the fit.
    let folder = copy(&fixture("practice/case-008"));
    let points = std::fs::read_to_string(folder.path().join("points.csv")).expect("points");
    let copied: Vec<String> = points
        .lines()
        .take(20)
        .map(|l| l.replace("verification", "holdout").replace("calibration", "holdout"))
        .collect();
    std::fs::write(folder.path().join("holdout.csv"), copied.join("\n") + "\n").expect("written");
    let (code, v) = verify(folder.path());
    assert_eq!((code, v["verdict"].as_str()), (1, Some("refused")), "{}", v["reason"]);
}
