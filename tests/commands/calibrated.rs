//! A bench in one command, and whether its calibration still holds (SIMULATED).

use crate::support::{PROGRAM, fixture, repository, text, wcal};
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn run(arguments: &[&str]) -> (i32, String, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = wcal(arguments);
    (status.code().unwrap(), text(&stdout), text(&stderr))
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Runs a command, and interrupts it once its first step has been said and the second is at work.
fn interrupted_at_its_second_line(arguments: &[&str]) {
    let mut child = Command::new(PROGRAM)
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let first = lines.find(|l| l.as_ref().is_ok_and(|l| l.contains("done before")));
    assert!(first.is_some(), "the sweep is there");
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-TERM", &id]).status().unwrap();
    assert!(sent.success());
    assert_eq!(child.wait().unwrap().signal(), Some(15));
}

#[test]
fn one_command_goes_from_the_sweep_to_contacts_and_goes_on_where_it_stopped() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("out");
    let folder = out.to_str().unwrap();
    let (code, said, errors) = run(&["calibrate", "--out", folder]);
    assert_eq!(code, 0, "{said}{errors}");
    let document = json(&out.join("calibrate.json"));
    assert_eq!(document["simulated"], true);
    let steps = document["steps"].as_array().unwrap();
    let names: Vec<&str> = steps.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["sweep", "verify", "map", "track"]);
    // The clamp that nobody declared is found, and what it costs in mm is gone.
    let verify = json(&out.join("verify/verify.json"));
    assert_eq!(verify["effects"][0]["id"], "base-compliance");
    let rms = |side: &str| verify["contact"][side]["rms_mm"].as_f64().unwrap();
    assert!(rms("before") > 0.3 && rms("after") < 0.05, "{verify:?}");
    for name in [
        "report.html",
        "track.csv",
        "map/calibration.json",
        "calibrate.log",
    ] {
        assert!(out.join(name).is_file(), "{name}");
    }
    assert!(
        said.contains("SIMULATED") && said.contains("report.html"),
        "{said}"
    );

    // Everything is there: nothing is made anew.
    let points = fs::metadata(out.join("session/points.csv"))
        .unwrap()
        .modified()
        .unwrap();
    let verified = fs::metadata(out.join("verify/verify.json"))
        .unwrap()
        .modified()
        .unwrap();
    let (code, said, _) = run(&["calibrate", "--out", folder]);
    assert_eq!(
        (code, said.matches("done before").count()),
        (0, 4),
        "{said}"
    );
    let same = |name: &str| fs::metadata(out.join(name)).unwrap().modified().unwrap();
    assert_eq!(same("verify/verify.json"), verified);
    // Without a result its step is done again, and those behind it; the sweep stays. A signal in the
    // middle of the step leaves what was done before it.
    fs::remove_dir_all(out.join("verify")).unwrap();
    interrupted_at_its_second_line(&["calibrate", "--out", folder]);
    assert!(!out.join("verify/verify.json").exists(), "control");
    let (code, said, _) = run(&["calibrate", "--out", folder]);
    assert_eq!(
        (code, said.matches("done before").count()),
        (0, 1),
        "{said}"
    );
    assert_eq!(same("session/points.csv"), points);
    assert!(same("verify/verify.json") > verified, "negative control");

    // Without a calibration there is nothing to track, and the page is written all the same.
    fs::remove_file(out.join("verify/calibration.json")).unwrap();
    fs::remove_file(out.join("report.html")).unwrap();
    let (code, said, errors) = run(&["calibrate", "--out", folder]);
    assert!(code == 0 && said.contains("left out"), "{said}{errors}");
    assert!(said.contains("no calibration was written") && out.join("report.html").is_file());

    // Another plan is another calibration.
    let [rig, plan] = ["rigs/virtual", "rigs/plans/paper-27.toml"].map(repository);
    let (rig, plan) = (rig.to_str().unwrap(), plan.to_str().unwrap());
    let (code, _, errors) = run(&["calibrate", "--rig", rig, "--plan", plan, "--out", folder]);
    assert!(code == 1 && errors.contains("expected"), "{errors}");
}

