//! What cannot be used, and what a refusal leaves behind.

use super::*;

#[test]
fn broken_input_is_refused_or_narrowed_and_never_a_panic() {
    let plain = "point,role,stimulus,response";
    let timed = "point,role,stimulus,response,t_s";
    let refused = [
        (
            "too few rows",
            TRANSDUCER,
            line_table(3, plain, |k, x, y| format!("{k},calibration,{x},{y}")),
            "at least 4",
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
            line_table(30, timed, |k, x, y| {
                format!("{k},calibration,{x},{y},{}", (k + 15) % 30)
            }),
            "clock runs backwards",
        ),
        (
            "too few rows of an axis",
            AXIS,
            axis_table(3, |_, _| 0.0),
            "at least 4",
        ),
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
        assert_eq!(
            (run.code, run.verdict()),
            (1, "refused"),
            "{name}: {reason}"
        );
        assert!(reason.contains(says), "{name}: {reason}");
        assert!(
            run.calibration.is_none() && run.effects().is_empty(),
            "{name}"
        );
    }
    // Errors: exit code 1, one message, no result but a verify.json that refuses.
    let nan = line_table(30, plain, |k, x, y| {
        format!(
            "{k},calibration,{x},{}",
            if k == 4 {
                "NaN".to_owned()
            } else {
                y.to_string()
            }
        )
    });
    let rows: Vec<String> = axis_table(60, |_, _| 0.0)
        .lines()
        .enumerate()
        .map(|(k, l)| {
            let c: Vec<&str> = l.split(',').collect();
            let um = if k == 0 {
                c[3].to_owned()
            } else {
                (1e3 * c[3].parse::<f64>().unwrap()).to_string()
            };
            format!("{},{},{},{um},{},{}", c[0], c[1], c[2], c[4], c[5])
        })
        .collect();
    for (name, toml, table, says) in [
        (
            "NaN",
            TRANSDUCER,
            nan,
            vec!["points.csv", "line 6", "response", "NaN"],
        ),
        (
            "um for mm",
            AXIS,
            rows.join("\n"),
            vec!["measured_mm", "um"],
        ),
    ] {
        let folder = session(toml, &table);
        let out = folder.path().join("out");
        let run = wcal(&[
            "verify",
            folder.path().to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ]);
        let stderr = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{name}: {stderr}");
        assert!(
            says.iter().all(|s| stderr.contains(s)) && !stderr.contains("panicked"),
            "{name}: {stderr}"
        );
        let left: Vec<_> = fs::read_dir(&out)
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        assert_eq!(left, ["verify.json"], "{name}: nothing but the refusal");
    }
    // Narrower claims: nothing repeated, a constant response, a constant covariate.
    let once: String = (0..30)
        .map(|k| {
            format!(
                "\n{k},calibration,{},{}",
                k,
                0.2 * f64::from(k) + 0.01 * scatter(k as usize)
            )
        })
        .collect();
    let run = verify(session(TRANSDUCER, &format!("{plain}{once}")).path());
    assert_eq!(
        (run.code, run.verdict()),
        (0, "adequate"),
        "{}",
        run.verify["reason"]
    );
    assert_eq!(run.verify["noise_floor"]["source"], "difference");
    let flat = line_table(30, plain, |k, x, _| format!("{k},calibration,{x},0.5"));
    let run = verify(session(TRANSDUCER, &flat).path());
    assert!(run.effects().is_empty(), "{}", run.verify["reason"]);
    let constant = line_table(
        30,
        "point,role,stimulus,response,temperature_degc,gain",
        |k, x, y| format!("{k},calibration,{x},{y},21.5,3"),
    );
    let run = verify(session(TRANSDUCER, &constant).path());
    let rows = run.verify["detectable"].as_array().unwrap();
    for id in ["temperature", "cross-axis", "lag", "creep"] {
        assert_eq!(
            rows.iter().find(|d| d["id"] == id).unwrap()["status"],
            "not-observable",
            "{id}"
        );
    }
}

