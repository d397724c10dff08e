//! `--add` and `--accept` through the program, on a SIMULATED session (fixtures/practice) cut into
//! two seatings.

use crate::support::{fixture, program};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

/// The rows of `name` for which `keep(t_s)` holds, channel 1 raised by `shift_pm`, as a session of
/// its own.
fn part(name: &str, shift_pm: f64, keep: impl Fn(f64) -> bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("temporary folder");
    let session = std::fs::read_to_string(fixture(name).join("session.toml")).expect("session");
    std::fs::write(
        folder.path().join("session.toml"),
        session.replace("holdout = \"holdout.csv\"", ""),
    )
    .expect("written");
    let text = std::fs::read_to_string(fixture(name).join("points.csv")).expect("points");
    let mut lines = text.lines();
    let header = lines.next().expect("header");
    let columns: Vec<&str> = header.split(',').collect();
    let column = |wanted: &str| columns.iter().position(|c| *c == wanted).expect("column");
    let (time, shifted) = (column("t_s"), column("fbg_1_nm"));
    let mut out = format!("{header}\n");
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if keep(cells[time].parse().expect("time")) {
            let nm: f64 = cells[shifted].parse().expect("wavelength");
            cells[shifted] = format!("{:.7}", nm + shift_pm * 1e-3);
            out.push_str(&cells.join(","));
            out.push('\n');
        }
    }
    std::fs::write(folder.path().join("points.csv"), out).expect("written");
    folder
}

fn verify(session: &Path, more: &[&str]) -> (Output, Option<Value>, tempfile::TempDir) {
    let out = tempfile::tempdir().expect("temporary folder");
    let run = program()
        .arg("verify")
        .arg(session)
        .args(more)
        .arg("--out")
        .arg(out.path())
        .arg("--json")
        .output()
        .expect("wcal runs");
    let json = serde_json::from_slice(&run.stdout).ok();
    (run, json, out)
}

