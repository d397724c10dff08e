//! The program on its own recordings, end to end, with negative controls.

use crate::support::copy::copy_folder;
use crate::support::{fixture, program, repository};
use serde_json::Value;
use std::path::Path;

fn verify(session: &Path) -> (i32, Value) {
    let out = tempfile::tempdir().expect("temporary folder");
    let run = program()
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
    of_kind
        .flat_map(|f| {
            f["points"]
                .as_array()
                .expect("points")
                .iter()
                .filter_map(Value::as_i64)
        })
        .collect()
}

#[test]
fn whiskerfbg_faulty_labels_are_found_and_the_error_falls() {
    let (code, v) = verify(&fixture("whiskerfbg"));
    assert_eq!(code, 4);
    // The six deepest poses of the outer trajectories, where the released twin's wire snapped
    // aside.
    assert_eq!(points(&v, "branch"), [11, 14, 17, 20, 23, 26]);
    let before = v["before"]["wavelength_rmse_pm"].as_f64().expect("before");
    let after = v["after"]["wavelength_rmse_pm"].as_f64().expect("after");
    assert!(
        (before - 24.1).abs() < 0.2,
        "released labels with K and zero leave about 24 pm, found {before}"
    );
    assert!(after < 0.5 * before, "{before} -> {after}");
    // The guide quotes this run and nothing else (README's row: tests/contracts/results.rs).
    let page = |name: &str| std::fs::read_to_string(repository(name)).expect("page");
    let guide = page("docs/src/guide/whisker.md");
    let quoted = format!(
        "| {before:.1} pm | {after:.1} pm | 11, 14, 17, 20, 23, 26 | {} |",
        v["verdict"].as_str().expect("verdict")
    );
    assert!(
        guide.contains(&quoted),
        "the guide lacks the line that this run prints: {quoted}"
    );
}

/// Every row of `points.csv` with `edit` applied to the cell of `column`.
fn edited(from: &Path, column: &str, edit: impl Fn(usize, f64) -> String) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("temporary folder");
    copy_folder(from, folder.path());
    let path = folder.path().join("points.csv");
    let text = std::fs::read_to_string(&path).expect("points");
    let index = text
        .lines()
        .next()
        .expect("header")
        .split(',')
        .position(|c| c == column)
        .expect("column");
    let lines: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if let Ok(value) = cells[index].parse::<f64>() {
                cells[index] = edit(i, value);
            }
            cells.join(",")
        })
        .collect();
    std::fs::write(&path, lines.join("\n") + "\n").expect("written");
    folder
}

#[test]
fn a_perturbed_pose_is_noticed() {
    // Every seventh pose of the first 40 (path 1 runs along z, so does the groove) is written 0.4
    // mm deeper than it was.
    let moved = |i: usize, mm: f64| {
        format!(
            "{:.6}",
            if i.is_multiple_of(7) && i < 40 && mm > 0.0 {
                mm + 0.4
            } else {
                mm
            }
        )
    };
    let stage = edited(&fixture("practice/case-004"), "stage_mm", moved);
    let folder = edited(stage.path(), "groove_z_mm", moved);
    let (code, v) = verify(folder.path());
    assert_eq!(
        (code, v["verdict"].as_str()),
        (0, Some("effect")),
        "{}",
        v["reason"]
    );
    assert_eq!(v["effects"][0]["id"], "slip-outliers");
}

