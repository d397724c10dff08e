//! Measured data with certified or published answers.

use super::*;

/// Digits that agree: -log10 of the relative error.
fn digits(got: f64, want: f64) -> f64 {
    -((got / want - 1.0).abs().max(1e-17)).log10()
}

/// NIST StRD certified values of PONTIUS and their standard errors (fixtures/nist/SOURCE.md).
const CERTIFIED: [f64; 3] = [
    0.673565789473684e-3,
    0.732059160401003e-6,
    -0.316081871345029e-14,
];
const CERTIFIED_ERRORS: [f64; 3] = [
    0.107938612033077e-3,
    0.157817399981659e-9,
    0.486652849992036e-16,
];

/// Least digits by which a run agrees with the certified values; 0 where the model is not a
/// quadratic.
fn agreement(run: &Run) -> f64 {
    let Some(model) = &run.calibration else {
        return 0.0;
    };
    if model["model"]["polynomial"]["coefficients"]
        .as_array()
        .is_none_or(|c| c.len() != 3)
    {
        return 0.0;
    }
    let pairs = run.polynomial("coefficients").into_iter().zip(CERTIFIED);
    pairs
        .map(|(got, want)| digits(got, want))
        .fold(17.0, f64::min)
}

#[test]
fn pontius_gets_its_quadratic_term_and_the_certified_numbers() {
    let run = verify(&nist("pontius"));
    assert_eq!(
        (run.code, run.verdict()),
        (0, "effect"),
        "{}",
        run.verify["reason"]
    );
    assert_eq!(run.effects(), ["nonlinearity-quadratic"]);
    assert!(agreement(&run) >= 12.0, "{}", agreement(&run));
    for (got, want) in run
        .polynomial("standard_errors")
        .into_iter()
        .zip(CERTIFIED_ERRORS)
    {
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
        let cells = csv
            .lines()
            .nth(1)
            .unwrap()
            .split(',')
            .map(|v| v.parse::<f64>().unwrap());
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
        format!(
            "{},{},{},{}",
            c[0],
            c[1],
            c[2],
            y + if k == 5 { 2e-3 } else { 0.0 }
        )
    });
    assert!(agreement(&verify(moved.path())) < 6.0);
    // Columns swapped.
    let swapped = disturbed("pontius", |_, c| {
        format!("{},{},{},{}", c[0], c[1], c[3], c[2])
    });
    assert!(agreement(&verify(swapped.path())) < 1.0);
    // Response in another unit, off by 1000.
    let unit = disturbed("pontius", |_, c| {
        format!(
            "{},{},{},{}",
            c[0],
            c[1],
            c[2],
            1e3 * c[3].parse::<f64>().unwrap()
        )
    });
    assert!(agreement(&verify(unit.path())) < 1.0);
    // One row in another unit: never the plain quadratic.
    let row = disturbed("pontius", |k, c| {
        let y: f64 = c[3].parse().unwrap();
        format!(
            "{},{},{},{}",
            c[0],
            c[1],
            c[2],
            y * if k == 7 { 1e3 } else { 1.0 }
        )
    });
    assert_ne!(verify(row.path()).effects(), ["nonlinearity-quadratic"]);
    // The bend taken out: nothing is left to find.
    let straight = disturbed("pontius", |_, c| {
        let (x, y): (f64, f64) = (c[2].parse().unwrap(), c[3].parse().unwrap());
        format!("{},{},{},{}", c[0], c[1], c[2], y - CERTIFIED[2] * x * x)
    });
    let run = verify(straight.path());
    assert_eq!(
        (run.code, run.verdict()),
        (0, "adequate"),
        "{}",
        run.verify["reason"]
    );
}

