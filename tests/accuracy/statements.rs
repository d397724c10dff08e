//! A small audit of statements (SIMULATED; the table is `wcal-lab exam --statements`): numbers that a user reads hold as often as they say, and half widths
//! that are too small are found out.

use crate::support::program;
use wcal_exam::statements::{Auditor, LAYOUTS, StatementRow};
use wcal_plant::ScalarNoise;

/// Pooled rows of white noise on 4 x 11 readings, of which the statement begins so.
fn rows(widened: f64, statement: &str) -> Vec<StatementRow> {
    let folder = tempfile::tempdir().unwrap();
    let program = program().get_program().into();
    let auditor = Auditor {
        program,
        folder: folder.path().to_path_buf(),
        jobs: 2,
        widened,
    };
    let all = auditor
        .audit(&[ScalarNoise::White], &LAYOUTS[1..2], 12, 7)
        .unwrap();
    all.into_iter()
        .filter(|r| r.statement.starts_with(statement))
        .collect()
}

#[test]
fn predictions_of_a_new_sweep_hold_as_often_as_they_say() {
    let stated = rows(1.0, "prediction");
    assert_eq!(
        stated.len(),
        3,
        "at places, at the ends, between: {stated:?}"
    );
    assert!(stated.iter().all(StatementRow::agrees), "{stated:?}");
    // Half of the stated width holds about two thirds of the readings.
    let halved = rows(0.5, "prediction at places");
    assert!(halved.iter().all(|r| !r.agrees()), "{halved:?}");
}