/// Under a clock a row that is in the fit is no holdout; repeats of a gauge that reads the same
/// again are one.
#[test]
fn a_holdout_of_a_coarse_gauge_is_told_from_a_copied_one() {
    let sealed = TRANSDUCER.replace(
        "points = \"points.csv\"",
        "points = \"points.csv\"\nholdout = \"holdout.csv\"",
    );
    let run = |points: &str, holdout: &str| {
        let folder = session(&sealed, points);
        fs::write(folder.path().join("holdout.csv"), holdout).unwrap();
        let run = verify(folder.path());
        (
            run.verdict().to_owned(),
            run.verify["reason"].as_str().unwrap().to_owned(),
        )
    };
    let dial = |y: f64| (y * 10.0).round() / 10.0;
    // Another run of the gauge: other noise, the same ten positions.
    let other = |k: usize, x: f64| 0.1 + 0.2 * x + 0.01 * scatter(k + 1000);
    let plain = "point,role,stimulus,response";
    let points = line_table(30, plain, |k, x, y| {
        format!("{k},calibration,{x},{}", dial(y))
    });
    let holdout = line_table(10, plain, |k, x, _| {
        format!("{k},holdout,{x},{}", dial(other(k, x)))
    });
    let (verdict, reason) = run(&points, &holdout);
    assert_ne!(verdict, "refused", "{reason}");
    let timed = "point,role,stimulus,response,t_s";
    let points = line_table(30, timed, |k, x, y| {
        format!("{k},calibration,{x},{},{k}", dial(y))
    });
    let later = line_table(10, timed, |k, x, _| {
        format!("{k},holdout,{x},{},{}", dial(other(k, x)), 100 + k)
    });
    assert_ne!(run(&points, &later).0, "refused");
    let copied = line_table(10, timed, |k, x, y| {
        format!("{k},holdout,{x},{},{k}", dial(y))
    });
    let (verdict, reason) = run(&points, &copied);
    assert!(
        verdict == "refused" && reason.contains("points table"),
        "{verdict}: {reason}"
    );
}

#[test]
fn a_refusal_leaves_nothing_of_an_earlier_run_but_the_record_of_unsealing() {
    let sealed = TRANSDUCER.replace(
        "points = \"points.csv\"",
        "points = \"points.csv\"\nholdout = \"holdout.csv\"",
    );
    let folder = session(&sealed, &bent_table(40));
    let holdout = line_table(12, "point,role,stimulus,response", |k, x, y| {
        format!(
            "{k},holdout,{},{}",
            x + 0.5,
            y + 0.1 + 0.02 * (x + 0.5) * (x + 0.5)
        )
    });
    fs::write(folder.path().join("holdout.csv"), holdout).unwrap();
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("out");
    let run = |more: &[&str]| {
        let fixed = [
            "verify",
            folder.path().to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ];
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
    assert_eq!(
        done.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    assert_eq!(
        names(),
        [
            "calibration.json",
            "predictions.csv",
            "report.html",
            "verify.json"
        ]
    );
    // Data that the checks refuse.
    let good = fs::read_to_string(folder.path().join("points.csv")).unwrap();
    let few: Vec<&str> = good.lines().take(4).collect();
    fs::write(folder.path().join("points.csv"), few.join("\n")).unwrap();
    assert_eq!(run(&[]).status.code(), Some(1));
    assert_eq!(names(), ["report.html", "verify.json"]);
    // A whole result again: the same decision is the same look. Another one on the same sealed rows
    // is a second look, and says so.
    fs::write(folder.path().join("points.csv"), &good).unwrap();
    let verified = || -> serde_json::Value {
        assert_eq!(run(&[]).status.code(), Some(0));
        assert_eq!(names().len(), 4);
        serde_json::from_str(&fs::read_to_string(out.join("verify.json")).unwrap()).unwrap()
    };
    let again = verified();
    assert_eq!(again["holdout"]["look"], 1, "{}", again["holdout"]);
    let fewer: Vec<&str> = good.lines().take(31).collect();
    fs::write(folder.path().join("points.csv"), fewer.join("\n")).unwrap();
    let other = verified();
    assert_eq!(other["holdout"]["look"], 2, "{}", other["holdout"]);
    let level = |v: &serde_json::Value| v["holdout"]["level"].as_f64().unwrap();
    assert!(
        (level(&other) - level(&again) / 3.0).abs() < 1e-12,
        "1/2 and 1/6 of the level"
    );
    let calibration = fs::read_to_string(out.join("calibration.json")).unwrap();
    assert!(
        calibration.contains("\"reverified\""),
        "the calibration carries it"
    );
    // Then a table that cannot even be read.
    fs::write(
        folder.path().join("points.csv"),
        good.replace("calibration", "mystery"),
    )
    .unwrap();
    assert_eq!(run(&[]).status.code(), Some(1));
    assert_eq!(names(), ["verify.json"]);
    // Negative control: a run that fails for its arguments changes nothing.
    fs::write(folder.path().join("points.csv"), &good).unwrap();
    assert_eq!(run(&[]).status.code(), Some(0));
    assert_eq!(run(&["--accept", "creep"]).status.code(), Some(1));
    assert_eq!(names().len(), 4);
}

#[test]
fn warnings_about_the_session_are_exit_code_3() {
    let folder = session(
        &TRANSDUCER.replace("[files]", "surprise = 1\n[files]"),
        &bent_table(40),
    );
    let run = verify(folder.path());
    assert_eq!(
        (run.code, run.verdict()),
        (3, "effect"),
        "{}",
        run.verify["reason"]
    );
}