#[test]
fn loadcell_gets_its_quadratic_term() {
    let run = verify(&nist("loadcell"));
    assert_eq!(
        (run.code, run.verdict()),
        (0, "effect"),
        "{}",
        run.verify["reason"]
    );
    assert_eq!(run.effects(), ["nonlinearity-quadratic"]);
    // e-Handbook mpc365, printed with six digits.
    for (got, want) in
        run.polynomial("coefficients")
            .into_iter()
            .zip([-1.83980e-5, 0.10010249, 7.03187e-6])
    {
        assert!(digits(got, want) > 5.0, "{got} {want}");
    }
    assert!(run.lack_of_fit(0, "p_value") < 1e-10 && run.lack_of_fit(1, "p_value") > 0.05);
    // The table is sorted by load: no claim rests on the order of its rows.
    let rows = run.verify["detectable"].as_array().unwrap();
    let row = |id: &str| rows.iter().find(|d| d["id"] == id).unwrap();
    assert_eq!(row("drift")["status"], "not-observable", "{}", row("drift"));
    assert!(
        row("step")["why"]
            .as_str()
            .unwrap()
            .contains("law over-stimulus"),
        "{}",
        row("step")
    );
}

#[test]
fn berger_spread_grows_with_the_stimulus() {
    let run = verify(&nist("berger1"));
    assert_eq!(run.code, 4);
    assert!(
        run.effects().contains(&"heteroscedastic-noise"),
        "{}",
        run.verify["reason"]
    );
    let named = |run: &Run| -> Option<f64> {
        let effects = run.verify["effects"].as_array().unwrap().clone();
        let spread = effects
            .into_iter()
            .find(|e| e["id"] == "heteroscedastic-noise")?;
        spread["parameters"][0]["interval95"][0].as_f64()
    };
    assert!(named(&run).unwrap() > 0.0, "it grows");
    // Negative control: the scatter dealt out anew, without regard to the stimulus (row k takes the
    // residual of row 53 k + 7 mod 107).
    let text = fs::read_to_string(nist("berger1").join("points.csv")).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|l| l.split(',').skip(2).map(|v| v.parse().unwrap()).collect())
        .collect();
    let residual = |k: usize| rows[k][1] - (4.99368 + 0.731111 * rows[k][0]);
    let dealt = disturbed("berger1", |k, c| {
        let y = 4.99368 + 0.731111 * rows[k][0] + residual((53 * k + 7) % 107);
        format!("{},{},{},{y},{}", c[0], c[1], c[2], c[4])
    });
    assert!(
        !verify(dealt.path())
            .effects()
            .contains(&"heteroscedastic-noise")
    );
}

#[test]
fn lew_is_periodic_and_not_steady() {
    let run = verify(&nist("lew"));
    assert_eq!((run.code, run.verdict()), (0, "effect"));
    let effects = run.verify["effects"].as_array().unwrap();
    let periodic = effects.iter().find(|e| e["id"] == "periodic").unwrap();
    let parameters = periodic["parameters"].as_array().unwrap();
    let frequency = parameters
        .iter()
        .find(|p| p["name"] == "frequency")
        .unwrap()["value"]
        .as_f64()
        .unwrap();
    assert!(
        (frequency - 0.3018).abs() < 3e-4,
        "true least squares 0.3018, found {frequency}"
    );
    assert!(
        run.verify["reason"]
            .as_str()
            .unwrap()
            .contains("not steady")
    );
    assert!(run.rmse("after", "response_rmse") < 0.6 * run.rmse("before", "response_rmse"));
    // Negative control: the same readings in another order hold no period.
    let text = fs::read_to_string(nist("lew").join("points.csv")).unwrap();
    let y: Vec<String> = text
        .lines()
        .skip(1)
        .map(|l| l.split(',').nth(3).unwrap().to_owned())
        .collect();
    let mixed = disturbed("lew", |k, c| {
        format!(
            "{},{},{},{}",
            c[0],
            c[1],
            c[2],
            y[(k * k + 77 * k) * 3 % 200]
        )
    });
    let run = verify(mixed.path());
    assert!(
        !run.verify["reason"]
            .as_str()
            .unwrap()
            .contains("not steady"),
        "{}",
        run.verify["reason"]
    );
}
