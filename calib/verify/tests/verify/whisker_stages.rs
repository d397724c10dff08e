//! The stages around the engine on whisker sessions: measured (fixtures/whiskerfbg) and SIMULATED
//! (fixtures/practice/case-004, no effect).

use crate::search;
use std::path::Path;
use std::sync::OnceLock;
use wcal_core::observation::{TwinLabel, WhiskerData};
use wcal_core::verify_document::{TwinFault, Verdict};
use wcal_core::{Decide, Ledger, SessionData};
use wcal_verify::effect::EffectTerm;
use wcal_verify::levels::HOLDOUT;
use wcal_verify::measurement_model::MeasurementModel;
use wcal_verify::method::fit::{Weights, fit};
use wcal_verify::method::hypothesis::Hypothesis;
use wcal_verify::method::noise_estimator::NoiseEstimator;
use wcal_verify::method::options::Options;
use wcal_verify::method::search_result::SearchResult;
use wcal_verify::verify::conclusion::Facts;
use wcal_verify::verify::detect;
use wcal_verify::verify::error_summary::{coverage95, summarise};
use wcal_verify::verify::prediction_residual::PredictionResidual;
use wcal_verify::verify::{Explained, HeldOut, SessionModel};
use wcal_verify::whisker::WhiskerSystem;
use wcal_verify::whisker::floor::noise_floor;
use wcal_verify::whisker::rod_parameters::RodParameters;
use wcal_verify::whisker::seatings::spread_of_zeros;
use wcal_verify::whisker::twin_check::check_labels;

fn session(name: &str) -> wcal_session::LoadedSession {
    wcal_session::load(
        &Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../fixtures")
            .join(name),
    )
    .unwrap()
}

pub(crate) fn data(name: &str) -> WhiskerData {
    match session(name).data {
        SessionData::Whisker(data) => data,
        _ => panic!("{name} is no whisker session"),
    }
}

pub(crate) fn system(data: &WhiskerData) -> WhiskerSystem {
    WhiskerSystem::new(data, &[]).unwrap()
}

pub(crate) fn fitted(system: &WhiskerSystem, terms: &[EffectTerm]) -> Hypothesis {
    let weights = Weights::equal(system.path.readings.len());
    Hypothesis {
        fit: fit(system, terms, &weights, 15).unwrap(),
        weights,
        flagged: Vec::new(),
        flag_p: 1.0,
    }
}

/// The session without effect, searched once for all tests.
fn null() -> &'static (WhiskerData, WhiskerSystem, SearchResult) {
    static NULL: OnceLock<(WhiskerData, WhiskerSystem, SearchResult)> = OnceLock::new();
    NULL.get_or_init(|| {
        let data = data("practice/case-004");
        let system = system(&data);
        let weights = Weights::equal(system.path.readings.len());
        let found = search(
            &system,
            &weights,
            &Options {
                draws: 500,
                ..Options::default()
            },
        )
        .unwrap();
        (data, system, found)
    })
}

// The twin check.

/// The session with labels made from the rod itself by `change`.
fn labelled(change: impl Fn(usize, [f64; 2]) -> [f64; 2]) -> (WhiskerData, WhiskerSystem) {
    let mut data = data("whiskerfbg");
    let made = system(&data);
    let tables = made.rod_tables.tables(&RodParameters::default()).unwrap();
    let mut twin = Vec::new();
    for (k, (reading, row)) in made.path.readings.iter().zip(&made.path.rows).enumerate() {
        let m = match reading.line.filter(|_| !reading.rest) {
            Some(l) => tables[l].moment(reading.x_mm).unwrap(),
            None => [0.0; 2],
        };
        twin.push(TwinLabel {
            point: data.rows[*row].point,
            moment_nmm: change(k, m),
        });
    }
    data.twin = twin;
    (data, made)
}

fn faults(data: &WhiskerData, system: &WhiskerSystem) -> Vec<TwinFault> {
    check_labels(data, &system.path, &system.rod_tables).faults
}

#[test]
fn labels_of_the_rod_itself_have_no_fault_and_each_kind_of_fault_is_named() {
    let (data, system) = labelled(|_, m| m);
    assert_eq!(faults(&data, &system), []);
    let (data, system) = labelled(|k, m| if k == 9 { [m[0] - 0.8, m[1] + 0.5] } else { m });
    let found = faults(&data, &system);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(
        (found[0].kind.as_str(), found[0].points.len()),
        ("branch", 1)
    );
    let (data, system) = labelled(|_, m| m.map(|v| v * 1e-3));
    assert!(
        faults(&data, &system)
            .iter()
            .any(|f| f.kind == "unit" && f.points.len() > 20)
    );
    let (data, system) = labelled(|_, m| m.map(|v| v * 1.06));
    assert!(
        faults(&data, &system)
            .iter()
            .any(|f| f.kind == "discretisation")
    );
}

