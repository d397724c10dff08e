//! Transducer and axis sessions through the program, end to end: measured data with certified answers, negative controls, broken input.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that fails should say where")]

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/nist").join(name)
}

fn wcal(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wcal")).args(arguments).output().unwrap()
}

/// A session with the points table of a fixture rewritten line by line (header left out).
fn disturbed(name: &str, change: impl Fn(usize, &[&str]) -> String) -> tempfile::TempDir {
    let text = fs::read_to_string(fixture(name).join("points.csv")).unwrap();
    let mut lines = text.lines();
    let header = lines.next().unwrap().to_owned();
    let rows = lines.enumerate().map(|(k, line)| change(k, &line.split(',').collect::<Vec<_>>()));
    let table: Vec<String> = std::iter::once(header).chain(rows).collect();
    let toml = fs::read_to_string(fixture(name).join("session.toml")).unwrap();
    session(&toml, &table.join("\n"))
}

fn session(toml: &str, points: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("session.toml"), toml).unwrap();
    fs::write(folder.path().join("points.csv"), format!("{points}\n")).unwrap();
    folder
}

const TRANSDUCER: &str = "format = \"wcal-session/1\"\nid = \"made\"\nkind = \"transducer\"\nmedium = \"air\"\ncreated = \"2026-01-01T00:00:00Z\"\n[files]\npoints = \"points.csv\"\n[transducer]\nmodel = \"linear\"\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\n";
const AXIS: &str = "format = \"wcal-session/1\"\nid = \"made\"\nkind = \"axis\"\nmedium = \"air\"\ncreated = \"2026-01-01T00:00:00Z\"\n[files]\npoints = \"points.csv\"\n";

/// Exit code, verify.json, calibration.json where one was written, all results in a folder of their own.
struct Run {
    code: i32,
    verify: Value,
    calibration: Option<Value>,
    out: tempfile::TempDir,
}

fn verify(folder: &Path) -> Run {
    let out = tempfile::tempdir().unwrap();
    let run = wcal(&["verify", folder.to_str().unwrap(), "--out", out.path().to_str().unwrap(), "--json"]);
    let stderr = String::from_utf8_lossy(&run.stderr).into_owned();
    let verify: Value = serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {stderr}"));
    let written: Value = serde_json::from_slice(&fs::read(out.path().join("verify.json")).unwrap()).unwrap();
    assert_eq!(verify, written, "--json prints what is written");
    assert!(fs::read_to_string(out.path().join("report.html")).unwrap().contains("Residuals"));
    let calibration = fs::read(out.path().join("calibration.json")).ok();
    let calibration = calibration.map(|bytes| serde_json::from_slice(&bytes).unwrap());
    Run { code: run.status.code().unwrap(), verify, calibration, out }
}

impl Run {
    fn verdict(&self) -> &str {
        self.verify["verdict"].as_str().unwrap()
    }
    fn effects(&self) -> Vec<&str> {
        self.verify["effects"].as_array().unwrap().iter().map(|e| e["id"].as_str().unwrap()).collect()
    }
    fn rmse(&self, when: &str, key: &str) -> f64 {
        self.verify[when][key].as_f64().unwrap()
    }
    fn polynomial(&self, field: &str) -> Vec<f64> {
        let values = &self.calibration.as_ref().unwrap()["model"]["polynomial"][field];
        values.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    }
    fn lack_of_fit(&self, model: usize, field: &str) -> f64 {
        self.calibration.as_ref().unwrap()["model"]["lack_of_fit"][model][field].as_f64().unwrap()
    }
}

/// Digits that agree: -log10 of the relative error.
fn digits(got: f64, want: f64) -> f64 {
    -((got / want - 1.0).abs().max(1e-17)).log10()
}

/// NIST StRD certified values of PONTIUS and their standard errors (fixtures/nist/SOURCE.md).
const CERTIFIED: [f64; 3] = [0.673565789473684e-3, 0.732059160401003e-6, -0.316081871345029e-14];
const CERTIFIED_ERRORS: [f64; 3] = [0.107938612033077e-3, 0.157817399981659e-9, 0.486652849992036e-16];

/// Least digits by which a run agrees with the certified values; 0 where the model is not a quadratic.
fn agreement(run: &Run) -> f64 {
    let Some(model) = &run.calibration else { return 0.0 };
    if model["model"]["polynomial"]["coefficients"].as_array().is_none_or(|c| c.len() != 3) {
        return 0.0;
    }
    let pairs = run.polynomial("coefficients").into_iter().zip(CERTIFIED);
    pairs.map(|(got, want)| digits(got, want)).fold(17.0, f64::min)
}

