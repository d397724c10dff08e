//! From tables through a calibration to predictions, and a calibration judged on later readings.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

#[test]
fn an_axis_shows_its_backlash_and_predicts_with_it() {
    let run = verify(
        session(
            AXIS,
            &axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 }),
        )
        .path(),
    );
    assert_eq!(
        (run.code, run.effects()),
        (0, vec!["backlash"]),
        "{}",
        run.verify["reason"]
    );
    assert!(run.rmse("after", "error_rmse_um") < 0.3 * run.rmse("before", "error_rmse_um"));
    assert!(run.verify["noise_floor"]["error_um"].as_f64().unwrap() < 1.0);
    let place = run.out.path();
    let [table, calibration, out] =
        ["new.csv", "calibration.json", "new-out.csv"].map(|n| place.join(n));
    let predict = |text: &str| {
        fs::write(&table, text).unwrap();
        let [t, c, o] = [&table, &calibration, &out].map(|p| p.to_str().unwrap());
        wcal(&["predict", t, "--calibration", c, "--out", o])
    };
    let done = predict("commanded_mm,direction,t_s\n2,1,0\n5,1,1\n3,-1,2\n");
    assert_eq!(
        done.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let csv = fs::read_to_string(&out).unwrap();
    let error = |line: usize| {
        csv.lines()
            .nth(line)
            .unwrap()
            .split(',')
            .nth(2)
            .unwrap()
            .parse::<f64>()
            .unwrap()
    };
    assert!(
        (error(1) - 4.0).abs() < 0.5 && (error(3) - 10.0).abs() < 0.5,
        "{csv}"
    );
    // Without direction and time it is the mean of both, 7 um, and the width holds half of what lies
    // between them; it is said.
    let done = predict("commanded_mm\n2\n5\n");
    assert_eq!(done.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&done.stderr).contains("direction"));
    let csv = fs::read_to_string(&out).unwrap();
    let column = |k: usize| {
        let cell = csv.lines().nth(1).unwrap().split(',').nth(k).unwrap();
        cell.parse::<f64>().unwrap()
    };
    assert!((column(2) - 7.0).abs() < 0.5 && column(3) > 3.0, "{csv}");
    // Without a file the same table is on stdout.
    let [t, c] = [&table, &calibration].map(|p| p.to_str().unwrap());
    let printed = wcal(&["predict", t, "--calibration", c]);
    assert_eq!(String::from_utf8_lossy(&printed.stdout), csv);
    // Negative control: no backlash, nothing named.
    let run = verify(session(AXIS, &axis_table(120, |_, _| 0.0)).path());
    assert_eq!(
        (run.code, run.verdict()),
        (0, "adequate"),
        "{}",
        run.verify["reason"]
    );
}

#[test]
fn a_table_from_a_simulation_is_marked_from_import_to_predict() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let (table, read) = (nist("pontius/points.csv"), |name: &str| {
        fs::read_to_string(at(name)).unwrap()
    });
    for (name, marked) in [("measured", false), ("marked", true)] {
        let own = place.path().join(format!("{name}-tables"));
        fs::create_dir(&own).unwrap();
        fs::copy(&table, own.join("t.csv")).unwrap();
        if marked {
            fs::write(own.join("SIMULATED"), "").unwrap();
        }
        let table = own.join("t.csv");
        let (session, out, csv) = (
            at(name),
            at(&format!("{name}-out")),
            at(&format!("{name}.csv")),
        );
        let import = [
            "import",
            table.to_str().unwrap(),
            "--kind",
            "transducer",
            "--model",
            "linear",
            "--stimulus",
        ];
        let more = ["stimulus", "--response", "response", "--out", &session];
        let run = wcal(&[&import[..], &more].concat());
        assert!(
            run.status.success(),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
        let said = String::from_utf8_lossy(&wcal(&["verify", &session, "--out", &out]).stdout)
            .into_owned();
        assert_eq!(
            said.starts_with(&format!("{name} (SIMULATED): ")),
            marked,
            "{said}"
        );
        let calibration = format!("{out}/calibration.json");
        let run = wcal(&[
            "predict",
            table.to_str().unwrap(),
            "--calibration",
            &calibration,
            "--out",
            &csv,
        ]);
        assert_eq!(
            String::from_utf8_lossy(&run.stderr).contains("SIMULATED"),
            marked
        );
        for table in [format!("{name}.csv"), format!("{name}-out/predictions.csv")] {
            assert_eq!(
                read(&table).lines().next().unwrap().ends_with(",simulated"),
                marked,
                "{table}"
            );
        }
        for page in ["report.html", "verify.json", "calibration.json"] {
            let text = read(&format!("{name}-out/{page}"));
            assert_eq!(
                text.contains("SIMULATED") || text.contains("\"simulated\": true"),
                marked,
                "{page}"
            );
        }
    }
    // A measured session to which a simulated one is added is not measured any more.
    let (both, marked) = (at("both"), at("marked"));
    let text = read("marked/points.csv").replacen("1,calibration", "1,verification", 1);
    fs::write(format!("{marked}/points.csv"), text).unwrap();
    let run = wcal(&["verify", &at("measured"), "--add", &marked, "--out", &both]);
    assert!(String::from_utf8_lossy(&run.stderr).contains("SIMULATED sessions"));
    assert!(String::from_utf8_lossy(&run.stdout).starts_with("measured (SIMULATED): "));
}

