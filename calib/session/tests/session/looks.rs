//! Looks at sealed rows, which are known by what was read, not by the file.

use crate::broken::Base;
use std::fs;
use std::path::Path;
use wcal_core::Provenance;
use wcal_session::{SessionLedger, attach_holdout, load};

const HELD: [&str; 6] = [
    "0.5,1.25,5,1",
    "1.5,3.5,6,1",
    "2.5,5.625,7,1",
    "3.5,7.75,8,2",
    "4.5,9.5,9,2",
    "5.5,11.625,10,2",
];

fn table(rows: &[&str], role: &str, first: usize) -> String {
    let rows = rows
        .iter()
        .enumerate()
        .map(|(k, row)| format!("{},{role},{row}\n", first + k));
    "point,role,stimulus,response,t_s,batch\n".to_owned() + &rows.collect::<String>()
}

/// A session with the table `holdout.csv`, or with further rows of its points table.
fn session(folder: &Path, holdout: Option<&str>, more: &str) {
    Base::Transducer.write(folder);
    let points = folder.join("points.csv");
    fs::write(&points, fs::read_to_string(&points).unwrap() + more).unwrap();
    if let Some(text) = holdout {
        fs::write(folder.join("holdout.csv"), text).unwrap();
        let toml = fs::read_to_string(folder.join("session.toml")).unwrap();
        let with = toml.replace(
            "points = \"points.csv\"\n",
            "points = \"points.csv\"\nholdout = \"holdout.csv\"\n",
        );
        fs::write(folder.join("session.toml"), with).unwrap();
    }
}

fn look(folder: &Path, holdout: Option<&Path>, decision: &str) -> usize {
    let mut session = load(folder).unwrap();
    if let Some(holdout) = holdout {
        attach_holdout(&mut session, holdout).unwrap();
    }
    SessionLedger::new(&session, folder, &Provenance::default())
        .record(Some(decision))
        .unwrap()
}

fn lines_of_the_role(rows: &[&str]) -> String {
    table(rows, "holdout", 10)
        .split_once('\n')
        .unwrap()
        .1
        .to_owned()
}

#[test]
fn rows_that_the_points_table_holds_out_are_counted() {
    let place = tempfile::tempdir().unwrap();
    session(place.path(), None, &lines_of_the_role(&HELD));
    assert_eq!(
        [1, 2, 3, 1].map(|k| look(place.path(), None, &k.to_string())),
        [1, 2, 3, 1]
    );
    // In a file of their own they are the same rows.
    let own = place.path().join("own.csv");
    fs::write(&own, table(&HELD, "holdout", 0)).unwrap();
    Base::Transducer.write(place.path());
    assert_eq!(look(place.path(), Some(&own), "4"), 4);
}

#[test]
fn another_form_or_order_of_the_rows_is_no_new_holdout_and_other_rows_are_one() {
    let place = tempfile::tempdir().unwrap();
    let text = table(&HELD, "holdout", 0);
    session(place.path(), Some(&text), "");
    assert_eq!(look(place.path(), None, "first"), 1);
    let backwards: Vec<&str> = HELD.iter().rev().copied().collect();
    let exchanged = text.lines().map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        [cells[3], cells[2], cells[0], cells[1], cells[5], cells[4]].join(",") + "\n"
    });
    let forms = [
        text.replace('\n', "\r\n"),
        table(&backwards, "calibration", 70).replace(",1\n", ",1.0\n"),
        text.replace("3.5,7.75", "3.50,7.7500000000001"),
        exchanged.collect(),
        text.lines()
            .take(5)
            .map(|line| format!("{line}\n"))
            .collect(),
    ];
    for (k, form) in forms.iter().enumerate() {
        fs::write(place.path().join("holdout.csv"), form).unwrap();
        assert_eq!(
            look(place.path(), None, &format!("of form {k}")),
            k + 2,
            "{form}"
        );
    }
    let new = HELD.map(|row| format!("1{row}"));
    let new = table(&new.each_ref().map(String::as_str), "holdout", 0);
    fs::write(place.path().join("holdout.csv"), new).unwrap();
    assert_eq!(look(place.path(), None, "first"), 1, "negative control");
}

#[test]
fn sealed_rows_that_are_predicted_are_a_look() {
    let place = tempfile::tempdir().unwrap();
    session(place.path(), None, &lines_of_the_role(&HELD));
    let read = |name: &str, text: &str| {
        fs::write(place.path().join(name), text).unwrap();
        SessionLedger::of_table(
            &place.path().join(name),
            &place.path().join("o.csv"),
            &Provenance::default(),
        )
        .unwrap()
    };
    let points = fs::read_to_string(place.path().join("points.csv")).unwrap();
    assert!(read("points.csv", &points));
    assert!(read("bare.csv", "stimulus,response\n2.5,5.625\n"));
    assert_eq!(look(place.path(), None, "first"), 3);
    // Negative controls: rows that are fitted, and new ones.
    assert!(!read("fitted.csv", "stimulus,response\n1,2.5\n2,4.5\n"));
    assert!(!read("new.csv", "stimulus,response\n2.5,5.626\n"));
    assert_eq!(look(place.path(), None, "second"), 4);
}