#[test]
fn pontius_gets_its_quadratic_term_and_the_certified_numbers() {
    let run = verify(&fixture("pontius"));
    assert_eq!((run.code, run.verdict()), (0, "effect"), "{}", run.verify["reason"]);
    assert_eq!(run.effects(), ["nonlinearity-quadratic"]);
    assert!(agreement(&run) >= 12.0, "{}", agreement(&run));
    for (got, want) in run.polynomial("standard_errors").into_iter().zip(CERTIFIED_ERRORS) {
        assert!(digits(got, want) >= 11.0, "{got} {want}");
    }
    // F test on the 20 repeated loads: gross for the line, absent for the quadratic (so no cubic).
    assert!(run.lack_of_fit(0, "p_value") < 1e-10);
    assert!((run.lack_of_fit(1, "f") - 0.8107).abs() < 1e-4);
    assert!(run.rmse("after", "response_rmse") < 0.15 * run.rmse("before", "response_rmse"));
    assert_eq!(run.verify["noise_floor"]["source"], "replicates");
    let predictions = fs::read_to_string(run.out.path().join("predictions.csv")).unwrap();
    assert_eq!(predictions.lines().count(), 41);
    predict_round_trip(&run);
}

/// Response at a load, load of a response, and a load beyond the fitted ones.
fn predict_round_trip(run: &Run) {
    let place = run.out.path();
    let calibration = place.join("calibration.json");
    let predict = |table: &str, text: &str| {
        let (table, out) = (place.join(table), place.join("predicted.csv"));
        fs::write(&table, text).unwrap();
        let [t, c, o] = [&table, &calibration, &out].map(|p| p.to_str().unwrap());
        let done = wcal(&["predict", t, "--calibration", c, "--out", o]);
        let stderr = String::from_utf8_lossy(&done.stderr).into_owned();
        let csv = fs::read_to_string(&out).unwrap_or_else(|_| panic!("{stderr}"));
        let cells = csv.lines().nth(1).unwrap().split(',').map(|v| v.parse::<f64>().unwrap());
        (done.status.code().unwrap(), cells.collect::<Vec<f64>>())
    };
    let (code, row) = predict("forward.csv", "stimulus\n1234567\n");
    let x = 1_234_567.0;
    let by_hand = CERTIFIED[0] + CERTIFIED[1] * x + CERTIFIED[2] * x * x;
    assert_eq!(code, 0);
    assert!(digits(row[2], by_hand) > 9.0, "{} {by_hand}", row[2]);
    // Half width: noise of one reading mostly, sd 2.05e-4 and t(37) = 2.03.
    assert!((4.1e-4..4.6e-4).contains(&row[3]), "{}", row[3]);
    let (code, row) = predict("inverse.csv", &format!("response\n{by_hand}\n"));
    assert_eq!(code, 0);
    assert!((row[2] / x - 1.0).abs() < 1e-9, "{}", row[2]);
    let (code, row) = predict("beyond.csv", "stimulus\n9000000\n");
    assert_eq!((code, row[4]), (4, 1.0));
}

#[test]
fn a_changed_pontius_does_not_pass() {
    // One reading off by ten noise standard deviations: the digits are lost.
    let moved = disturbed("pontius", |k, c| {
        let y: f64 = c[3].parse().unwrap();
        format!("{},{},{},{}", c[0], c[1], c[2], y + if k == 5 { 2e-3 } else { 0.0 })
    });
    assert!(agreement(&verify(moved.path())) < 6.0);
    // Columns swapped.
    let swapped = disturbed("pontius", |_, c| format!("{},{},{},{}", c[0], c[1], c[3], c[2]));
    assert!(agreement(&verify(swapped.path())) < 1.0);
    // Response in another unit, off by 1000.
    let unit = disturbed("pontius", |_, c| {
        format!("{},{},{},{}", c[0], c[1], c[2], 1e3 * c[3].parse::<f64>().unwrap())
    });
    assert!(agreement(&verify(unit.path())) < 1.0);
    // One row in another unit: never the plain quadratic.
    let row = disturbed("pontius", |k, c| {
        let y: f64 = c[3].parse().unwrap();
        format!("{},{},{},{}", c[0], c[1], c[2], y * if k == 7 { 1e3 } else { 1.0 })
    });
    assert_ne!(verify(row.path()).effects(), ["nonlinearity-quadratic"]);
    // The bend taken out: nothing is left to find.
    let straight = disturbed("pontius", |_, c| {
        let (x, y): (f64, f64) = (c[2].parse().unwrap(), c[3].parse().unwrap());
        format!("{},{},{},{}", c[0], c[1], c[2], y - CERTIFIED[2] * x * x)
    });
    let run = verify(straight.path());
    assert_eq!((run.code, run.verdict()), (0, "adequate"), "{}", run.verify["reason"]);
}

