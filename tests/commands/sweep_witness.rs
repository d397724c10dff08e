//! The measured sweep of the paper's whisker over a bottle judges the explanations of its 27
//! measured poses.

use crate::support::{fixture, text, wcal};
use serde_json::Value;

fn path(name: &str) -> String {
    fixture(name).display().to_string()
}

/// verify.json beside a sweep, with the exit code.
fn judged(sweep: &str) -> (i32, Value) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let run = wcal(&[
        "verify",
        &path("whiskerfbg"),
        "--sweep",
        sweep,
        "--out",
        &out,
        "--json",
    ]);
    let document = serde_json::from_slice(&run.stdout);
    (
        run.status.code().unwrap(),
        document.unwrap_or_else(|e| unreachable!("{e}: {}", text(&run.stderr))),
    )
}

/// The measured sweep with its readings some samples (0.2 s) later, or earlier where negative.
fn moved(samples: i64) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["session.toml", "object.stl"] {
        std::fs::copy(
            path(&format!("whiskerfbg_bottle/{name}")),
            folder.path().join(name),
        )
        .unwrap();
    }
    let table = std::fs::read_to_string(path("whiskerfbg_bottle/points.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table
        .lines()
        .map(|line| line.split(',').collect())
        .collect();
    let last = rows.len() as i64 - 1;
    let mut points = format!("{}\n", rows[0].join(","));
    for k in 1..=last.min(last + samples) {
        let read = &rows[(k - samples).clamp(1, last) as usize];
        let row = &rows[k as usize];
        points += &[&row[..2], &read[2..4], &row[4..]].concat().join(",");
        points += "\n";
    }
    std::fs::write(folder.path().join("points.csv"), points).unwrap();
    folder
}

/// Every explanation by a dead zone is refuted wherever the clock of the readings is put, the
/// declared model is not, and nothing with a dead zone stays named.
#[test]
fn the_sweep_refutes_the_dead_zone_at_every_clock() {
    for samples in [0, 2, -2] {
        let (code, v) = judged(&moved(samples).path().display().to_string());
        let judged = v["tests"].as_array().unwrap();
        let has = |e: &Value, id: &str| e["effects"].as_array().unwrap().iter().any(|i| i == id);
        let by_dead_zone: Vec<&Value> = judged.iter().filter(|e| has(e, "dead-zone")).collect();
        assert!(
            by_dead_zone.len() >= 2 && by_dead_zone.iter().all(|e| e["refuted"] == true),
            "{samples}: {judged:#?}"
        );
        let declared = judged
            .iter()
            .find(|e| e["effects"].as_array().unwrap().is_empty())
            .unwrap();
        assert!(declared["refuted"] == false, "{samples}: {declared}");
        let effects = |list: &Value| -> Vec<Value> {
            list.as_array()
                .unwrap()
                .iter()
                .map(|e| e["id"].clone())
                .collect()
        };
        let accepted = judged
            .iter()
            .find(|e| e["effects"].as_array().unwrap() == &effects(&v["effects"]))
            .unwrap();
        assert!(accepted["refuted"] == false, "{samples}: {accepted}");
        assert!(
            (code, v["verdict"].as_str()) == (4, Some("unknown-effect")),
            "{samples}: {code} {}",
            v["verdict"]
        );
        assert!(
            effects(&v["effects"]).iter().all(|id| id != "dead-zone"),
            "{samples}: {}",
            v["effects"]
        );
        // The error before and after is stated for what stands: 24 pm before.
        let after = v["after"]["wavelength_rmse_pm"].as_f64().unwrap();
        assert!((10.0..18.0).contains(&after), "{samples}: {after}");
    }
}

/// What the sweep refutes is not accepted on request either: no calibration is written.
#[test]
fn a_refuted_explanation_is_not_accepted_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let (session, sweep) = (path("whiskerfbg"), path("whiskerfbg_bottle"));
    let accept = [
        "verify",
        &session,
        "--accept",
        "dead-zone,contact-offset",
        "--out",
        &out,
    ];
    let run = wcal(&[&accept[..], &["--sweep", &sweep]].concat());
    assert!(
        run.status.code() == Some(4) && text(&run.stdout).contains("refutes the accepted model"),
        "{}",
        text(&run.stdout)
    );
    assert!(!folder.path().join("out/calibration.json").exists());
    // Control: without the sweep it is.
    assert_eq!(
        wcal(&[&accept[..], &["--force"]].concat()).status.code(),
        Some(4)
    );
    assert!(folder.path().join("out/calibration.json").exists());
}