/// The place of a step between two readings has no derivative: it gets the interval in which the
/// readings cannot tell, and no NaN travels.
#[test]
fn a_step_goes_from_import_to_predict_and_a_file_is_not_fitted_and_held_out() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    // Digits of a sine stand for noise; the step is nine of its standard deviations.
    let rows: Vec<String> = (0..60)
        .map(|k| {
            let (t, x) = (10.0 * f64::from(k + 1), f64::from(k % 20) / 2.0);
            let noise = 0.01
                * (2.0
                    * (f64::from(k).mul_add(12.9898, 78.233).sin() * 43758.5453).rem_euclid(1.0)
                    - 1.0);
            format!(
                "{t},{x},{:.6}",
                0.1 + 0.2 * x + noise + if k >= 30 { 0.05 } else { 0.0 }
            )
        })
        .collect();
    fs::write(
        at("t.csv"),
        format!("t_s,stimulus,response\n{}\n", rows.join("\n")),
    )
    .unwrap();
    let import = [
        "import",
        &at("t.csv"),
        "--kind",
        "transducer",
        "--model",
        "linear",
        "--stimulus",
        "stimulus",
    ];
    let run = wcal(&[&import[..], &["--response", "response", "--out", &at("s")]].concat());
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let run = wcal(&["verify", &at("s"), "--out", &at("v"), "--json"]);
    let verify: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(
        (run.status.code(), &verify["effects"][0]["id"]),
        (Some(0), &"step".into()),
        "{verify}"
    );
    let worth = &verify["leave_one_effect_out"][0];
    assert!(
        worth["id"] == "step" && worth["misfit_ratio"].as_f64().unwrap() > 1.5,
        "{worth}"
    );
    let where_ = &verify["effects"][0]["parameters"][0]["interval95"];
    assert_eq!(
        [&where_[0], &where_[1]].map(|v| v.as_f64().unwrap().round()),
        [300.0, 310.0],
        "{where_}"
    );
    let run = wcal(&[
        "predict",
        &at("t.csv"),
        "--calibration",
        &at("v/calibration.json"),
        "--out",
        &at("p.csv"),
    ]);
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let text = fs::read_to_string(at("p.csv")).unwrap();
    assert!(
        text.lines().count() == 61 && !text.contains("NaN"),
        "{text}"
    );
    // Readings that are fitted cannot be held out; the record of unsealing needs a holdout.
    let run = wcal(&["verify", &at("s"), "--holdout", &at("s"), "--out", &at("w")]);
    assert!(
        String::from_utf8_lossy(&run.stderr).contains("which is fitted"),
        "{run:?}"
    );
    assert!(!place.path().join("s/unsealed.json").exists());
}