#[test]
fn loadcell_gets_its_quadratic_term() {
    let run = verify(&fixture("loadcell"));
    assert_eq!((run.code, run.verdict()), (0, "effect"), "{}", run.verify["reason"]);
    assert_eq!(run.effects(), ["nonlinearity-quadratic"]);
    // e-Handbook mpc365, printed with six digits.
    for (got, want) in run.polynomial("coefficients").into_iter().zip([-1.83980e-5, 0.10010249, 7.03187e-6]) {
        assert!(digits(got, want) > 5.0, "{got} {want}");
    }
    assert!(run.lack_of_fit(0, "p_value") < 1e-10 && run.lack_of_fit(1, "p_value") > 0.05);
    // The table is sorted by load: no claim rests on the order of its rows.
    let rows = run.verify["detectable"].as_array().unwrap();
    for id in ["drift", "step"] {
        let row = rows.iter().find(|d| d["id"] == id).unwrap();
        assert_eq!(row["status"], "not-observable", "{row}");
    }
}

#[test]
fn berger_spread_grows_with_the_stimulus() {
    let run = verify(&fixture("berger1"));
    assert_eq!(run.code, 4);
    assert!(run.effects().contains(&"heteroscedastic-noise"), "{}", run.verify["reason"]);
    let named = |run: &Run| -> Option<f64> {
        let effects = run.verify["effects"].as_array().unwrap().clone();
        let spread = effects.into_iter().find(|e| e["id"] == "heteroscedastic-noise")?;
        spread["parameters"][0]["interval95"][0].as_f64()
    };
    assert!(named(&run).unwrap() > 0.0, "it grows");
    // Negative control: the scatter dealt out anew, without regard to the stimulus (row k takes the residual of row 53 k + 7 mod 107).
    let text = fs::read_to_string(fixture("berger1").join("points.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|l| l.split(',').skip(2).map(|v| v.parse().unwrap()).collect()).collect();
    let residual = |k: usize| rows[k][1] - (4.99368 + 0.731111 * rows[k][0]);
    let dealt = disturbed("berger1", |k, c| {
        let y = 4.99368 + 0.731111 * rows[k][0] + residual((53 * k + 7) % 107);
        format!("{},{},{},{y},{}", c[0], c[1], c[2], c[4])
    });
    assert!(!verify(dealt.path()).effects().contains(&"heteroscedastic-noise"));
}

#[test]
fn lew_is_periodic_and_not_steady() {
    let run = verify(&fixture("lew"));
    assert_eq!((run.code, run.verdict()), (0, "effect"));
    let effects = run.verify["effects"].as_array().unwrap();
    let periodic = effects.iter().find(|e| e["id"] == "periodic").unwrap();
    let parameters = periodic["parameters"].as_array().unwrap();
    let frequency = parameters.iter().find(|p| p["name"] == "frequency").unwrap()["value"].as_f64().unwrap();
    assert!((frequency - 0.3018).abs() < 3e-4, "true least squares 0.3018, found {frequency}");
    assert!(run.verify["reason"].as_str().unwrap().contains("not steady"));
    assert!(run.rmse("after", "response_rmse") < 0.6 * run.rmse("before", "response_rmse"));
    // Negative control: the same readings in another order hold no period.
    let text = fs::read_to_string(fixture("lew").join("points.csv")).unwrap();
    let y: Vec<String> = text.lines().skip(1).map(|l| l.split(',').nth(3).unwrap().to_owned()).collect();
    let mixed =
        disturbed("lew", |k, c| format!("{},{},{},{}", c[0], c[1], c[2], y[(k * k + 77 * k) * 3 % 200]));
    let run = verify(mixed.path());
    assert!(!run.verify["reason"].as_str().unwrap().contains("not steady"), "{}", run.verify["reason"]);
}

/// A fair, repeatable sequence between -1 and 1 (made data).
fn scatter(k: usize) -> f64 {
    let h = (k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((h >> 11) as f64 / (1u64 << 53) as f64) * 2.0 - 1.0
}

/// `n` readings of an axis running to and fro over 10 mm; `error_um` beyond the scatter of 1 um.
fn axis_table(n: usize, error_um: impl Fn(f64, f64) -> f64) -> String {
    let rows: Vec<String> = (0..n)
        .map(|k| {
            let place = k % 40;
            let (x, way) =
                if place < 20 { (0.5 * place as f64, 1.0) } else { (0.5 * (40 - place) as f64, -1.0) };
            let measured = x + 1e-3 * (4.0 + error_um(x, way) + scatter(k));
            format!("{k},calibration,{x},{measured},{},{way}", 2 * k)
        })
        .collect();
    format!("point,role,commanded_mm,measured_mm,t_s,direction\n{}", rows.join("\n"))
}

#[test]
fn an_axis_shows_its_backlash_and_predicts_with_it() {
    let run = verify(session(AXIS, &axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 })).path());
    assert_eq!((run.code, run.effects()), (0, vec!["backlash"]), "{}", run.verify["reason"]);
    assert!(run.rmse("after", "error_rmse_um") < 0.3 * run.rmse("before", "error_rmse_um"));
    assert!(run.verify["noise_floor"]["error_um"].as_f64().unwrap() < 1.0);
    let place = run.out.path();
    let [table, calibration, out] = ["new.csv", "calibration.json", "new-out.csv"].map(|n| place.join(n));
    let predict = |text: &str| {
        fs::write(&table, text).unwrap();
        let [t, c, o] = [&table, &calibration, &out].map(|p| p.to_str().unwrap());
        wcal(&["predict", t, "--calibration", c, "--out", o])
    };
    let done = predict("commanded_mm,direction,t_s\n2,1,0\n5,1,1\n3,-1,2\n");
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let csv = fs::read_to_string(&out).unwrap();
    let error =
        |line: usize| csv.lines().nth(line).unwrap().split(',').nth(2).unwrap().parse::<f64>().unwrap();
    assert!((error(1) - 4.0).abs() < 0.5 && (error(3) - 10.0).abs() < 0.5, "{csv}");
    // Without direction and time the effect cannot be predicted: said, not guessed.
    let done = predict("commanded_mm\n2\n5\n");
    assert_eq!(done.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&done.stderr).contains("direction"));
    // Negative control: no backlash, nothing named.
    let run = verify(session(AXIS, &axis_table(120, |_, _| 0.0)).path());
    assert_eq!((run.code, run.verdict()), (0, "adequate"), "{}", run.verify["reason"]);
}

