//! Tables as people hand them over: stuck channels, overflow values, copies, decimal points,
//! columns of something else. What is wrong is named, and what only looks like it is taken.

use super::*;

/// A table imported and verified: exit codes, what import said, and the result where there is one.
struct Imported {
    import: i32,
    said: String,
    run: Option<Run>,
    place: tempfile::TempDir,
}

fn imported(table: &str, arguments: &[&str]) -> Imported {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    fs::write(at("t.csv"), table).unwrap();
    let done = wcal(&[&["import", &at("t.csv"), "--out", &at("s")], arguments].concat());
    let import = done.status.code().unwrap();
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    let run = matches!(import, 0 | 3).then(|| verify(&place.path().join("s")));
    Imported {
        import,
        said,
        run,
        place,
    }
}

const CELL: &[&str] = &[
    "--kind",
    "transducer",
    "--stimulus",
    "x",
    "--response",
    "y",
    "--model",
    "linear",
];
const STAGE: &[&str] = &["--kind", "axis", "--commanded", "x", "--measured", "y"];

/// Eleven loads up and down `times` over, with what `response` makes of number and load.
fn cell(times: usize, response: impl Fn(usize, f64) -> String) -> String {
    let rows = (0..22 * times).map(|k| {
        let place = k % 22;
        let x = 500.0
            * if place < 11 {
                place as f64
            } else {
                (21 - place) as f64
            };
        format!("{x},{}\n", response(k, x))
    });
    "x,y\n".to_owned() + &rows.collect::<String>()
}

/// 0.4 mV/N in V with a scatter of 3e-5 V.
fn honest(k: usize, x: f64) -> f64 {
    4e-4 * x + 3e-5 * scatter(k)
}

fn five(value: f64) -> String {
    format!("{value:.5}")
}

fn reason(run: &Run) -> &str {
    run.verify["reason"].as_str().unwrap()
}

#[test]
fn a_channel_without_sensitivity_is_never_verified() {
    for (name, table) in [
        ("stuck at full scale", cell(3, |_, _| "8388607".to_owned())),
        (
            "dead with noise",
            cell(3, |k, _| five(0.3 + 1e-4 * scatter(k))),
        ),
    ] {
        let done = imported(&table, CELL);
        let run = done.run.unwrap();
        assert!(
            matches!(run.code, 1 | 4) && run.calibration.is_none(),
            "{name}: {}",
            reason(&run)
        );
        assert!(
            reason(&run).contains("no sensitivity"),
            "{name}: {}",
            reason(&run)
        );
    }
    // A response of a third of the noise at full load is one all the same.
    let weak = cell(12, |k, x| five(0.3 + 4e-8 * x + 3e-4 * scatter(k)));
    let run = imported(&weak, CELL).run.unwrap();
    assert_eq!(
        (run.code, run.verdict()),
        (0, "adequate"),
        "{}",
        reason(&run)
    );
}

#[test]
fn overflow_values_are_missing_by_their_column() {
    let with = |code: &str| {
        cell(3, |k, x| {
            if k == 7 || k == 30 {
                code.to_owned()
            } else {
                five(honest(k, x))
            }
        })
    };
    for code in ["9.9E+37", "1e38", "-9.91e37", "999999", "32767", "-127"] {
        let done = imported(&with(code), CELL);
        let run = done.run.unwrap();
        assert_eq!(
            (done.import, run.code, run.verdict()),
            (3, 3, "adequate"),
            "{code}: {}",
            reason(&run)
        );
        assert!(
            done.said.contains("overflow value")
                && done.said.contains("lines 9, 32") | done.said.contains("9, 32"),
            "{}",
            done.said
        );
        assert!(
            run.rmse("after", "response_rmse") < 3e-5,
            "{code}: {}",
            reason(&run)
        );
        assert_eq!(run.verify["after"]["points"], 64);
    }
    // In range, or in line with the load: readings.
    let counts = cell(3, |k, x| {
        let y = (240.0 * x + 300.0 * scatter(k)).round();
        if x == 4000.0 && k == 8 {
            "960000".to_owned()
        } else if x == 4000.0 {
            "959999".to_owned()
        } else {
            y.to_string()
        }
    });
    let done = imported(
        &counts.replace("959999", "999999").replace("5000,", "5200,"),
        CELL,
    );
    assert_eq!(done.import, 0, "{}", done.said);
    let low = cell(3, |k, x| {
        format!("{:.2}", x / 10.0 - 200.0 + 0.3 * scatter(k))
    });
    assert_eq!(imported(&low.replace("-100.", "-127."), CELL).import, 0);
}