/// A calibration is judged on a later session: it holds where the instrument is the same and does
/// not where its zero has moved.
#[test]
fn a_calibration_is_judged_on_readings_that_it_was_not_fitted_to() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    // Sums of twelve uniform numbers from a linear congruential generator: close to normal.
    let mut state = 7_u64;
    let mut normal = || {
        (0..12)
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
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
        fs::write(
            at("t.csv"),
            format!("stimulus,response\n{}\n", rows.join("\n")),
        )
        .unwrap();
        let import = [
            "import",
            &at("t.csv"),
            "--kind",
            "transducer",
            "--model",
            "linear",
            "--stimulus",
        ];
        let more = ["stimulus", "--response", "response", "--out", &at(name)];
        assert!(wcal(&[&import[..], &more].concat()).status.success());
    }
    let run = wcal(&["verify", &at("first"), "--out", &at("v")]);
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let read =
        |path: &str| -> Value { serde_json::from_slice(&fs::read(at(path)).unwrap()).unwrap() };
    assert!(
        read("v/calibration.json")["expires"]
            .as_str()
            .unwrap()
            .len()
            > 10
    );
    let calibration = at("v/calibration.json");
    for (session, holds) in [("later", true), ("moved", false)] {
        let out = format!("by-{session}");
        let run = wcal(&[
            "verify",
            &at(session),
            "--calibration",
            &calibration,
            "--out",
            &at(&out),
            "--json",
        ]);
        let verify: Value = serde_json::from_slice(&run.stdout)
            .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&run.stderr)));
        assert_eq!(
            verify["calibration"]["holds"], holds,
            "{}",
            verify["calibration"]
        );
        assert_eq!(
            run.status.code(),
            Some(if holds { 0 } else { 4 }),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
        let failed = place.path().join(&out).join("judged-calibration.json");
        assert_eq!(failed.exists(), !holds);
        if !holds {
            assert_eq!(
                read("by-moved/judged-calibration.json")["verification"],
                "failed"
            );
            // It is refused where it is used.
            let used = wcal(&[
                "predict",
                &at("t.csv"),
                "--calibration",
                failed.to_str().unwrap(),
                "--out",
                &at("p"),
            ]);
            assert_eq!(
                used.status.code(),
                Some(4),
                "{}",
                String::from_utf8_lossy(&used.stderr)
            );
        }
    }
    // Its own readings prove nothing.
    let run = wcal(&[
        "verify",
        &at("first"),
        "--calibration",
        &calibration,
        "--out",
        &at("own"),
    ]);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        String::from_utf8_lossy(&run.stderr).contains("not in its fit"),
        "{run:?}"
    );
}

/// A later mounting has a zero and a clock of its own (SIMULATED).
#[test]
fn a_later_mounting_brings_its_own_zero_and_clock() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    let mut session = |name: &str, zero: f64, clock: bool| {
        let row = |k: i32| {
            let x = f64::from(k % 11);
            let noise: f64 = rng.sample(StandardNormal);
            let time = if clock {
                format!(",{}", 20 * k)
            } else {
                String::new()
            };
            format!("{x},{:.5}{time}\n", zero + 0.2 * x + 0.003 * noise)
        };
        let rows: String = (0..33).map(row).collect();
        let head = if clock {
            "load,signal,t_s\n"
        } else {
            "load,signal\n"
        };
        fs::write(at("t.csv"), format!("{head}{rows}")).unwrap();
        let (table, out) = (at("t.csv"), at(name));
        let import = [
            "import",
            &table,
            "--kind",
            "transducer",
            "--model",
            "linear",
            "--stimulus",
            "load",
        ];
        let time: &[&str] = if clock { &["--time", "t_s"] } else { &[] };
        let all = [&import[..], &["--response", "signal", "--out", &out], time].concat();
        assert!(wcal(&all).status.success());
    };
    let mut joined = |zero: f64, clock: bool| -> Value {
        let [first, second] = ["first", "second"].map(|name| format!("{name}-{zero}-{clock}"));
        session(&first, 0.1, clock);
        session(&second, zero, clock);
        let (first, second, out) = (at(&first), at(&second), at(&format!("out-{zero}-{clock}")));
        let run = wcal(&["verify", &first, "--add", &second, "--out", &out, "--json"]);
        assert_eq!(
            run.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
        serde_json::from_slice(&run.stdout).unwrap()
    };
    for clock in [false, true] {
        let other = joined(0.16, clock);
        let zeros = other["effects"][0]["parameters"][0]["value"]
            .as_f64()
            .unwrap();
        assert_eq!(
            other["effects"][0]["id"], "zero-by-series",
            "{}",
            other["reason"]
        );
        // A contrast: half of what the zeros differ by.
        assert!((zeros.abs() - 0.03).abs() < 0.002, "{zeros}");
        // Control: with the same zero nothing is found.
        let same = joined(0.1, clock);
        assert_eq!(same["verdict"], "adequate", "{}", same["reason"]);
    }
}