fn line_table(n: usize, header: &str, row: impl Fn(usize, f64, f64) -> String) -> String {
    let rows: Vec<String> = (0..n)
        .map(|k| {
            let x = 1.0 + (k % 10) as f64;
            row(k, x, 0.1 + 0.2 * x + 0.01 * scatter(k))
        })
        .collect();
    format!("{header}\n{}", rows.join("\n"))
}

#[test]
fn broken_input_is_refused_or_narrowed_and_never_a_panic() {
    let plain = "point,role,stimulus,response";
    let timed = "point,role,stimulus,response,t_s";
    let refused = [
        (
            "too few rows",
            TRANSDUCER,
            line_table(5, plain, |k, x, y| format!("{k},calibration,{x},{y}")),
            "at least 8",
        ),
        (
            "constant stimulus",
            TRANSDUCER,
            line_table(30, plain, |k, _, y| format!("{k},calibration,3,{y}")),
            "different stimuli",
        ),
        (
            "clock backwards",
            TRANSDUCER,
            line_table(30, timed, |k, x, y| format!("{k},calibration,{x},{y},{}", (k + 15) % 30)),
            "clock runs backwards",
        ),
        ("too few rows of an axis", AXIS, axis_table(5, |_, _| 0.0), "at least 8"),
        (
            "axis clock backwards",
            AXIS,
            axis_table(60, |_, _| 0.0).replace(",60,-1\n", ",6,-1\n"),
            "clock runs backwards",
        ),
    ];
    for (name, toml, table, says) in &refused {
        let run = verify(session(toml, table).path());
        let reason = run.verify["reason"].as_str().unwrap();
        assert_eq!((run.code, run.verdict()), (1, "refused"), "{name}: {reason}");
        assert!(reason.contains(says), "{name}: {reason}");
        assert!(run.calibration.is_none() && run.effects().is_empty(), "{name}");
    }
    // Errors: exit code 1, one message, no result but a verify.json that refuses.
    let nan = line_table(30, plain, |k, x, y| {
        format!("{k},calibration,{x},{}", if k == 4 { "NaN".to_owned() } else { y.to_string() })
    });
    let rows: Vec<String> = axis_table(60, |_, _| 0.0)
        .lines()
        .enumerate()
        .map(|(k, l)| {
            let c: Vec<&str> = l.split(',').collect();
            let um = if k == 0 { c[3].to_owned() } else { (1e3 * c[3].parse::<f64>().unwrap()).to_string() };
            format!("{},{},{},{um},{},{}", c[0], c[1], c[2], c[4], c[5])
        })
        .collect();
    for (name, toml, table, says) in [
        ("NaN", TRANSDUCER, nan, vec!["points.csv", "line 6", "response", "NaN"]),
        ("um for mm", AXIS, rows.join("\n"), vec!["measured_mm", "um"]),
    ] {
        let folder = session(toml, &table);
        let out = folder.path().join("out");
        let run = wcal(&["verify", folder.path().to_str().unwrap(), "--out", out.to_str().unwrap()]);
        let stderr = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{name}: {stderr}");
        assert!(says.iter().all(|s| stderr.contains(s)) && !stderr.contains("panicked"), "{name}: {stderr}");
        let left: Vec<_> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["verify.json"], "{name}: nothing but the refusal");
    }
    // Narrower claims: nothing repeated, a constant response, a constant covariate.
    let once: String = (0..30)
        .map(|k| format!("\n{k},calibration,{},{}", k, 0.2 * f64::from(k) + 0.01 * scatter(k as usize)))
        .collect();
    let run = verify(session(TRANSDUCER, &format!("{plain}{once}")).path());
    assert_eq!((run.code, run.verdict()), (0, "adequate"), "{}", run.verify["reason"]);
    assert_eq!(run.verify["noise_floor"]["source"], "difference");
    let flat = line_table(30, plain, |k, x, _| format!("{k},calibration,{x},0.5"));
    let run = verify(session(TRANSDUCER, &flat).path());
    assert!(run.effects().is_empty(), "{}", run.verify["reason"]);
    let constant = line_table(30, "point,role,stimulus,response,temperature_degc,gain", |k, x, y| {
        format!("{k},calibration,{x},{y},21.5,3")
    });
    let run = verify(session(TRANSDUCER, &constant).path());
    let rows = run.verify["detectable"].as_array().unwrap();
    for id in ["temperature", "cross-axis", "lag", "creep"] {
        assert_eq!(rows.iter().find(|d| d["id"] == id).unwrap()["status"], "not-observable", "{id}");
    }
    // A holdout that was in the fit.
    let folder = session(
        &TRANSDUCER.replace("points = \"points.csv\"", "points = \"points.csv\"\nholdout = \"holdout.csv\""),
        &line_table(30, plain, |k, x, y| format!("{k},calibration,{x},{y}")),
    );
    let copied = line_table(12, plain, |k, x, y| format!("{k},holdout,{x},{y}"));
    fs::write(folder.path().join("holdout.csv"), copied).unwrap();
    let run = verify(folder.path());
    assert_eq!((run.code, run.verdict()), (1, "refused"), "{}", run.verify["reason"]);
}