#[test]
fn copies_are_counted_once_and_a_coarse_gauge_keeps_its_repeats() {
    let sweep: Vec<String> = cell(1, |k, x| five(honest(k, x)))
        .lines()
        .skip(1)
        .take(11)
        .map(str::to_owned)
        .collect();
    let pasted = format!(
        "x,y\n{}\n{}\n{}\n",
        sweep.join("\n"),
        sweep.join("\n"),
        sweep.join("\n")
    );
    let done = imported(&pasted, CELL);
    let run = done.run.unwrap();
    assert!(
        done.import == 3 && done.said.contains("22 of 33"),
        "{}",
        done.said
    );
    assert_eq!(run.verify["after"]["points"], 11);
    assert_ne!(run.verify["noise_floor"]["source"], "replicates");
    // A gauge whose noise hides below its last digit, five times over, and a finer one whose
    // repeats differ.
    let coarse = cell(5, |k, x| format!("{:.2}", honest(k, x)));
    assert_eq!(imported(&coarse, CELL).import, 0);
    assert_eq!(
        imported(&cell(3, |k, x| five(honest(k, x))), CELL).import,
        0
    );
}

#[test]
fn a_reading_that_is_one_in_the_last_digit_off_is_no_outlier() {
    // Every load is a whole number of digits, so that all readings but a few are exact; the control
    // is thirteen digits off.
    let coarse = |off: f64| {
        cell(3, |k, x| {
            format!("{:.2}", 4e-4 * x + if k % 17 == 3 { off } else { 0.0 })
        })
    };
    let run = imported(&coarse(0.01), CELL).run.unwrap();
    assert_eq!(
        (run.code, run.verify["verdict"].as_str()),
        (0, Some("adequate")),
        "{}",
        reason(&run)
    );
    let run = imported(&coarse(0.13), CELL).run.unwrap();
    assert!(
        run.verify["effects"].to_string().contains("outliers"),
        "{}",
        reason(&run)
    );
}

#[test]
fn a_decimal_point_in_the_wrong_place_is_named() {
    let table = cell(3, |k, x| five(honest(k, x)));
    for (from, to, says) in [
        (
            "\n5000,",
            "\n50000,",
            "the 6 readings at the stimulus 50000 contradict all others; with the stimulus times 0.1",
        ),
        ("\n2500,", "\n250,", "with the stimulus times 10"),
        ("\n2000,", "\n20000,", "with the stimulus times 0.1"),
    ] {
        let run = imported(&table.replace(from, to), CELL).run.unwrap();
        assert!(
            run.code == 1 && reason(&run).contains(says),
            "{from}: {}",
            reason(&run)
        );
    }
    let ten = cell(3, |k, x| {
        five(honest(k, x) * if x == 3000.0 { 10.0 } else { 1.0 })
    });
    let run = imported(&ten, CELL).run.unwrap();
    assert!(
        run.code == 1 && reason(&run).contains("times 0.1"),
        "{}",
        reason(&run)
    );
    // A range ten times as far, and a response that saturates, are what they are.
    let far = cell(3, |k, x| five(honest(k, x))).replace("\n5000,", "\n5500,");
    assert!(!reason(&imported(&far, CELL).run.unwrap()).contains("decimal point"));
    let saturated = cell(3, |k, x| five(honest(k, x.min(4200.0))));
    let run = imported(&saturated, CELL).run.unwrap();
    assert_eq!(
        (run.code, run.effects()),
        (0, vec!["saturation"]),
        "{}",
        reason(&run)
    );
}

