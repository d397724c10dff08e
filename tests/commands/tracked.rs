//! Records of one contact each, with a calibration and the true contact (SIMULATED): needles
//! pressed in and back, and a short slide.

use crate::support::copy::copy_folder;
use crate::support::{repository, text, wcal};
use std::path::PathBuf;

/// Cells of a table by column.
fn column(table: &str, name: &str) -> Vec<String> {
    let mut lines = table
        .lines()
        .map(|line| line.split(',').collect::<Vec<_>>());
    let at = lines
        .next()
        .unwrap()
        .iter()
        .position(|c| *c == name)
        .unwrap();
    lines.map(|cells| cells[at].to_owned()).collect()
}

fn numbers(table: &str, name: &str) -> Vec<f64> {
    column(table, name)
        .iter()
        .map(|cell| cell.parse().unwrap_or(f64::NAN))
        .collect()
}

/// Exit code, table and summary of a record.
fn tracked(name: &str) -> (i32, String, serde_json::Value) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/commands/tracked")
        .join(name);
    let out = tempfile::tempdir().unwrap();
    let table = out.path().join("t.csv");
    let of = |file: &str| folder.join(file).to_string_lossy().into_owned();
    let (readings, motion, calibration) =
        (of("readings.csv"), of("base.csv"), of("calibration.json"));
    let found = wcal(&[
        "track",
        &readings,
        "--motion",
        &motion,
        "--calibration",
        &calibration,
        "--out",
        &table.to_string_lossy(),
        "--force",
    ]);
    let summary = std::fs::read_to_string(out.path().join("t.json")).unwrap();
    let table =
        std::fs::read_to_string(table).unwrap_or_else(|_| panic!("{}", text(&found.stderr)));
    (
        found.status.code().unwrap(),
        table,
        serde_json::from_str(&summary).unwrap(),
    )
}

/// Distances from the true contact of the rows with a status, mm.
fn errors_mm(name: &str, table: &str, status: &str) -> Vec<f64> {
    let truth = format!(
        "{}/tests/commands/tracked/{name}/truth.csv",
        env!("CARGO_MANIFEST_DIR")
    );
    let truth = std::fs::read_to_string(truth).unwrap();
    let off = |k: usize| {
        let of = |axis: &str| numbers(table, axis)[k] - numbers(&truth, axis)[k];
        of("contact_x_mm").hypot(of("contact_z_mm"))
    };
    let states = column(table, "status");
    (0..states.len())
        .filter(|k| states[*k] == status)
        .map(off)
        .filter(|mm| mm.is_finite())
        .collect()
}

#[test]
fn needles_are_found_and_no_sum_of_squares_is_negative() {
    for name in ["needle", "point"] {
        let (_, table, summary) = tracked(name);
        for contact in summary["contacts"].as_array().unwrap() {
            assert!(contact["chi2"].as_f64() >= Some(0.0), "{name}: {contact}");
        }
        let errors = errors_mm(name, &table, "ok");
        assert!(
            errors.len() >= 10 && errors.iter().all(|mm| *mm < 1.0),
            "{name}: {errors:?}"
        );
    }
}

#[test]
fn a_slide_that_is_too_short_to_be_looked_at_is_undecided() {
    let (code, table, summary) = tracked("short_slide");
    let contact = &summary["contacts"][0];
    assert_eq!(
        (code, contact["contact"].as_str()),
        (3, Some("undecided")),
        "{contact}"
    );
    assert!(
        (contact["weights"]["sliding"].as_f64().unwrap() - 0.28).abs() < 1e-9,
        "{contact}"
    );
    // No row of the contact is stated as ok; free rows are.
    assert!(errors_mm("short_slide", &table, "ok").is_empty());
    let (states, p) = (
        column(&table, "status"),
        numbers(&table, "contact_probability"),
    );
    assert!(
        states[..15].iter().all(|s| s == "ok") && p.iter().any(|p| *p > 0.5),
        "{states:?}"
    );
}

/// A session whose groove is known, tracked with its own calibration and with that of another
/// bench.
#[test]
fn rows_that_miss_a_known_groove_say_so_with_force_too() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).to_string_lossy().into_owned();
    for name in ["case-004", "case-008"] {
        copy_folder(
            &repository("fixtures/practice").join(name),
            &place.path().join(name),
        );
        assert_eq!(
            wcal(&["verify", &at(name), "--out", &at(&format!("{name}-v"))])
                .status
                .code(),
            Some(0)
        );
    }
    let track = |calibration: &str, more: &[&str]| {
        let (calibration, out) = (
            at(&format!("{calibration}-v/calibration.json")),
            at("t.csv"),
        );
        let call = [
            "track",
            &at("case-004"),
            "--calibration",
            &calibration,
            "--out",
            &out,
        ];
        let found = wcal(&[&call[..], more].concat());
        (
            found.status.code(),
            column(&std::fs::read_to_string(out).unwrap(), "status"),
        )
    };
    let missed = |states: &[String]| {
        states
            .iter()
            .filter(|s| s.contains("groove-missed"))
            .count()
    };
    let (code, states) = track("case-008", &["--force"]);
    assert_eq!((code, missed(&states)), (Some(3), states.len()));
    assert_eq!(track("case-008", &[]).0, Some(4));
    let (code, states) = track("case-004", &[]);
    assert!(
        missed(&states) == 0 && code != Some(4),
        "negative control: {code:?}"
    );
}