/// A table whose response bends, so that an effect is found and a calibration is verified.
fn bent_table(rows: usize) -> String {
    line_table(rows, "point,role,stimulus,response", |k, x, y| {
        format!("{k},calibration,{x},{}", y + 0.02 * x * x)
    })
}

#[test]
fn a_refusal_leaves_nothing_of_an_earlier_run_but_the_record_of_unsealing() {
    let sealed =
        TRANSDUCER.replace("points = \"points.csv\"", "points = \"points.csv\"\nholdout = \"holdout.csv\"");
    let folder = session(&sealed, &bent_table(40));
    let holdout = line_table(12, "point,role,stimulus,response", |k, x, y| {
        format!("{k},holdout,{},{}", x + 0.5, y + 0.1 + 0.02 * (x + 0.5) * (x + 0.5))
    });
    fs::write(folder.path().join("holdout.csv"), holdout).unwrap();
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("out");
    let run = |more: &[&str]| {
        let fixed = ["verify", folder.path().to_str().unwrap(), "--out", out.to_str().unwrap()];
        wcal(&[&fixed[..], more].concat())
    };
    let names = || {
        let mut names: Vec<String> = fs::read_dir(&out)
            .unwrap()
            .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names.retain(|name| name != "unsealed.json");
        names
    };
    let done = run(&[]);
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(names(), ["calibration.json", "predictions.csv", "report.html", "report.json", "verify.json"]);
    // Data that the checks refuse.
    let good = fs::read_to_string(folder.path().join("points.csv")).unwrap();
    let few: Vec<&str> = good.lines().take(6).collect();
    fs::write(folder.path().join("points.csv"), few.join("\n")).unwrap();
    assert_eq!(run(&[]).status.code(), Some(1));
    assert_eq!(names(), ["report.html", "report.json", "verify.json"]);
    // A whole result again, then a table that cannot even be read.
    fs::write(folder.path().join("points.csv"), &good).unwrap();
    assert_eq!(run(&[]).status.code(), Some(0));
    assert_eq!(names().len(), 5);
    let text = fs::read_to_string(out.join("verify.json")).unwrap();
    assert!(text.contains("unsealed before"), "the second look is known as one: {text}");
    fs::write(folder.path().join("points.csv"), good.replace("calibration", "mystery")).unwrap();
    assert_eq!(run(&[]).status.code(), Some(1));
    assert_eq!(names(), ["verify.json"]);
    // Negative control: a run that fails for its arguments changes nothing.
    fs::write(folder.path().join("points.csv"), &good).unwrap();
    assert_eq!(run(&[]).status.code(), Some(0));
    assert_eq!(run(&["--accept", "creep"]).status.code(), Some(1));
    assert_eq!(names().len(), 5);
}

#[test]
fn warnings_about_the_session_are_exit_code_3() {
    let folder = session(&TRANSDUCER.replace("[files]", "surprise = 1\n[files]"), &bent_table(40));
    let run = verify(folder.path());
    assert_eq!((run.code, run.verdict()), (3, "effect"), "{}", run.verify["reason"]);
}

/// Columns of a table by name.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let header: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let index = header.iter().position(|h| *h == name).unwrap_or_else(|| panic!("{name} in {header:?}"));
    csv.lines().skip(1).map(|l| l.split(',').nth(index).unwrap().parse().unwrap_or(f64::NAN)).collect()
}

