//! Units, names and columns in what the program says and writes.

use super::*;

#[test]
fn measured_values_stand_beside_their_residuals() {
    let table = bent_table(40);
    let run = verify(session(TRANSDUCER, &table).path());
    let csv = fs::read_to_string(run.out.path().join("predictions.csv")).unwrap();
    let [x, measured, before, after] = [
        "stimulus",
        "response_measured",
        "response_before",
        "response_after",
    ]
    .map(|n| column(&csv, n));
    assert_eq!(
        (&x, &measured),
        (&column(&table, "stimulus"), &column(&table, "response"))
    );
    for (k, r) in column(&csv, "residual_after").into_iter().enumerate() {
        assert!(
            (r - (measured[k] - after[k])).abs() < 1e-12 && r.abs() < 0.05,
            "{r}"
        );
    }
    for (k, r) in column(&csv, "residual_before").into_iter().enumerate() {
        assert!((r - (measured[k] - before[k])).abs() < 1e-12, "{r}");
    }
    let axis = verify(
        session(
            AXIS,
            &axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 }),
        )
        .path(),
    );
    let csv = fs::read_to_string(axis.out.path().join("predictions.csv")).unwrap();
    let given = axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 });
    assert_eq!(column(&csv, "commanded_mm"), column(&given, "commanded_mm"));
    let (got, wanted) = (column(&csv, "measured_mm"), column(&given, "measured_mm"));
    assert!(
        got.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-9),
        "{csv}"
    );
    assert!(
        column(&csv, "residual_um_after")
            .iter()
            .all(|r| r.abs() < 3.0),
        "{csv}"
    );
    // `predict` on tables with the measured value.
    let predict = |run: &Run, text: &str| {
        let [table, calibration, out] =
            ["t.csv", "calibration.json", "p.csv"].map(|n| run.out.path().join(n));
        fs::write(&table, text).unwrap();
        let [t, c, o] = [&table, &calibration, &out].map(|p| p.to_str().unwrap());
        let done = wcal(&["predict", t, "--calibration", c, "--out", o]);
        assert_eq!(
            done.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&done.stderr)
        );
        fs::read_to_string(out).unwrap()
    };
    let csv = predict(&run, "stimulus,response\n3,1.25\n4,\n");
    let (value, residual) = (column(&csv, "response"), column(&csv, "residual"));
    assert!(
        (residual[0] - (1.25 - value[0])).abs() < 1e-12 && residual[1].is_nan(),
        "{csv}"
    );
    assert_eq!(column(&csv, "response_measured")[0], 1.25);
    // Negative control: without the value there are no such columns.
    assert!(!predict(&run, "stimulus\n3\n").contains("residual"));
    let csv = predict(
        &axis,
        "commanded_mm,measured_mm,direction,t_s\n2,2.005,1,0\n5,5.004,1,1\n3,3.01,-1,2\n",
    );
    let (error, residual) = (column(&csv, "error_um"), column(&csv, "residual_um"));
    assert!((residual[0] - (5.0 - error[0])).abs() < 1e-9, "{csv}");
}

/// Everything that `verify` says of a session: terminal, document, page and table.
fn all_words(folder: &Path) -> String {
    let out = tempfile::tempdir().unwrap();
    let run = wcal(&[
        "verify",
        folder.to_str().unwrap(),
        "--out",
        out.path().to_str().unwrap(),
    ]);
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
        let words: Vec<&str> = text
            .lines()
            .filter(|l| l.contains("stimul") || l.contains("response"))
            .take(5)
            .collect();
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
            .replace(
                "stimulus_unit = \"N\"",
                &format!("stimulus_unit = \"{stimulus}\""),
            )
            .replace(
                "response_unit = \"V\"",
                &format!("response_unit = \"{response}\""),
            );
        let folder = session(&toml, &bent_table(40));
        let out = tempfile::tempdir().unwrap();
        let run = wcal(&[
            "verify",
            folder.path().to_str().unwrap(),
            "--out",
            out.path().to_str().unwrap(),
        ]);
        let v: Value =
            serde_json::from_slice(&fs::read(out.path().join("verify.json")).unwrap()).unwrap();
        let unit = v["effects"][0]["parameters"][0]["unit"]
            .as_str()
            .unwrap_or_default()
            .to_owned();
        (unit, String::from_utf8_lossy(&run.stdout).into_owned())
    };
    for (stimulus, response, composed) in [
        ("1", "1", "1"),
        ("N", "V", "V/N^2"),
        ("1/m", "pm", "pm/(1/m)^2"),
        ("kPa", "1", "1/kPa^2"),
    ] {
        let (unit, text) = unit_of(stimulus, response);
        assert_eq!(unit, composed, "{text}");
        assert!(!text.contains("unit of the response"), "{text}");
        assert_eq!(
            response == "V",
            text.contains(" V (") && text.contains("response_rmse V"),
            "{text}"
        );
    }
}

#[test]
fn the_replicate_of_an_axis_is_its_cycle() {
    let place = tempfile::tempdir().unwrap();
    let table: Vec<String> = axis_table(120, |_, way| if way < 0.0 { 6.0 } else { 0.0 })
        .lines()
        .enumerate()
        .map(|(k, line)| {
            if k == 0 {
                format!("{line},run")
            } else {
                format!("{line},{}", 1 + (k - 1) / 40)
            }
        })
        .collect();
    let file = place.path().join("t.csv");
    fs::write(&file, table.join("\n")).unwrap();
    let import = |out: &Path, more: &[&str]| {
        let fixed = [
            "import",
            file.to_str().unwrap(),
            "--kind",
            "axis",
            "--commanded",
            "commanded_mm",
            "--measured",
        ];
        wcal(
            &[
                &fixed[..],
                &["measured_mm", "--out", out.to_str().unwrap()],
                more,
            ]
            .concat(),
        )
    };
    let (with, without) = (place.path().join("with"), place.path().join("without"));
    let done = import(&with, &["--replicate", "run"]);
    assert_eq!(
        done.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let run = verify(&with);
    assert_eq!(
        run.verify["after"]["split"], "loto",
        "{}",
        run.verify["reason"]
    );
    assert!(
        run.verify["reason"].as_str().unwrap().contains("3 cycles"),
        "{}",
        run.verify["reason"]
    );
    // A table by another hand that has the column.
    let points = fs::read_to_string(with.join("points.csv")).unwrap();
    let own = verify(session(AXIS, points.replacen("cycle", "replicate", 1).trim_end()).path());
    assert_eq!(
        (own.code, &own.verify["after"]["split"]),
        (0, &Value::from("loto"))
    );
    // Negative controls: no repetition is named; both names are.
    assert_eq!(import(&without, &[]).status.code(), Some(0));
    assert_eq!(verify(&without).verify["after"]["split"], "loo");
    let both = import(
        &place.path().join("both"),
        &["--replicate", "run", "--cycle", "run"],
    );
    assert!(String::from_utf8_lossy(&both.stderr).contains("--replicate"));
}
