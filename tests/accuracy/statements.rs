//! A small audit of statements (SIMULATED; the table is `wcal-lab exam --statements`): numbers that
//! a user reads hold as often as they say, and half widths that are too small are found out.

use crate::support::program;
use wcal_exam::statements::{Auditor, LAYOUTS, StatementRow};
use wcal_exam::tracked_statements::TRACK_REGIMES;
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

/// Contacts of rows `ok` in their ellipsoids, one way; there and back no row is `ok`.
#[test]
fn contacts_of_tracks_hold_as_often_as_the_table_says() {
    let shares = |widened: f64| {
        let folder = tempfile::tempdir().unwrap();
        let program = program().get_program().into();
        let auditor = Auditor {
            program,
            folder: folder.path().to_path_buf(),
            jobs: 2,
            widened,
        };
        let all = auditor.audit_tracks(&TRACK_REGIMES[..2], 3, 7).unwrap();
        let those = all
            .into_iter()
            .filter(|r| r.statement.ends_with("ellipsoid, rows `ok`"));
        those
            .map(|r| (r.holds.0 as f64 / r.holds.1 as f64, r.statement))
            .collect::<Vec<_>>()
    };
    let stated = shares(1.0);
    // Three records: a region holds most of their rows.
    assert!(
        !stated.is_empty() && stated.iter().all(|s| s.0 > 0.85),
        "{stated:?}"
    );
    // Control: a tenth of the stated width holds few.
    assert!(shares(0.1).iter().all(|s| s.0 < 0.6), "{stated:?}");
}
