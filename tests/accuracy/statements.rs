//! A small audit of statements (SIMULATED; the table is `wcal-lab exam --statements`): numbers that
//! a user reads hold as often as they say, and half widths that are too small are found out.

use crate::support::PROGRAM;
use wcal_exam::statements::{Auditor, LAYOUTS, StatementRow};
use wcal_exam::tracked_statements::TRACK_REGIMES;
use wcal_plant::ScalarNoise;

/// Rows of an audit whose stated half widths are multiplied by `widened`.
fn audited(
    widened: f64,
    audit: impl Fn(&Auditor) -> anyhow::Result<Vec<StatementRow>>,
) -> Vec<StatementRow> {
    let folder = tempfile::tempdir().unwrap();
    let auditor = Auditor {
        program: PROGRAM.into(),
        folder: folder.path().to_path_buf(),
        jobs: 2,
        widened,
    };
    audit(&auditor).unwrap()
}

/// Each statement with the share of cases in which it held.
fn shares(rows: &[StatementRow]) -> Vec<(&str, f64)> {
    let share = |r: &StatementRow| r.holds.0 as f64 / r.holds.1 as f64;
    rows.iter()
        .map(|r| (r.statement.as_str(), share(r)))
        .collect()
}

/// White noise on 4 x 11 readings.
#[test]
fn predictions_of_a_new_sweep_hold_as_often_as_they_say() {
    let rows = |widened: f64, statement: &str| {
        let mut all = audited(widened, |a| {
            a.audit(&[ScalarNoise::White], &LAYOUTS[1..2], 12, 7)
        });
        all.retain(|r| r.statement.starts_with(statement));
        all
    };
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
    let rows = |widened: f64| {
        let mut all = audited(widened, |a| a.audit_tracks(&TRACK_REGIMES[..2], 3, 7));
        all.retain(|r| r.statement.ends_with("ellipsoid, rows `ok`"));
        all
    };
    let stated = rows(1.0);
    // Three records: a region holds most of their rows.
    assert!(
        !stated.is_empty() && shares(&stated).iter().all(|s| s.1 > 0.85),
        "{stated:?}"
    );
    // Control: a tenth of the stated width holds few.
    assert!(shares(&rows(0.1)).iter().all(|s| s.1 < 0.6), "{stated:?}");
}

/// Two calibrated pairs of cameras: most of what is stated of four wires holds.
#[test]
fn shapes_and_contacts_of_pictures_hold_as_often_as_they_say() {
    let rows = |widened: f64, folders| {
        let mut all = audited(widened, |a| a.audit_stereo(folders, 2, 7));
        all.retain(|r| r.says.is_some());
        all
    };
    let stated = rows(1.0, 2);
    assert_eq!(stated.len(), 5, "{stated:?}");
    assert!(shares(&stated).iter().all(|s| s.1 >= 0.75), "{stated:?}");
    // Control: a twentieth of the stated width holds few.
    let narrow = rows(0.05, 1);
    assert!(shares(&narrow).iter().all(|s| s.1 <= 0.5), "{narrow:?}");
}

/// Maps of six whiskers at readings of other trajectories.
#[test]
fn moments_of_maps_hold_as_often_as_they_say() {
    let rows = |widened: f64| {
        let mut all = audited(widened, |a| a.audit_maps(6, 7));
        all.retain(|r| r.says.is_some());
        all
    };
    let stated = rows(1.0);
    // Linear and bent sensors, both moments, inside and at the edge.
    assert_eq!(stated.len(), 8, "{stated:?}");
    assert!(shares(&stated).iter().all(|s| s.1 > 0.85), "{stated:?}");
    // Control: a fifth of the stated width holds few.
    assert!(shares(&rows(0.2)).iter().all(|s| s.1 < 0.7), "{stated:?}");
}