#[test]
fn measured_values_stand_beside_their_residuals() {
    let table = bent_table(40);
    let run = verify(session(TRANSDUCER, &table).path());
    let csv = fs::read_to_string(run.out.path().join("predictions.csv")).unwrap();
    let [x, measured, before, after] =
        ["stimulus", "response_measured", "response_before", "response_after"].map(|n| column(&csv, n));
    assert_eq!((&x, &measured), (&column(&table, "stimulus"), &column(&table, "response")));
    for (k, r) in column(&csv, "residual_after").into_iter().enumerate() {
        assert!((r - (measured[k] - after[k])).abs() < 1e-12 && r.abs() < 0.05, "{r}");
    }
    for (k, r) in column(&csv, "residual_before").into_iter().enumerate() {
        assert!((r - (measured[k] - before[k])).abs() < 1e-12, "{r}");
    }
    let axis = verify(session(AXIS, &axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 })).path());
    let csv = fs::read_to_string(axis.out.path().join("predictions.csv")).unwrap();
    let given = axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 });
    assert_eq!(column(&csv, "commanded_mm"), column(&given, "commanded_mm"));
    let (got, wanted) = (column(&csv, "measured_mm"), column(&given, "measured_mm"));
    assert!(got.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{csv}");
    assert!(column(&csv, "residual_um_after").iter().all(|r| r.abs() < 3.0), "{csv}");
    // `predict` on tables with the measured value.
    let predict = |run: &Run, text: &str| {
        let [table, calibration, out] =
            ["t.csv", "calibration.json", "p.csv"].map(|n| run.out.path().join(n));
        fs::write(&table, text).unwrap();
        let [t, c, o] = [&table, &calibration, &out].map(|p| p.to_str().unwrap());
        let done = wcal(&["predict", t, "--calibration", c, "--out", o]);
        assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
        fs::read_to_string(out).unwrap()
    };
    let csv = predict(&run, "stimulus,response\n3,1.25\n4,\n");
    let (value, residual) = (column(&csv, "response"), column(&csv, "residual"));
    assert!((residual[0] - (1.25 - value[0])).abs() < 1e-12 && residual[1].is_nan(), "{csv}");
    assert_eq!(column(&csv, "response_measured")[0], 1.25);
    // Negative control: without the value there are no such columns.
    assert!(!predict(&run, "stimulus\n3\n").contains("residual"));
    let csv =
        predict(&axis, "commanded_mm,measured_mm,direction,t_s\n2,2.005,1,0\n5,5.004,1,1\n3,3.01,-1,2\n");
    let (error, residual) = (column(&csv, "error_um"), column(&csv, "residual_um"));
    assert!((residual[0] - (5.0 - error[0])).abs() < 1e-9, "{csv}");
}

/// Everything that `verify` says of a session: terminal, document, page and table.
fn all_words(folder: &Path) -> String {
    let out = tempfile::tempdir().unwrap();
    let run = wcal(&["verify", folder.to_str().unwrap(), "--out", out.path().to_str().unwrap()]);
    let mut text = String::from_utf8_lossy(&run.stdout).into_owned();
    for name in ["verify.json", "report.html", "predictions.csv"] {
        text += &fs::read_to_string(out.path().join(name)).unwrap();
    }
    text
}

#[test]
fn an_axis_speaks_of_commanded_and_measured_positions() {
    let backlash = axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 });
    let bent = axis_table(120, |x, _| 0.6 * (x - 5.0) * (x - 5.0));
    for table in [backlash, bent] {
        let text = all_words(session(AXIS, &table).path());
        let words: Vec<&str> =
            text.lines().filter(|l| l.contains("stimul") || l.contains("response")).take(5).collect();
        assert!(words.is_empty(), "{words:?}");
        assert!(text.contains("commanded"));
    }
    // Negative control: a transducer has both.
    let text = all_words(session(TRANSDUCER, &bent_table(40)).path());
    assert!(text.contains("stimulus") && text.contains("response") && !text.contains("commanded"));
}

#[test]
fn units_are_composed_from_the_declared_ones() {
    let unit_of = |stimulus: &str, response: &str| {
        let toml = TRANSDUCER
            .replace("stimulus_unit = \"N\"", &format!("stimulus_unit = \"{stimulus}\""))
            .replace("response_unit = \"V\"", &format!("response_unit = \"{response}\""));
        let folder = session(&toml, &bent_table(40));
        let out = tempfile::tempdir().unwrap();
        let run = wcal(&["verify", folder.path().to_str().unwrap(), "--out", out.path().to_str().unwrap()]);
        let v: Value = serde_json::from_slice(&fs::read(out.path().join("verify.json")).unwrap()).unwrap();
        let unit = v["effects"][0]["parameters"][0]["unit"].as_str().unwrap_or_default().to_owned();
        (unit, String::from_utf8_lossy(&run.stdout).into_owned())
    };
    for (stimulus, response, composed) in
        [("1", "1", "1"), ("N", "V", "V/N^2"), ("1/m", "pm", "pm/(1/m)^2"), ("kPa", "1", "1/kPa^2")]
    {
        let (unit, text) = unit_of(stimulus, response);
        assert_eq!(unit, composed, "{text}");
        assert!(!text.contains("unit of the response"), "{text}");
        assert_eq!(response == "V", text.contains(" V (") && text.contains("response_rmse V"), "{text}");
    }
}

