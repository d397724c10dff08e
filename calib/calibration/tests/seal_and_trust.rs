//! The seal of `calibration.json`, what speaks against using it, and its application, on a straight
//! line written by hand.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use wcal_calibration::{
    CalibrationError, CalibrationModel, GivenCalibration, TrustIssue, of_whisker, provenance,
    read_calibration, read_unsealed, seal, trust_issues,
};
use wcal_core::{CalibrationFile, Provenance, VerificationStatus};

fn load_cell() -> wcal_session::LoadedSession {
    wcal_session::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/nist/pontius"))
        .unwrap()
}

/// y = 2 + 4 (x - 5) / 5 on stimuli of 0 to 10.
fn line() -> CalibrationModel {
    serde_json::from_value(json!({
        "kind": "scalar", "session_kind": "transducer", "stimulus_unit": "N", "response_unit": "mV", "covariates": [],
        "declared": {"polynomial": 1},
        "scaling": {"mid": 5.0, "half": 5.0, "time": null, "temperature": null, "covariates": [], "count": 12},
        "effects": [], "coefficients": [2.0, 4.0], "covariance": [[1e-4, 0.0], [0.0, 1e-4]], "variance": 1e-4, "dof": 10.0,
        "offset": 0.0, "spread": null, "stimulus_range": [0.0, 10.0], "polynomial": null, "lack_of_fit": [null, null]
    }))
    .unwrap()
}

fn sealed(
    verification: VerificationStatus,
    expires: Option<&str>,
) -> CalibrationFile<CalibrationModel> {
    let made = Provenance {
        inputs: Vec::new(),
        ..provenance(&load_cell(), 7)
    };
    seal(
        "cell-1",
        verification,
        expires.map(str::to_owned),
        line(),
        made,
        None,
    )
    .unwrap()
}

fn written(
    folder: &Path,
    file: &CalibrationFile<CalibrationModel>,
    change: impl FnOnce(&mut Value),
) -> PathBuf {
    let mut document = serde_json::to_value(file).unwrap();
    change(&mut document);
    let path = folder.join("calibration.json");
    std::fs::write(&path, serde_json::to_string_pretty(&document).unwrap()).unwrap();
    path
}

#[test]
fn what_was_sealed_is_read_and_what_was_changed_since_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = sealed(VerificationStatus::Verified, Some("2030-01-01T00:00:00Z"));
    let path = written(folder.path(), &file, |_| ());
    assert_eq!(read_calibration(&path).unwrap(), file);
    assert_eq!(read_unsealed(&path).unwrap().1, None);
    // One change in each part that the seal covers.
    let changes: [fn(&mut Value); 5] = [
        |d| d["session"] = "cell-2".into(),
        |d| d["expires"] = "2031-01-01T00:00:00Z".into(),
        |d| d["verification"] = "unverified".into(),
        |d| d["model"]["coefficients"][1] = 4.000_001.into(),
        |d| d["provenance"]["seed"] = 8.into(),
    ];
    for change in changes {
        let path = written(folder.path(), &file, change);
        let refused = read_calibration(&path).unwrap_err();
        let (_, doubt) = read_unsealed(&path).unwrap();
        let Some(TrustIssue::Changed {
            content_sha256,
            stated_sha256,
            ..
        }) = &doubt
        else {
            panic!("{doubt:?}")
        };
        assert!(*stated_sha256 == file.content_sha256 && content_sha256 != stated_sha256);
        assert!(
            matches!(&refused, CalibrationError::Changed(found) if Some(found) == doubt.as_ref()),
            "{refused}"
        );
    }
}

#[test]
fn what_is_no_calibration_of_this_version_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = sealed(VerificationStatus::Verified, None);
    let refused = |change: fn(&mut Value)| {
        read_unsealed(&written(folder.path(), &file, change))
            .unwrap_err()
            .to_string()
    };
    let format = refused(|d| d["format"] = "wcal-calibration/9".into());
    assert!(
        format.contains("expected \"wcal-calibration/1\", found \"wcal-calibration/9\""),
        "{format}"
    );
    let kind = refused(|d| d["model"]["kind"] = "oracle".into());
    assert!(kind.contains("expected a model of kind"), "{kind}");
    let size = refused(|d| d["model"]["coefficients"] = json!([2.0]));
    assert!(size.contains("coefficients"), "{size}");
    let missing = read_unsealed(&folder.path().join("none.json")).unwrap_err();
    assert!(matches!(missing, CalibrationError::Io { .. }), "{missing}");
}