#[test]
fn thousands_and_columns_of_one_name_are_read_or_named() {
    let rows = |thousand: &str, point: &str| -> String {
        let of = |k: usize| {
            let x = 500 * (k % 9);
            let load = if x < 1000 {
                x.to_string()
            } else {
                format!("{}{thousand}{:03}", x / 1000, x % 1000)
            };
            format!("{load};{}\n", five(honest(k, x as f64)).replace('.', point))
        };
        "x;y\n".to_owned() + &(0..36).map(of).collect::<String>()
    };
    let semicolon: Vec<&str> = CELL
        .iter()
        .copied()
        .chain(["--separator", "semicolon"])
        .collect();
    let done = imported(&rows(".", "."), &semicolon);
    assert!(
        done.import == 1 && done.said.contains("--decimal-comma"),
        "{}",
        done.said
    );
    let comma: Vec<&str> = semicolon
        .iter()
        .copied()
        .chain(["--decimal-comma"])
        .collect();
    let run = imported(&rows(".", ","), &comma).run.unwrap();
    assert_eq!(
        (run.code, run.verdict()),
        (0, "adequate"),
        "{}",
        reason(&run)
    );
    let dots = imported(&rows("", "."), &comma);
    assert!(
        dots.import == 1 && dots.said.contains("a comma"),
        "{}",
        dots.said
    );
    assert_eq!(imported(&rows("", "."), &semicolon).import, 0);
    let twice = |other: &str| {
        let table = cell(2, |k, x| five(honest(k, x)));
        let line = |l: &str| {
            let (x, y) = l.split_once(',').unwrap();
            if x == "x" {
                "x,y,y\n".to_owned()
            } else {
                format!("{x},{y},{}\n", if other.is_empty() { y } else { other })
            }
        };
        imported(&table.lines().map(line).collect::<String>(), CELL)
    };
    let (same, other) = (twice(""), twice("0.7"));
    assert!(
        same.import == 3 && same.said.contains("2 columns named y"),
        "{}",
        same.said
    );
    assert!(
        other.import == 1 && other.said.contains("columns 2 and 3"),
        "{}",
        other.said
    );
}

/// Eleven positions up and down in five cycles; error in um with a backlash of 3.5 um and a scale
/// of 20 um/m.
fn stage(row: impl Fn(f64, f64, f64, usize) -> String) -> String {
    let rows = (0..110).map(|k| {
        let place = k % 22;
        let (step, way) = if place < 11 {
            (place, 1.0)
        } else {
            (21 - place, -1.0)
        };
        let x = 40.0 * step as f64;
        let error = 0.02 * x + if way < 0.0 { 3.5 } else { 0.0 } + 0.5 * scatter(k);
        row(x, error, way, 1 + k / 22)
    });
    "x,y,way,cycle\n".to_owned() + &rows.collect::<String>()
}

#[test]
fn errors_and_directions_of_an_axis_are_told_from_positions() {
    let with_way: Vec<&str> = STAGE
        .iter()
        .copied()
        .chain(["--direction", "way"])
        .collect();
    let positions = stage(|x, e, way, c| format!("{x},{:.7},{way},{c}\n", x + 1e-3 * e));
    let run = imported(&positions, &with_way).run.unwrap();
    assert_eq!(
        (run.code, run.effects()),
        (0, vec!["scale", "backlash"]),
        "{}",
        reason(&run)
    );
    let reversal = |run: &Run| {
        run.verify["effects"][1]["parameters"][0]["value"]
            .as_f64()
            .unwrap()
    };
    assert!((reversal(&run) - 3.5).abs() < 0.3, "{}", reversal(&run));
    // A column of errors: named with the option that takes it, and taken by it in each unit.
    for (unit, factor) in [("um", 1.0), ("mm", 1e-3), ("in", 1e-3 / 25.4)] {
        let errors = stage(|x, e, way, c| format!("{x},{:e},{way},{c}\n", factor * e));
        let done = imported(&errors, &with_way);
        assert!(
            done.import == 1 && done.said.contains("--covariate error_um=COLUMN"),
            "{}",
            done.said
        );
        let by_error = [
            "--kind",
            "axis",
            "--commanded",
            "x",
            "--covariate",
            &format!("error_{unit}=y"),
            "--direction",
            "way",
        ];
        let run = imported(&errors, &by_error).run.unwrap();
        assert!(
            (reversal(&run) - 3.5).abs() < 0.3,
            "{unit}: {}",
            reason(&run)
        );
    }
    // The direction the other way round: named, and right once it is turned.
    let turned = stage(|x, e, way, c| format!("{x},{:.7},{},{c}\n", x + 1e-3 * e, -way));
    let done = imported(&turned, &with_way);
    assert!(
        done.import == 1 && done.said.contains("--direction 'COLUMN*-1'"),
        "{}",
        done.said
    );
    let scaled: Vec<&str> = STAGE
        .iter()
        .copied()
        .chain(["--direction", "way*-1"])
        .collect();
    assert!((reversal(&imported(&turned, &scaled).run.unwrap()) - 3.5).abs() < 0.3);
    // A clock that stands still.
    let timed: Vec<&str> = STAGE.iter().copied().chain(["--time", "way"]).collect();
    let still = stage(|x, e, _, c| format!("{x},{:.7},17.5,{c}\n", x + 1e-3 * e));
    let done = imported(&still, &timed);
    assert!(
        done.import == 1 && done.said.contains("--time"),
        "{}",
        done.said
    );
}

