//! Gratings that are dead, stuck or alike are named by every command and carry no calibration;
//! overflow values and pasted rows are left out and counted.

use super::{judge, wcal};
use crate::support::fixture;
use std::fs;
use std::path::Path;

const COMMANDS: [&[&str]; 3] = [
    &["verify", "s", "--check"],
    &["fit-gpr", "s", "--labels", "rod", "--out", "g"],
    &["verify", "s", "--out", "v"],
];

/// The simulated session without an effect, its table changed by `edit`.
fn session(place: &Path, edit: impl Fn(&mut Vec<Vec<String>>)) {
    let from = fixture("practice/case-004");
    fs::create_dir(place.join("s")).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), place.join("s").join(entry.file_name())).unwrap();
    }
    let path = place.join("s/points.csv");
    let text = fs::read_to_string(&path).unwrap();
    let mut rows: Vec<Vec<String>> = text
        .lines()
        .map(|l| l.split(',').map(str::to_owned).collect())
        .collect();
    edit(&mut rows);
    let lines: Vec<String> = rows.iter().map(|r| r.join(",")).collect();
    fs::write(path, lines.join("\n") + "\n").unwrap();
}

fn column(rows: &[Vec<String>], name: &str) -> usize {
    rows[0].iter().position(|c| c == name).unwrap()
}

/// Every row's cell of `name` from its number and the wavelengths of both gratings.
fn set(rows: &mut [Vec<String>], name: &str, value: impl Fn(usize, [f64; 2]) -> Option<f64>) {
    let at = column(rows, name);
    let both = [column(rows, "fbg_1_nm"), column(rows, "fbg_2_nm")];
    for (k, row) in rows.iter_mut().enumerate().skip(1) {
        if let Some(nm) = value(k, both.map(|b| row[b].parse().unwrap())) {
            row[at] = format!("{nm:.7}");
        }
    }
}

/// A reproducible scatter of about 1 pm, in nm.
fn scatter(k: usize) -> f64 {
    1e-3 * ((k * 7919 % 101) as f64 / 50.0 - 1.0)
}

#[test]
fn gratings_that_do_not_follow_the_load_are_named_and_never_verified() {
    type Edit = fn(&mut Vec<Vec<String>>);
    let cases: [(&str, Edit, &str); 4] = [
        (
            "one constant",
            |r| set(r, "fbg_1_nm", |_, _| Some(1545.24)),
            "No sensitivity: fbg_1 reads the same",
        ),
        (
            "both constant",
            |r| {
                set(r, "fbg_1_nm", |_, _| Some(1545.24));
                set(r, "fbg_2_nm", |_, _| Some(1543.61));
            },
            "No sensitivity: fbg_1 and fbg_2 read the same",
        ),
        (
            "dead, with noise",
            |r| set(r, "fbg_2_nm", |k, _| Some(1543.61 + scatter(k))),
            "No sensitivity: fbg_2 does not follow the load",
        ),
        (
            "alike",
            |r| set(r, "fbg_2_nm", |k, [a, _]| Some(a - 1.63 + scatter(k))),
            "rank 1",
        ),
    ];
    for (name, edit, says) in cases {
        let place = tempfile::tempdir().unwrap();
        session(place.path(), edit);
        for command in COMMANDS {
            let run = wcal(place.path(), command);
            judge(&run, 1, &[says]).unwrap_or_else(|why| panic!("{name}, {}: {why}", command[0]));
        }
        let written = fs::read_to_string(place.path().join("v/verify.json")).unwrap();
        assert!(written.contains("\"refused\""), "{name}: {written}");
        assert!(
            !place.path().join("g").exists() && !place.path().join("v/calibration.json").exists(),
            "{name}"
        );
    }
    // One that stands still for a part of the session is an effect that the catalogue does not
    // have.
    let place = tempfile::tempdir().unwrap();
    session(place.path(), |r| {
        set(r, "fbg_2_nm", |k, _| {
            (100..140).contains(&k).then_some(1543.6123456)
        });
    });
    let run = wcal(place.path(), &["verify", "s", "--out", "v"]);
    assert_eq!(run.status.code(), Some(4), "{run:?}");
    assert!(!place.path().join("v/calibration.json").exists());
}

/// What looks alike and is none of these: values in whole picometres, one gross reading, a grating
/// at rest for a while.
#[test]
fn coarse_readings_and_a_gross_one_are_taken() {
    let place = tempfile::tempdir().unwrap();
    session(place.path(), |rows| {
        for name in ["fbg_1_nm", "fbg_2_nm"] {
            let at = column(rows, name);
            for row in rows.iter_mut().skip(1) {
                row[at] = format!("{:.3}", row[at].parse::<f64>().unwrap());
            }
        }
        set(rows, "fbg_1_nm", |k, [a, _]| (k == 50).then_some(a + 3.0));
    });
    judge(
        &wcal(place.path(), &["verify", "s", "--check"]),
        0,
        &["rows to fit"],
    )
    .unwrap();
    let fitted = wcal(
        place.path(),
        &["fit-gpr", "s", "--labels", "rod", "--out", "g"],
    );
    assert!(matches!(fitted.status.code(), Some(0 | 3)), "{fitted:?}");
}

#[test]
fn overflow_values_and_pasted_rows_are_left_out_and_counted() {
    let place = tempfile::tempdir().unwrap();
    session(place.path(), |rows| {
        let at = ["fbg_1_nm", "fbg_2_nm", "fbg_ref_nm"].map(|name| column(rows, name));
        for (row, (c, value)) in [
            (40, (0, "9.9E37")),
            (90, (1, "999999")),
            (200, (2, "-127")),
            (201, (0, "-9.91E+37")),
        ] {
            rows[row][at[c]] = value.to_owned();
        }
        // One sweep pasted again at the end, once as it is and once with point numbers of its own.
        let block: Vec<Vec<String>> = rows[1..30].to_vec();
        rows.extend(block.clone());
        let renumbered = block.into_iter().enumerate().map(|(k, mut row)| {
            row[0] = format!("{}", 9000 + k);
            row
        });
        rows.extend(renumbered);
    });
    let says = [
        "fbg_1_nm 9.9e37 in 1 row(s) is an overflow value",
        "fbg_1_nm -9.91e37 in 1 row(s) is an overflow value",
        "fbg_2_nm 999999 in 1 row(s) is an overflow value",
        "fbg_ref_nm -127 in 1 row(s) is an overflow value",
        "58 of 414 rows are copies of others",
        "356 rows to fit",
    ];
    judge(&wcal(place.path(), &["verify", "s", "--check"]), 3, &says).unwrap();
    // A column of nothing else is no table of readings.
    let lost = tempfile::tempdir().unwrap();
    session(lost.path(), |rows| {
        let at = column(rows, "fbg_1_nm");
        rows.iter_mut()
            .skip(1)
            .for_each(|r| r[at] = "9.9E37".to_owned());
    });
    judge(
        &wcal(lost.path(), &["verify", "s", "--check"]),
        1,
        &["fbg_1_nm", "overflow values in 360 of 360 rows"],
    )
    .unwrap();
}