#[test]
fn labels_about_other_axes_are_named_with_what_would_fit() {
    for (change, kind, words) in [
        (
            (|m| [-m[0], -m[1]]) as fn([f64; 2]) -> [f64; 2],
            "sign",
            "-1 times",
        ),
        (|m| [m[1], m[0]], "axes", "exchanged"),
        (|m| [-m[1], m[0]], "axes", "turned by 90 deg"),
        (|m| [m[0], -m[1]], "axes", "second axis reversed"),
        (
            |m| {
                [
                    1.1 * (0.8 * m[0] - 0.6 * m[1]),
                    1.1 * (0.6 * m[0] + 0.8 * m[1]),
                ]
            },
            "axes",
            "turned by 37 deg",
        ),
    ] {
        let (data, system) = labelled(|_, m| change(m));
        let found = faults(&data, &system);
        assert_eq!(
            (found.len(), found[0].kind.as_str()),
            (1, kind),
            "{words}: {found:?}"
        );
        assert!(
            found[0].detail.contains(words) && found[0].points.len() > 20,
            "{words}: {found:?}"
        );
    }
    // Control: a wire clamped 3 degrees off about its own axis.
    let (data, system) = labelled(|_, m| [m[0] - 0.052 * m[1], 0.052 * m[0] + m[1]]);
    assert_eq!(faults(&data, &system), []);
}

// Noise.

#[test]
fn the_floor_comes_from_replicates_or_says_that_it_does_not() {
    let (_, rich, found) = null();
    let noise_of = |system: &WhiskerSystem, h: &Hypothesis| {
        NoiseEstimator::new(system, 1).noise(h, &[]).unwrap()
    };
    let floor = noise_floor(rich, &found.base, &noise_of(rich, &found.base), false);
    assert_eq!(floor.floor.source, "replicates");
    // Nothing acts there: pure error and residual agree within their scatter.
    let ratio = floor.sd / found.base.fit.variance().sqrt();
    assert!((ratio - 1.0).abs() < 0.15, "{ratio}");
    let single = data("whiskerfbg");
    let system = system(&single);
    let h = fitted(&system, &[]);
    let floor = noise_floor(&system, &h, &noise_of(&system, &h), false);
    assert_eq!(floor.floor.source, "difference");
    assert!(floor.note.unwrap().contains("not known"));
}

// The omnibus test, adequacy and the order of verdicts.

#[test]
fn a_session_without_effect_is_adequate_and_only_its_labels_can_change_that() {
    let (_, system, found) = null();
    let noise = NoiseEstimator::new(system, 1)
        .noise(&found.base, &[])
        .unwrap();
    let (found, declared_noise) = (found.clone(), noise.clone());
    let explained = Explained {
        found,
        noise,
        declared_noise,
        exact: false,
        tests: Vec::new(),
    };
    let verdict = |faults: &[TwinFault]| {
        let facts = Facts::of(system, &explained, faults);
        facts
            .conclude(facts.accepted().clone(), false, None, None)
            .verdict
    };
    assert_eq!(verdict(&[]), Verdict::Adequate);
    let fault = TwinFault {
        points: vec![3],
        kind: "branch".into(),
        detail: String::new(),
    };
    assert_eq!(verdict(&[fault]), Verdict::TwinFault);
}

#[test]
fn every_effect_has_a_line_saying_what_could_have_been_seen() {
    let (_, system, found) = null();
    let table = detect::table(system, &found.best, &found.last_test);
    assert_eq!(table.len(), system.catalogue().len());
    let row = |id: &str| table.iter().find(|d| d.id == id).unwrap();
    assert_eq!(
        row("gravity").status,
        "not-observable",
        "no gravity direction in the session"
    );
    let friction = row("groove-friction");
    assert!(friction.status == "testable" && friction.smallest.is_some_and(|s| s > 0.0 && s < 0.5));
    assert!(table.iter().all(|d| !d.why.is_empty()));
}

/// Deep poses of the paper's measured session have no equilibrium with a tangential force of 0.72
/// of the normal one; those with the friction of a groove have one.
#[test]
fn friction_is_tested_on_poses_that_more_friction_would_lose() {
    let data = data("whiskerfbg");
    let system = system(&data);
    let effect = system
        .catalogue()
        .iter()
        .position(|e| e.id == "groove-friction")
        .unwrap();
    let moments = |mu: f64| {
        system
            .moments(&[EffectTerm {
                effect,
                law: 0,
                values: vec![mu],
            }])
            .map(|m| m.1)
    };
    let [without, with] = [0.0, 0.2].map(|mu| moments(mu).unwrap());
    let change = |k: usize| {
        (0..2)
            .map(|c| (with[k][c] - without[k][c]).abs())
            .fold(0.0, f64::max)
    };
    let largest = (0..with.len()).map(change).fold(0.0, f64::max);
    assert!((0.02..0.2).contains(&largest), "{largest}");
}

// Unsealing.