#[test]
fn errors_that_belong_to_places_are_a_table_and_no_law_of_the_order() {
    // Five places with errors of their own, five cycles to and fro, the direction in no column that
    // is imported.
    let places = [4.8, 8.5, 3.9, -13.5, 8.9];
    let rows = (0..50).map(|k| {
        let step = if k % 10 < 5 { k % 10 } else { 9 - k % 10 };
        let x = 12.0 * (1 + step) as f64;
        let error = places[step] + if k % 10 < 5 { 0.0 } else { 3.0 } + 1.5 * scatter(k);
        format!("{x},{:.6},{}\n", x + 1e-3 * error, 1 + k / 10)
    });
    let table = "x,y,cycle\n".to_owned() + &rows.collect::<String>();
    let done = imported(&table, STAGE);
    let run = done.run.unwrap();
    assert_eq!((run.code, run.verdict()), (0, "effect"), "{}", reason(&run));
    assert!(
        run.effects().contains(&"error-table") && !run.effects().contains(&"periodic"),
        "{:?}",
        run.effects()
    );
    let floor = run.verify["noise_floor"]["error_um"].as_f64().unwrap();
    assert!(
        run.rmse("after", "error_rmse_um") < 1.5 * floor
            && run.rmse("before", "error_rmse_um") > 5.0 * floor
    );
    let coverage = run.verify["coverage95"].as_f64().unwrap();
    assert!(coverage >= 0.88, "{coverage}");
    // The calibration is applied to the rows that it comes from.
    let at = |name: &str| done.place.path().join(name).display().to_string();
    let calibration = run
        .out
        .path()
        .join("calibration.json")
        .display()
        .to_string();
    let predicted = wcal(&[
        "predict",
        &at("s/points.csv"),
        "--calibration",
        &calibration,
        "--out",
        &at("p.csv"),
    ]);
    assert_eq!(
        predicted.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&predicted.stderr)
    );
    let residual = column(&fs::read_to_string(at("p.csv")).unwrap(), "residual_um");
    assert!(
        residual.len() == 50 && residual.iter().all(|r| r.abs() < 4.0),
        "{residual:?}"
    );
}

#[test]
fn every_sealed_reading_counts() {
    let rows = |moved: f64| -> String {
        let of = |k: usize| {
            let x = 1.0 + (k % 10) as f64;
            let (role, off) = if k < 60 {
                ("calibration", 0.0)
            } else {
                ("holdout", if k == 65 { moved } else { 0.0 })
            };
            format!(
                "\n{k},{role},{x},{}",
                0.1 + 0.2 * x + 0.02 * x * x + 0.01 * scatter(k) + off
            )
        };
        "point,role,stimulus,response".to_owned() + &(0..72).map(of).collect::<String>()
    };
    let clean = verify(session(TRANSDUCER, &rows(0.0)).path());
    assert_eq!(
        (clean.code, clean.effects()),
        (0, vec!["nonlinearity-quadratic"])
    );
    assert!(clean.verify["after_trimmed"].is_null());
    let moved = verify(session(TRANSDUCER, &rows(14.0)).path());
    assert_eq!(
        (moved.code, &moved.verify["after"]["points"]),
        (3, &Value::from(12)),
        "{}",
        reason(&moved)
    );
    // One of twelve off by 14 makes the error 14 / sqrt(12) = 4; without it the noise is left.
    assert!((moved.rmse("after", "response_rmse") - 4.04).abs() < 0.05);
    assert!(
        moved.rmse("after_trimmed", "response_rmse") < 0.01
            && moved.verify["after_trimmed"]["points"] == 11
    );
    assert!(moved.verify["coverage95"].as_f64().unwrap() < 0.95);
}