#[test]
fn the_rods_own_labels_are_taken_without_a_fault() {
    let folder = tempfile::tempdir().expect("temporary folder");
    copy_folder(&fixture("practice/case-004"), folder.path());
    let table = folder.path().join("twin.csv");
    let twin = |session: &Path| {
        let run = program()
            .arg("twin")
            .arg(session)
            .arg("--out")
            .arg(&table)
            .output();
        run.expect("wcal runs").status.code()
    };
    assert_eq!(twin(folder.path()), Some(0));
    let text = std::fs::read_to_string(&table).expect("twin.csv");
    let header = "point,moment_1_nmm,moment_2_nmm,contact_arclength_mm,branch,settled";
    assert_eq!(text.lines().next(), Some(header));
    assert!(
        text.lines()
            .filter(|l| l.ends_with("first-touch,true"))
            .count()
            > 20,
        "{text}"
    );
    let description = folder.path().join("session.toml");
    let declared = std::fs::read_to_string(&description).expect("session.toml");
    std::fs::write(
        &description,
        declared.replace("[files]", "[files]\ntwin = \"twin.csv\""),
    )
    .expect("written");
    let (_, v) = verify(folder.path());
    assert_eq!(
        v["twin"]["faults"].as_array().map(Vec::len),
        Some(0),
        "{}",
        v["twin"]
    );
    // One pose at the end of the reach, where the wire has run out of the groove: no moment, no
    // label, and it is said.
    let moved =
        |i: usize, mm: f64| format!("{:.6}", if i == 14 && mm > 0.0 { mm + 56.0 } else { mm });
    let stage = edited(&fixture("practice/case-004"), "stage_mm", moved);
    let far = edited(stage.path(), "groove_z_mm", moved);
    assert_eq!(twin(far.path()), Some(3));
    let text = std::fs::read_to_string(&table).expect("twin.csv");
    assert_eq!(
        text.lines()
            .filter(|l| l.contains(",,,s") && l.ends_with(",false"))
            .count(),
        1,
        "{text}"
    );
}

#[test]
fn labels_in_another_unit_are_named_so() {
    let folder = tempfile::tempdir().expect("temporary folder");
    copy_folder(&fixture("whiskerfbg"), folder.path());
    let path = folder.path().join("twin.csv");
    let text = std::fs::read_to_string(&path).expect("twin.csv");
    let mut lines = text.lines();
    let mut out = lines.next().expect("header").to_owned() + "\n";
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let metres = |c: &str| format!("{:e}", c.parse::<f64>().expect("moment") * 1e-3);
        out += &format!("{},{},{}\n", cells[0], metres(cells[1]), metres(cells[2]));
    }
    std::fs::write(&path, out).expect("written");
    let (_, v) = verify(folder.path());
    assert!(points(&v, "unit").len() > 15, "{}", v["twin"]);
}

#[test]
fn wavelengths_in_picometres_are_refused() {
    let folder = edited(&fixture("practice/case-004"), "fbg_1_nm", |_, nm| {
        format!("{:.4}", nm * 1000.0)
    });
    let out = tempfile::tempdir().expect("temporary folder");
    let run = program()
        .arg("verify")
        .arg(folder.path())
        .arg("--out")
        .arg(out.path())
        .output()
        .expect("wcal runs");
    assert_eq!(run.status.code(), Some(1));
    let v: Value =
        serde_json::from_slice(&std::fs::read(out.path().join("verify.json")).expect("written"))
            .expect("json");
    assert_eq!(v["verdict"], "refused");
}

#[test]
fn a_perturbed_label_is_found() {
    let folder = tempfile::tempdir().expect("temporary folder");
    copy_folder(&fixture("whiskerfbg"), folder.path());
    let path = folder.path().join("twin.csv");
    let text = std::fs::read_to_string(&path).expect("twin.csv");
    // Point 4 sits on a symmetric trajectory: a large first moment is impossible there.
    let changed: Vec<String> = text
        .lines()
        .map(|l| {
            if l.starts_with("4,") {
                "4,0.9,-1.0".to_owned()
            } else {
                l.to_owned()
            }
        })
        .collect();
    assert_ne!(changed.join("\n"), text.trim_end());
    std::fs::write(&path, changed.join("\n") + "\n").expect("written");
    let (_, v) = verify(folder.path());
    assert!(points(&v, "branch").contains(&4), "{}", v["twin"]);
}

#[test]
fn a_simulated_null_session_is_adequate() {
    let (code, v) = verify(&fixture("practice/case-004"));
    assert_eq!(
        (code, v["verdict"].as_str()),
        (0, Some("adequate")),
        "{}",
        v["reason"]
    );
    assert_eq!(v["effects"].as_array().map(Vec::len), Some(0));
    assert_eq!(v["simulated"], true);
}