/// Later readings of the load cell of NIST, changed by `of` the signal at each load.
fn later(place: &Path, loads: &[f64], of: impl Fn(f64) -> f64) -> String {
    let file = place.join("later.csv");
    // The certified coefficients of StRD Pontius.
    let cell = |x: f64| {
        6.735_657_894_736_84e-4 + 7.320_591_604_010_03e-7 * x - 3.160_818_713_450_29e-15 * x * x
    };
    let mut table = "load,deflection\n".to_owned();
    for (k, x) in loads.iter().enumerate() {
        let noise = 2e-4 * [0.3, -1.1, 0.8, -0.2, 1.2, -0.7, 0.1, -0.4, 0.9, -0.9][k % 10];
        table += &format!("{x},{}\n", cell(*x) + of(*x) + noise);
    }
    fs::write(&file, table).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn a_check_says_what_changed_and_what_was_not_tested() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).to_str().unwrap().to_owned();
    let (cell, verified, table) = (at("cell"), at("verified"), fixture("nist/PONTIUS.DAT"));
    let import = [
        "import",
        table.to_str().unwrap(),
        "--skip-lines",
        "25",
        "--whitespace",
        "--columns",
        "deflection,load",
        "--kind",
        "transducer",
        "--stimulus",
        "load",
        "--response",
        "deflection",
        "--model",
        "linear",
        "--out",
        &cell,
    ];
    assert_eq!(run(&import).0, 0);
    assert_eq!(run(&["verify", &cell, "--out", &verified]).0, 0);
    let calibration = format!("{verified}/calibration.json");
    let check = |readings: &str| {
        let (code, said, errors) =
            run(&["check", readings, "--calibration", &calibration, "--json"]);
        let document: Value = serde_json::from_str(&said).unwrap_or_default();
        let names = document["check"]["changes"]
            .as_array()
            .cloned()
            .unwrap_or_default();
        let names: Vec<String> = names
            .iter()
            .map(|c| c["name"].as_str().unwrap().to_owned())
            .collect();
        (
            code,
            document["answer"].as_str().unwrap_or_default().to_owned(),
            names,
            errors,
        )
    };
    let loads: Vec<f64> = (1..=10).map(|k| 3e5 * f64::from(k)).collect();
    let of = |shift: &dyn Fn(f64) -> f64| check(&later(place.path(), &loads, shift));
    let ok = of(&|_| 0.0);
    assert_eq!((ok.0, ok.1.as_str()), (0, "ok"), "{ok:?}");
    let zero = of(&|_| 1e-3);
    assert_eq!(
        (zero.0, zero.1.as_str(), &zero.2[..]),
        (4, "degraded", &["zero".to_owned()][..]),
        "{zero:?}"
    );
    let gain = of(&|x| 2e-3 * 7.32e-7 * x);
    assert_eq!(
        (gain.0, &gain.2[..]),
        (4, &["sensitivity".to_owned()][..]),
        "{gain:?}"
    );
    let few = check(&later(place.path(), &loads[..2], |_| 0.0));
    assert_eq!((few.0, few.1.as_str()), (4, "not-tested"), "{few:?}");
    let far = check(&later(place.path(), &[5e6, 6e6], |_| 0.0));
    assert_eq!((far.0, far.1.as_str()), (4, "mismatch"), "{far:?}");
    let own = check(&cell);
    assert!(own.0 == 1 && own.3.contains("its own"), "{own:?}");
    let other = check(fixture("whiskerfbg").to_str().unwrap());
    assert_eq!((other.0, other.1.as_str()), (4, "mismatch"), "{other:?}");

    // The table of an axis is one of another kind; one without the columns is an error.
    let table = place.path().join("axis.csv");
    let pairs: String = (0..9).map(|k| format!("{k},{k}.001\n")).collect();
    fs::write(&table, format!("target_mm,encoder_mm\n{pairs}")).unwrap();
    let axis = check(table.to_str().unwrap());
    assert_eq!((axis.0, axis.1.as_str()), (4, "mismatch"), "{axis:?}");
    fs::write(&table, format!("force,reading\n{pairs}")).unwrap();
    let renamed = check(table.to_str().unwrap());
    assert_eq!(renamed.0, 1, "negative control: {renamed:?}");

    // Three calibrations of one unit, the last with one in a thousand more sensitivity.
    let history = place.path().join("history");
    fs::create_dir(&history).unwrap();
    for k in 0..2 {
        fs::copy(&calibration, history.join(format!("calibration-{k}.json"))).unwrap();
    }
    let (history, drift) = (history.to_str().unwrap(), at("drift"));
    let (code, said, _) = run(&["check", "--history", history, "--out", &drift, "--json"]);
    let page = fs::read_to_string(format!("{drift}/report.html")).unwrap();
    assert!(page.contains("Control charts") && page.contains("sensitivity ("));
    let found: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(
        (code, found["entries"].as_array().unwrap().len()),
        (0, 2),
        "{said}"
    );
    assert_eq!(found["quantities"][0]["e_n"][0], 0.0);
    assert!(
        found["recalibrate_by"].is_null(),
        "two calibrations make no drift"
    );
}