fn middle_s(name: &str) -> f64 {
    let text = std::fs::read_to_string(fixture(name).join("points.csv")).expect("points");
    let column = text
        .lines()
        .next()
        .expect("header")
        .split(',')
        .position(|c| c == "t_s")
        .expect("t_s");
    let mut times: Vec<f64> = text
        .lines()
        .skip(1)
        .map(|l| {
            l.split(',')
                .nth(column)
                .expect("cell")
                .parse()
                .expect("time")
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

#[test]
fn a_later_seating_has_its_own_zero() {
    const RESEATED_PM: f64 = 25.0;
    let middle = middle_s("practice/case-004");
    let first = part("practice/case-004", 0.0, |t| t < middle);
    let second = part("practice/case-004", RESEATED_PM, |t| t >= middle);
    let added = second.path().to_str().expect("path");
    let (_, v, _) = verify(first.path(), &["--add", added]);
    let v = v.expect("verify.json");
    assert_eq!(v["verdict"], "adequate", "{}", v["reason"]);
    // One of two channels moved: sqrt(25^2 / 2 / 2); two sessions tell little of its size.
    let between = &v["noise"]["session"];
    let (sd, high) = (between["value"].as_f64(), between["interval95"][1].as_f64());
    assert!(
        sd.is_some_and(|sd| (sd - RESEATED_PM / 2.0).abs() < 1.0),
        "{between}"
    );
    assert!(high > sd.map(|sd| 3.0 * sd), "{between}");

    // Negative control: the same readings as one session, where the zero may not jump.
    let text = |f: &tempfile::TempDir| {
        std::fs::read_to_string(f.path().join("points.csv")).expect("points")
    };
    let joined: String = text(&first)
        + &text(&second)
            .lines()
            .skip(1)
            .map(|l| format!("{l}\n"))
            .collect::<String>();
    std::fs::write(first.path().join("points.csv"), joined).expect("written");
    let (_, v, _) = verify(first.path(), &[]);
    let v = v.expect("verify.json");
    assert_ne!(v["verdict"], "adequate");
    assert!(
        v["noise"]["session"].is_null(),
        "one session does not tell: {}",
        v["noise"]
    );

    // A session cannot be added to itself.
    let (run, _, _) = verify(second.path(), &["--add", added]);
    assert_eq!(run.status.code(), Some(1));
}

#[test]
fn only_a_surviving_explanation_can_be_accepted_and_predict_uses_it() {
    let session = fixture("practice/case-008");
    let (run, v, out) = verify(&session, &["--accept", "groove-friction"]);
    let v = v.expect("verify.json");
    assert_eq!(
        (run.status.code(), v["verdict"].as_str()),
        (Some(0), Some("effect"))
    );
    let calibration = out.path().join("calibration.json");
    let file: Value =
        serde_json::from_slice(&std::fs::read(&calibration).expect("calibration")).expect("json");
    assert_eq!(file["model"]["effects"][0]["id"], "groove-friction");
    let predict = |table: &Path, csv: &Path| {
        let mut run = program();
        run.arg("predict")
            .arg(table)
            .arg("--calibration")
            .arg(&calibration)
            .arg("--out")
            .arg(csv);
        run.output().expect("wcal runs")
    };
    let csv = out.path().join("moments.csv");
    let predicted = predict(&session.join("holdout.csv"), &csv);
    assert_eq!(
        predicted.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&predicted.stderr)
    );
    assert!(std::fs::read_to_string(&csv).expect("csv").lines().count() > 10);

    // The same readings with a grating that stays as it was in the first of them: the moments are
    // there, and not verified.
    let text = std::fs::read_to_string(session.join("holdout.csv")).expect("holdout");
    let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
    let column = rows[0]
        .iter()
        .position(|c| *c == "fbg_1_nm")
        .expect("column");
    let stuck: String = rows
        .iter()
        .enumerate()
        .map(|(k, row)| {
            let mut row = row.clone();
            row[column] = if k == 0 { row[column] } else { rows[1][column] };
            row.join(",") + "\n"
        })
        .collect();
    let table = out.path().join("stuck.csv");
    std::fs::write(&table, stuck).expect("written");
    let refused = predict(&table, &out.path().join("stuck-moments.csv"));
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        refused.status.code() == Some(4) && said.contains("fbg_1"),
        "{said}"
    );

    // Negative control: what the data reject is not accepted, and nothing is written.
    let (run, v, out) = verify(&session, &["--accept", "creep"]);
    assert_eq!((run.status.code(), v), (Some(1), None));
    assert!(String::from_utf8_lossy(&run.stderr).contains("groove-friction"));
    assert!(!out.path().join("calibration.json").exists());
}

#[test]
fn a_holdout_that_contradicts_the_points_is_said() {
    // The points of the null session (adequate, tests/accuracy/residual_loop.rs) with a holdout
    // whose channel 1 reads 5 pm more.
    let whole = part("practice/case-004", 0.0, |_| true);
    let session = std::fs::read_to_string(fixture("practice/case-004").join("session.toml"))
        .expect("session");
    std::fs::write(whole.path().join("session.toml"), session).expect("written");
    let text =
        std::fs::read_to_string(fixture("practice/case-004").join("holdout.csv")).expect("holdout");
    let column = text
        .lines()
        .next()
        .expect("header")
        .split(',')
        .position(|c| c == "fbg_1_nm")
        .expect("column");
    let moved = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if let Ok(nm) = cells[column].parse::<f64>() {
            cells[column] = format!("{:.7}", nm + 5e-3);
        }
        cells.join(",") + "\n"
    };
    std::fs::write(
        whole.path().join("holdout.csv"),
        text.lines().map(moved).collect::<String>(),
    )
    .expect("written");
    let (run, v, out) = verify(whole.path(), &[]);
    let v = v.expect("verify.json");
    assert_eq!(
        (run.status.code(), v["verdict"].as_str()),
        (Some(4), Some("adequate")),
        "what was decided without the sealed rows stands: {}",
        v["reason"]
    );
    assert_eq!(v["holdout"]["outcome"], "contradicted", "{}", v["holdout"]);
    assert!(
        v["holdout"]["why"]
            .as_str()
            .expect("why")
            .contains("contradict"),
        "{}",
        v["holdout"]
    );
    assert!(!out.path().join("calibration.json").exists());
}