/// A demonstration in the place of an earlier one: what it shows, and that nothing of the earlier
/// one is left beside it.
#[test]
fn the_demo_shows_an_effect_that_halves_the_error_and_marks_what_is_simulated() {
    let place = tempfile::tempdir().expect("temporary folder");
    let demo = || {
        program()
            .args(["demo", "--out", "demo"])
            .current_dir(place.path())
            .output()
            .expect("wcal runs")
    };
    let out = place.path().join("demo");
    // As an earlier one left it: an explanation was accepted then.
    let earlier = out.join("whiskerfbg");
    std::fs::create_dir_all(&earlier).expect("made");
    for (name, text) in [
        ("verify.json", "wcal-verify/2"),
        ("calibration.json", "{}"),
        ("../report.html", "wcal demo"),
    ] {
        std::fs::write(earlier.join(name), text).expect("written");
    }
    // Control: beside a file that is no demonstration's it is refused.
    std::fs::write(earlier.join("notes.txt"), "mine").expect("written");
    let run = demo();
    let said = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        said.contains("notes.txt") && !out.join("practice-004").exists(),
        "{said}"
    );
    std::fs::remove_file(earlier.join("notes.txt")).expect("removed");
    let run = demo();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(
        run.status.success() && said.contains("(SIMULATED): adequate"),
        "{said}"
    );
    // What it is all for: contacts in the groove before and after, first in the output, on the page
    // and in the overview.
    let bench = std::fs::read_to_string(out.join("bench-clamp/verify.json")).expect("file");
    let contact: Value = serde_json::from_str::<Value>(&bench).expect("JSON")["contact"].clone();
    let rms = |side: &str| contact[side]["rms_mm"].as_f64().expect("rms");
    assert!(
        rms("before") > 3.0 * rms("after") && rms("after") < 0.2,
        "{} -> {}",
        rms("before"),
        rms("after")
    );
    assert!(
        said.lines()
            .take(3)
            .any(|line| line.trim_start().starts_with("contact: ")),
        "{said}"
    );
    let read = |name: &str| std::fs::read_to_string(out.join(name)).expect(name);
    let accepted = read("whiskerfbg/verify.json");
    assert!(
        !accepted.contains("\"effect\"") && !earlier.join("calibration.json").exists(),
        "{accepted}"
    );
    let v: Value = serde_json::from_str(&read("pontius/verify.json")).expect("JSON");
    let rmse = |side: &str| v[side]["response_rmse"].as_f64().expect("rmse");
    assert_eq!(
        (v["verdict"].as_str(), v["simulated"].as_bool()),
        (Some("effect"), Some(false))
    );
    assert!(
        2.0 * rmse("after") <= rmse("before"),
        "{} -> {}",
        rmse("before"),
        rmse("after")
    );
    let first = read("report.html");
    assert!(
        first.contains(">practice-004</a></h2>") && first.matches("SIMULATED</span>").count() == 2,
        "simulated sessions are marked, measured ones are not"
    );
    assert!(
        first
            .find("error of a contact")
            .is_some_and(|claim| claim < first.find("<section").unwrap_or(0))
            && first.contains("contact (mm)")
            && read("bench-clamp/report.html").contains("Contact beside the groove")
    );
    for (page, marked) in [
        ("bench-clamp", true),
        ("practice-004", true),
        ("pontius", false),
        ("whiskerfbg", false),
    ] {
        assert_eq!(
            read(&format!("{page}/report.html")).contains("SIMULATED"),
            marked,
            "{page}"
        );
    }
    let whisker = read("whiskerfbg/report.html");
    // Six labels on another branch, two moments each; the others are off by the discretisation
    // only.
    let rings: usize = whisker
        .split("class=\"ring bad\" d=\"")
        .skip(1)
        .map(|d| d.split('"').next().map_or(0, |d| d.matches('M').count()))
        .sum();
    assert_eq!(rings, 12, "rings");
    // The sweep over the bottle refutes what the 27 poses alone leave open; nothing is accepted in
    // its place.
    assert!(
        whisker.contains("dead-zone with hysteresis") && whisker.contains("<td>refuted</td>"),
        "the sweep's table"
    );
    assert!(
        whisker.contains("best explanation, not accepted") && !whisker.contains("after: accepted")
    );
    let tracked = read("bottle/track.csv");
    assert!(
        tracked.lines().count() == 98
            && tracked
                .lines()
                .next()
                .is_some_and(|l| l.contains("world_x_mm"))
    );
    assert!(!whisker.contains("No map was fitted"));
    let null = read("practice-004/report.html");
    assert!(!null.contains("Twin check") && whisker.contains("Twin check"));
}