#[test]
fn the_replicate_of_an_axis_is_its_cycle() {
    let place = tempfile::tempdir().unwrap();
    let table: Vec<String> = axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 })
        .lines()
        .enumerate()
        .map(|(k, line)| if k == 0 { format!("{line},run") } else { format!("{line},{}", 1 + (k - 1) / 40) })
        .collect();
    let file = place.path().join("t.csv");
    fs::write(&file, table.join("\n")).unwrap();
    let import = |out: &Path, more: &[&str]| {
        let fixed =
            ["import", file.to_str().unwrap(), "--kind", "axis", "--commanded", "commanded_mm", "--measured"];
        wcal(&[&fixed[..], &["measured_mm", "--out", out.to_str().unwrap()], more].concat())
    };
    let (with, without) = (place.path().join("with"), place.path().join("without"));
    let done = import(&with, &["--replicate", "run"]);
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let run = verify(&with);
    assert_eq!(run.verify["after"]["split"], "loto", "{}", run.verify["reason"]);
    assert!(run.verify["reason"].as_str().unwrap().contains("3 cycles"), "{}", run.verify["reason"]);
    // A table by another hand that has the column.
    let points = fs::read_to_string(with.join("points.csv")).unwrap();
    let own = verify(session(AXIS, points.replacen("cycle", "replicate", 1).trim_end()).path());
    assert_eq!((own.code, &own.verify["after"]["split"]), (0, &Value::from("loto")));
    // Negative controls: no repetition is named; both names are.
    assert_eq!(import(&without, &[]).status.code(), Some(0));
    assert_eq!(verify(&without).verify["after"]["split"], "loo");
    let both = import(&place.path().join("both"), &["--replicate", "run", "--cycle", "run"]);
    assert!(String::from_utf8_lossy(&both.stderr).contains("--replicate"));
}

#[test]
fn a_table_from_a_simulation_is_marked_from_import_to_predict() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let (table, read) = (fixture("pontius/points.csv"), |name: &str| fs::read_to_string(at(name)).unwrap());
    for (name, flag) in [("marked", Some("--simulated")), ("measured", None)] {
        let marked = flag.is_some();
        let (session, out, csv) = (at(name), at(&format!("{name}-out")), at(&format!("{name}.csv")));
        let import =
            ["import", table.to_str().unwrap(), "--kind", "transducer", "--model", "linear", "--stimulus"];
        let more = ["stimulus", "--response", "response", "--out", &session];
        let run = wcal(&[&import[..], &more, &flag.into_iter().collect::<Vec<_>>()].concat());
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        let said = String::from_utf8_lossy(&wcal(&["verify", &session, "--out", &out]).stdout).into_owned();
        assert_eq!(said.starts_with(&format!("{name} (SIMULATED): ")), marked, "{said}");
        let calibration = format!("{out}/calibration.json");
        let run = wcal(&["predict", table.to_str().unwrap(), "--calibration", &calibration, "--out", &csv]);
        assert_eq!(String::from_utf8_lossy(&run.stderr).contains("SIMULATED"), marked);
        for table in [format!("{name}.csv"), format!("{name}-out/predictions.csv")] {
            assert_eq!(read(&table).lines().next().unwrap().ends_with(",simulated"), marked, "{table}");
        }
        for page in ["report.html", "verify.json", "calibration.json"] {
            let text = read(&format!("{name}-out/{page}"));
            assert_eq!(text.contains("SIMULATED") || text.contains("\"simulated\": true"), marked, "{page}");
        }
    }
    // A measured session to which a simulated one is added is not measured any more.
    let (both, marked) = (at("both"), at("marked"));
    let text = read("marked/points.csv").replacen("1,calibration", "1,verification", 1);
    fs::write(format!("{marked}/points.csv"), text).unwrap();
    let run = wcal(&["verify", &at("measured"), "--add", &marked, "--out", &both]);
    assert!(String::from_utf8_lossy(&run.stderr).contains("measured and SIMULATED sessions are joined"));
    assert!(String::from_utf8_lossy(&run.stdout).starts_with("measured (SIMULATED): "));
}