#[test]
fn held_out_errors_are_root_mean_squares_with_an_interval_around_them() {
    let row = |group: u32, e: f64| HeldOut {
        group,
        errors: vec![vec![e, -e], vec![0.1 * e, 0.0]],
        stated_sd: vec![vec![2.0, 2.0], vec![0.1, f64::NAN]],
        inside95: vec![e < 2.0, true],
    };
    let quantities = null().1.quantities();
    let rows: Vec<HeldOut> = (0..12)
        .map(|k| row(k / 2, if k < 6 { 1.0 } else { 3.0 }))
        .collect();
    let e = summarise(&rows, quantities, "holdout").unwrap();
    let rmse = e.rmse["wavelength_rmse_pm"];
    assert!((rmse - 5.0_f64.sqrt()).abs() < 1e-12);
    let [low, high] = e.interval95["wavelength_rmse_pm"];
    assert!(low < rmse && rmse < high, "{low} {high}");
    let by_groups = high / low;
    assert_eq!(e.points, 12);
    assert_eq!(coverage95(&rows), Some(0.75), "6 of 24 are outside");
    // One group only: each of its readings counts as one, and twelve say more than six groups.
    let one: Vec<HeldOut> = rows
        .iter()
        .map(|r| HeldOut {
            group: 0,
            ..r.clone()
        })
        .collect();
    let [low, high] =
        summarise(&one, quantities, "holdout").unwrap().interval95["wavelength_rmse_pm"];
    assert!(
        low < rmse && rmse < high && high / low < by_groups,
        "{low} {high}"
    );
    assert!(summarise(&[], quantities, "holdout").is_none() && coverage95(&[]).is_none());
}

#[test]
fn a_holdout_like_the_points_agrees_and_a_moved_one_does_not() {
    /// Nothing is decided: the rows are looked at.
    struct Undecided;
    impl Decide for Undecided {
        fn content(&self) -> serde_json::Value {
            serde_json::Value::Null
        }
    }
    let (_, system, found) = null();
    let sealed = session("practice/case-004").sealed.whisker();
    let opened = sealed.unseal(Undecided, &Ledger::default()).unwrap();
    let (_, rows) = opened.assess(|_, rows, _| rows.to_vec());
    let p_of = |moved_pm: f64| {
        let mut rows = rows.clone();
        rows.iter_mut().for_each(|r| r.shift_pm[0] += moved_pm);
        let whole = system.with_holdout(&rows).unwrap();
        let noise = NoiseEstimator::new(system, 1)
            .noise(&found.base, &[])
            .unwrap();
        let tangents = fit(&whole, &[], &Weights::equal(whole.scored().len()), 0).unwrap();
        let judged = |i: usize| whole.scored()[i];
        PredictionResidual::of(&whole, &found.base, &tangents, &noise, judged)
            .and_then(|r| r.p())
            .unwrap()
    };
    assert!(p_of(0.0) > 0.01);
    assert!(p_of(5.0) < HOLDOUT);
}

// Several sessions.

#[test]
fn a_sensitivity_that_changes_between_seatings_is_said() {
    let (data, _, _) = null();
    let changed = |factor: f64| {
        let mut data = data.clone();
        let half = data.rows.len() / 2;
        for r in data.rows.iter_mut().skip(half) {
            r.seating = 1;
            for s in &mut r.shift_pm {
                *s = *s * factor + 12.0;
            }
        }
        let system = system(&data);
        let h = fitted(&system, &[]);
        spread_of_zeros(&system, &h.fit).unwrap()
    };
    let same = changed(1.0);
    assert!(same.sensitivity_p > 0.01, "{same:?}");
    assert!(
        same.zero_sd_pm
            .iter()
            .all(|sd| (sd - 12.0 / 2.0_f64.sqrt()).abs() < 1.0),
        "{same:?}"
    );
    let other = changed(1.03);
    assert!(
        other.sensitivity_p < 1e-6 && (other.sensitivity_change - 0.03).abs() < 0.01,
        "{other:?}"
    );
    assert!(other.note().contains("differ"));
}

/// What the tables leave out of the rod is far below the noise of settled means: else thousands of
/// readings see it.
#[test]
fn the_tables_hold_the_rod_to_a_tenth_of_the_finest_noise() {
    let data = data("recorded/drift");
    let by_table = system(&data);
    let tabulated = by_table.moments(&[]).unwrap().1;
    let settled: Vec<usize> = (0..tabulated.len())
        .filter(|&i| !by_table.path.readings[i].rest && by_table.path.readings[i].dwell_s > 0.0)
        .collect();
    let (mut worst, mut squares) = ([0.0_f64; 10], 0.0);
    for some in settled.chunks(6) {
        // So few that each is solved for by itself.
        let rows = some
            .iter()
            .map(|&i| data.rows[by_table.path.rows[i]].clone());
        let few = WhiskerData {
            rows: rows.collect(),
            ..data.clone()
        };
        let solved = system(&few).moments(&[]).unwrap().1;
        for (s, &i) in solved.iter().zip(some) {
            let off = (s[0] - tabulated[i][0]).hypot(s[1] - tabulated[i][1]);
            squares += off * off;
            let of = &mut worst[by_table.path.readings[i].group as usize];
            *of = of.max(off);
        }
    }
    let rms = (squares / settled.len() as f64).sqrt();
    println!(
        "{} readings, rms {rms:.2e} N mm, worst by trajectory {worst:?}",
        settled.len()
    );
    // 0.03 pm of a second at 2 kHz, at 75 pm/(N mm).
    assert!(rms < 4e-5, "{rms}");
}