/// Readings at rest of another zero (8 and -4 pm) are named with their size; as recorded, nothing
/// is.
#[test]
fn another_zero_at_rest_is_named_and_nothing_without_it() {
    let (code, v) = verify(&fixture("practice/case-004"));
    assert_eq!(
        (code, v["verdict"].as_str()),
        (0, Some("adequate")),
        "{}",
        v["reason"]
    );
    let folder = tempfile::tempdir().expect("temporary folder");
    copy_folder(&fixture("practice/case-004"), folder.path());
    let points = std::fs::read_to_string(folder.path().join("points.csv")).expect("points");
    let columns: Vec<&str> = points.lines().next().expect("header").split(',').collect();
    let moved = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if cells[1] == "rest" {
            for (name, by_nm) in [("fbg_1_nm", 0.008), ("fbg_2_nm", -0.004)] {
                let at = columns.iter().position(|c| *c == name).expect(name);
                cells[at] = format!("{:.7}", cells[at].parse::<f64>().expect(name) + by_nm);
            }
        }
        cells.join(",") + "\n"
    };
    std::fs::write(
        folder.path().join("points.csv"),
        points.lines().map(moved).collect::<String>(),
    )
    .expect("written");
    let (code, v) = verify(folder.path());
    assert_eq!(
        (code, v["verdict"].as_str()),
        (0, Some("effect")),
        "{}",
        v["reason"]
    );
    assert_eq!(
        v["effects"].as_array().map(|e| e.len()),
        Some(1),
        "{}",
        v["effects"]
    );
    assert_eq!(v["effects"][0]["id"], "rest-zero");
    for (k, true_pm) in [8.0, -4.0].into_iter().enumerate() {
        let value = v["effects"][0]["parameters"][k]["value"]
            .as_f64()
            .expect("value");
        assert!((value - true_pm).abs() < 0.25, "{value} for {true_pm}");
    }
}

#[test]
fn undeclared_friction_is_named_and_a_copied_holdout_refused() {
    let (code, v) = verify(&fixture("practice/case-008"));
    assert_eq!(
        (code, v["verdict"].as_str()),
        (0, Some("effect")),
        "{}",
        v["reason"]
    );
    assert_eq!(v["effects"][0]["id"], "groove-friction");
    let mu = v["effects"][0]["parameters"][0]["value"]
        .as_f64()
        .expect("value");
    assert!(
        (mu - 0.1746).abs() < 0.03,
        "true coefficient 0.1746 (fixtures/practice/truth.json), found {mu}"
    );

    // Negative control: sealed rows that were in the fit.
    let folder = tempfile::tempdir().expect("temporary folder");
    copy_folder(&fixture("practice/case-008"), folder.path());
    let points = std::fs::read_to_string(folder.path().join("points.csv")).expect("points");
    let copied: Vec<String> = points
        .lines()
        .take(20)
        .map(|l| {
            l.replace("verification", "holdout")
                .replace("calibration", "holdout")
        })
        .collect();
    std::fs::write(folder.path().join("holdout.csv"), copied.join("\n") + "\n").expect("written");
    let (code, v) = verify(folder.path());
    assert_eq!(
        (code, v["verdict"].as_str()),
        (1, Some("refused")),
        "{}",
        v["reason"]
    );
}