/// Three triangles of a straight load cell, whose zero is shifted by so much, under two names.
fn cell(file: &Path, [load, signal]: [&str; 2], zero: f64) -> String {
    let mut table = format!("{load},{signal}\n");
    let mut state = 1_u64;
    // Sums of twelve uniform numbers are nearly Gaussian.
    let mut uniform = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
    };
    for k in 0..60_i32 {
        let x = f64::from(10 - (k % 20 - 10).abs());
        let noise: f64 = 1e-3 * (0..12).map(|_| uniform()).sum::<f64>();
        table += &format!("{x},{}\n", 0.1 + zero + 0.2 * x + noise);
    }
    fs::write(file, table).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn a_cell_has_the_units_of_its_names_and_is_tared_by_its_own_columns() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).to_str().unwrap().to_owned();
    let (session, verified) = (at("cell"), at("verified"));
    let own = ["load_N", "signal_mV"];
    let table = cell(&place.path().join("cell.csv"), own, 0.0);
    let import = format!(
        "import {table} --kind transducer --stimulus load_N --response signal_mV --model linear --out {session}"
    );
    let (code, _, errors) = run(&import.split(' ').collect::<Vec<_>>());
    assert!(code == 0 && errors.contains("load_N is in N"), "{errors}");
    let description = fs::read_to_string(format!("{session}/session.toml")).unwrap();
    assert!(
        description.contains("stimulus_unit = \"N\"")
            && description.contains("response_unit = \"mV\""),
        "{description}"
    );
    let (code, said, _) = run(&["verify", &session, "--out", &verified]);
    assert_eq!(code, 0, "{said}");
    let calibration = format!("{verified}/calibration.json");
    let check = |table: &str, tare: &[&str]| {
        run(&[&["check", table, "--calibration", &calibration], tare].concat())
    };
    for names in [own, ["stimulus", "response"]] {
        let later = cell(&place.path().join("LATER.CSV"), names, 0.05);
        let (code, said, errors) = check(&later, &[]);
        assert!(
            code == 4 && said.contains("zero changed"),
            "negative control: {said}{errors}"
        );
        let (code, said, errors) = check(&later, &["--tare"]);
        assert!(
            code == 0 && said.contains("tare: the zero is that of 3 unloaded readings, 0.0"),
            "{said}{errors}"
        );
        let (code, _, errors) = run(&[
            "predict",
            &later,
            "--calibration",
            &calibration,
            "--out",
            &at("predicted.csv"),
        ]);
        assert_eq!(code, 0, "{errors}");
    }
}