/// The place of a step between two readings has no derivative: it gets the interval in which the readings cannot tell, and no NaN travels.
#[test]
fn a_step_goes_from_import_to_predict_and_a_file_is_not_fitted_and_held_out() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    // Digits of a sine stand for noise; the step is nine of its standard deviations.
    let rows: Vec<String> = (0..60)
        .map(|k| {
            let (t, x) = (10.0 * f64::from(k + 1), f64::from(k % 20) / 2.0);
            let noise = 0.01
                * (2.0 * (f64::from(k).mul_add(12.9898, 78.233).sin() * 43758.5453).rem_euclid(1.0) - 1.0);
            format!("{t},{x},{:.6}", 0.1 + 0.2 * x + noise + if k >= 30 { 0.05 } else { 0.0 })
        })
        .collect();
    fs::write(at("t.csv"), format!("t_s,stimulus,response\n{}\n", rows.join("\n"))).unwrap();
    let import =
        ["import", &at("t.csv"), "--kind", "transducer", "--model", "linear", "--stimulus", "stimulus"];
    let run = wcal(&[&import[..], &["--response", "response", "--out", &at("s")]].concat());
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let run = wcal(&["verify", &at("s"), "--out", &at("v"), "--json"]);
    let verify: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!((run.status.code(), &verify["effects"][0]["id"]), (Some(0), &"step".into()), "{verify}");
    // A place between two readings moves no prediction; the step's size, which does, is not named so (control).
    let sentences = verify["identifiability"].to_string();
    assert!(sentences.contains("moves no prediction") && !sentences.contains("size"), "{sentences}");
    let worth = &verify["leave_one_effect_out"][0];
    assert!(worth["id"] == "step" && worth["misfit_ratio"].as_f64().unwrap() > 1.5, "{worth}");
    let where_ = &verify["effects"][0]["parameters"][0]["interval95"];
    assert_eq!([&where_[0], &where_[1]].map(|v| v.as_f64().unwrap().round()), [300.0, 310.0], "{where_}");
    let run =
        wcal(&["predict", &at("t.csv"), "--calibration", &at("v/calibration.json"), "--out", &at("p.csv")]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let text = fs::read_to_string(at("p.csv")).unwrap();
    assert!(text.lines().count() == 61 && !text.contains("NaN"), "{text}");
    // Readings that are fitted cannot be held out; the record of unsealing needs a holdout.
    let run = wcal(&["verify", &at("s"), "--holdout", &at("s"), "--out", &at("w")]);
    assert!(String::from_utf8_lossy(&run.stderr).contains("which is fitted"), "{run:?}");
    assert!(!place.path().join("s/unsealed.json").exists());
}

/// A calibration is judged on a later session: it holds where the instrument is the same and does not where its zero has moved.
#[test]
fn a_calibration_is_judged_on_readings_that_it_was_not_fitted_to() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    // Sums of twelve uniform numbers from a linear congruential generator: close to normal.
    let mut state = 7_u64;
    let mut normal = || {
        (0..12)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
            })
            .sum::<f64>()
    };
    for (name, moved) in [("first", 0.0), ("later", 0.0), ("moved", 0.05)] {
        let rows: Vec<String> = (0..80)
            .map(|k| {
                let x = f64::from(k % 20) / 2.0;
                format!("{x},{:.6}", 0.1 + 0.2 * x + moved + 0.01 * normal())
            })
            .collect();
        fs::write(at("t.csv"), format!("stimulus,response\n{}\n", rows.join("\n"))).unwrap();
        let import = ["import", &at("t.csv"), "--kind", "transducer", "--model", "linear", "--stimulus"];
        let more = ["stimulus", "--response", "response", "--out", &at(name)];
        assert!(wcal(&[&import[..], &more].concat()).status.success());
    }
    let run = wcal(&["verify", &at("first"), "--out", &at("v"), "--valid-days", "365"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let read = |path: &str| -> Value { serde_json::from_slice(&fs::read(at(path)).unwrap()).unwrap() };
    assert!(read("v/calibration.json")["expires"].as_str().unwrap().len() > 10);
    let calibration = at("v/calibration.json");
    for (session, holds) in [("later", true), ("moved", false)] {
        let out = format!("by-{session}");
        let run =
            wcal(&["verify", &at(session), "--calibration", &calibration, "--out", &at(&out), "--json"]);
        let verify: Value = serde_json::from_slice(&run.stdout)
            .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&run.stderr)));
        assert_eq!(verify["calibration"]["holds"], holds, "{}", verify["calibration"]);
        let failed = place.path().join(&out).join("judged-calibration.json");
        assert_eq!(failed.exists(), !holds);
        if !holds {
            assert_eq!(read("by-moved/judged-calibration.json")["verification"], "failed");
            // It is refused where it is used.
            let used = wcal(&[
                "predict",
                &at("t.csv"),
                "--calibration",
                failed.to_str().unwrap(),
                "--out",
                &at("p"),
            ]);
            assert_eq!(used.status.code(), Some(4), "{}", String::from_utf8_lossy(&used.stderr));
        }
    }
    // Its own readings prove nothing.
    let run = wcal(&["verify", &at("first"), "--calibration", &calibration, "--out", &at("own")]);
    assert_eq!(run.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&run.stderr).contains("not in its fit"), "{run:?}");
}