/// Control: a bottle that stands 16 mm elsewhere refutes what the true place does not.
#[test]
fn a_bottle_elsewhere_refutes_the_declared_model() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = folder.path().join("sweep").display().to_string();
    let at = |name: &str| path(&format!("whiskerfbg_bottle/{name}"));
    let (readings, motion, object) = (at("readings.csv"), at("base.csv"), at("object.stl"));
    let import = |pose: &str, out: &str| {
        let place = ["--object", &object, "--object-pose", pose, "--out", out];
        wcal(
            &[
                &["import", &readings, "--kind", "sweep", "--motion", &motion][..],
                &place,
            ]
            .concat(),
        )
    };
    let run = import("111.76475,26.7875,-22.46,1,0,0,0", &sweep);
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert!(
        text(&run.stderr).contains(": released_moment_1_nmm"),
        "{}",
        text(&run.stderr)
    );
    let (_, v) = judged(&sweep);
    let declared = v["tests"].as_array().unwrap()[0].clone();
    assert!(declared["refuted"] == true, "{declared}");
    // The true place gives the fixture's table.
    let again = folder.path().join("again").display().to_string();
    assert!(
        import("111.76475,10.7875,-22.46,1,0,0,0", &again)
            .status
            .success()
    );
    let read = |folder: &str| std::fs::read_to_string(format!("{folder}/points.csv")).unwrap();
    assert_eq!(read(&again), read(&path("whiskerfbg_bottle")));
}

/// What is no sweep, a place that is none, and a sweep that begins at the object are refused by
/// name.
#[test]
fn what_cannot_judge_is_refused() {
    let refused = |arguments: &[&str], expected: &str| {
        let run = wcal(arguments);
        let said = text(&run.stderr);
        assert!(
            run.status.code() == Some(1) && said.contains(expected),
            "{arguments:?}: {said}"
        );
    };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (session, out) = (path("whiskerfbg"), at("out"));
    refused(
        &["verify", &session, "--sweep", &session, "--out", &out],
        "expected a session of kind sweep",
    );
    refused(
        &[
            "verify",
            &path("nist/pontius"),
            "--sweep",
            &path("whiskerfbg_bottle"),
            "--out",
            &out,
        ],
        "expected a session of kind whisker",
    );
    let (readings, motion, object) = (
        path("whiskerfbg_bottle/readings.csv"),
        path("whiskerfbg_bottle/base.csv"),
        path("whiskerfbg_bottle/object.stl"),
    );
    let import = [
        "import", &readings, "--kind", "sweep", "--motion", &motion, "--object", &object,
    ];
    let none = at("none");
    refused(
        &[
            &import[..],
            &["--object-pose", "1,2,3,0,0,0,0", "--out", &none],
        ]
        .concat(),
        "--object-pose: expected x,y,z (mm) and a unit quaternion",
    );
    assert!(!std::path::Path::new(&none).exists());
    // At the object from the first reading on.
    let near = at("near");
    let run = wcal(
        &[
            &import[..],
            &["--object-pose", "95,10.7875,-22.46,1,0,0,0", "--out", &near],
        ]
        .concat(),
    );
    assert!(run.status.success(), "{}", text(&run.stderr));
    refused(
        &["verify", &session, "--sweep", &near, "--out", &out],
        "the sweep has no free readings, so no zero",
    );
}