#[test]
fn trust_ends_with_the_time_and_with_a_failed_verification() {
    let at = |time: &str| time.parse::<jiff::Timestamp>().unwrap();
    let end = "2030-01-01T00:00:00Z";
    let (good, failed) = (
        sealed(VerificationStatus::Verified, Some(end)),
        sealed(VerificationStatus::Failed, None),
    );
    assert_eq!(trust_issues(&good, at(end)).unwrap(), []);
    let expired = trust_issues(&good, at("2030-01-01T00:00:01Z")).unwrap();
    assert_eq!(expired, [TrustIssue::Expired(end.to_owned())]);
    assert_eq!(
        trust_issues(&failed, at("2100-01-01T00:00:00Z")).unwrap(),
        [TrustIssue::FailedVerification]
    );
    let both = sealed(VerificationStatus::Failed, Some(end));
    assert_eq!(
        trust_issues(&both, at("2031-01-01T00:00:00Z"))
            .unwrap()
            .len(),
        2
    );
    let codes: Vec<&str> = expired
        .iter()
        .chain(&[TrustIssue::FailedVerification])
        .map(TrustIssue::code)
        .collect();
    assert_eq!(codes, ["expired", "failed"]);
    let wrong = trust_issues(
        &sealed(VerificationStatus::Verified, Some("next year")),
        at(end),
    )
    .unwrap_err();
    assert!(
        wrong
            .to_string()
            .contains("field `expires`: expected an RFC 3339 time"),
        "{wrong}"
    );
}

#[test]
fn a_table_goes_through_the_line_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let apply = |table: &str| {
        let path = folder.path().join("points.csv");
        std::fs::write(&path, table).unwrap();
        line().apply(&path)
    };
    let rows = |csv: &str| -> Vec<[f64; 3]> {
        let row = |l: &str| {
            let cells: Vec<f64> = l.split(',').map(|c| c.parse().unwrap()).collect();
            [cells[1], cells[2], cells[4]]
        };
        csv.lines().skip(1).map(row).collect()
    };
    // By hand: 2 + 4 (x - 5) / 5; 12 lies outside what was fitted.
    let (forward, back) = (
        apply("stimulus\n0\n7.5\n12\n").unwrap(),
        apply("response\n-2\n4\n").unwrap(),
    );
    let expected = [[0.0, -2.0, 0.0], [7.5, 4.0, 0.0], [12.0, 7.6, 1.0]];
    let inverse = [[-2.0, 0.0, 0.0], [4.0, 7.5, 0.0]];
    for (found, expected) in [(&forward, &expected[..]), (&back, &inverse[..])] {
        let found = rows(&found.csv);
        assert_eq!(found.len(), expected.len());
        let off = found
            .iter()
            .flatten()
            .zip(expected.iter().flatten())
            .map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-6, "{found:?}");
    }
    assert!(
        forward
            .outside
            .unwrap()
            .contains("1 of 3 readings lie outside")
            && back.outside.is_none()
    );
    let lacking = apply("force\n1\n").unwrap_err().to_string();
    assert!(lacking.contains("response"), "{lacking}");
    let file = sealed(VerificationStatus::Verified, None);
    let other = of_whisker(Path::new("c.json"), &file)
        .err()
        .unwrap()
        .to_string();
    assert!(
        other.contains("expected a whisker's calibration, found one of kind \"transducer\""),
        "{other}"
    );
}

#[test]
fn a_calibration_is_not_judged_on_the_readings_of_its_own_fit() {
    let folder = tempfile::tempdir().unwrap();
    let session = load_cell();
    // Another session's calibration may be judged here.
    let path = written(
        folder.path(),
        &sealed(VerificationStatus::Verified, None),
        |_| (),
    );
    assert!(GivenCalibration::read(&path, &session).is_ok());
    let own = seal(
        "pontius",
        VerificationStatus::Verified,
        None,
        line(),
        provenance(&session, 7),
        None,
    )
    .unwrap();
    let refused = GivenCalibration::read(&written(folder.path(), &own, |_| ()), &session)
        .err()
        .unwrap();
    assert!(
        refused
            .to_string()
            .contains("found only those that it was fitted to"),
        "{refused}"
    );
}
