//! A small fixed draw of the exam (SIMULATED sessions from the independent plant), so that a change
//! that breaks tracing is seen at once. The rates themselves need hundreds of draws:
//! `cargo run --release -p wcal-lab -- exam --draws 300 --mix all`.

use crate::support::PROGRAM;
use std::path::PathBuf;
use wcal_exam::{Examiner, Mark, Outcome, orders};

fn examine(mix: &str, draws: usize, seed: u64) -> Vec<Outcome> {
    let folder = tempfile::tempdir().unwrap();
    let program = PathBuf::from(PROGRAM);
    let examiner = Examiner {
        program,
        folder: folder.path().to_path_buf(),
        jobs: 2,
        timeout_s: 240.0,
        follow_up: false,
    };
    let orders = orders(mix, draws, seed, None, false);
    let results = examiner.examine(&orders, &|_| {});
    results.into_iter().map(Result::unwrap).collect()
}

fn summary(outcomes: &[Outcome]) -> String {
    let lines: Vec<String> = outcomes
        .iter()
        .map(|o| {
            format!(
                "{} {} {}: {} {:?} {:?}",
                o.name, o.noise, o.label, o.verdict, o.got, o.kind
            )
        })
        .collect();
    lines.join("\n")
}

#[test]
fn singles_are_named_and_nulls_left_alone() {
    let null = examine("null", 3, 77);
    assert!(
        null.iter().all(|o| o.kind == Mark::Right),
        "{}",
        summary(&null)
    );
    let single = examine("single", 6, 77);
    let right = single.iter().filter(|o| o.kind == Mark::Right).count();
    assert!(
        right >= 5 && single.iter().all(|o| o.kind != Mark::Wrong),
        "{}",
        summary(&single)
    );
}

#[test]
fn what_the_catalogue_lacks_is_called_unknown_and_tampered_sessions_get_no_name() {
    let unknown = examine("unknown", 3, 77);
    assert!(
        unknown.iter().all(|o| o.kind == Mark::Right),
        "{}",
        summary(&unknown)
    );
    let tampered = examine("adversarial", 5, 77);
    assert!(
        tampered.iter().all(|o| o.verdict == "refused"
            || o.verdict == "unknown-effect"
            || o.kind == Mark::Right),
        "{}",
        summary(&tampered)
    );
}

#[test]
fn cameras_show_what_is_wrong_with_contacts_cameras_and_wire() {
    let pictured = [examine("pictures", 4, 2026), examine("nominals", 1, 2026)].concat();
    assert!(
        pictured.iter().all(|o| o.kind == Mark::Right),
        "{}",
        summary(&pictured)
    );
    // Contacts are where they are seen, as well as the shapes state it; errors that all pairs share
    // move single sessions.
    let after: Vec<f64> = pictured
        .iter()
        .filter_map(|o| o.contact_after_ratio)
        .collect();
    assert!(
        after.len() == pictured.len() && after.iter().all(|r| *r < 1.6),
        "{after:?}"
    );
    // Control: without its pictures a fault of the cameras is no finding.
    let without = examine("without-pictures", 2, 2026);
    assert!(
        without[1].verdict == "adequate" && without[1].contact_after_ratio.is_none(),
        "{}",
        summary(&without)
    );
}

#[test]
fn noise_as_instruments_make_it_is_no_effect() {
    // Every kind of noise once; a gross reading is marked, and named as nothing but what it is.
    let noisy = examine("noise-null", 11, 77);
    let refused = |o: &Outcome| o.verdict == "refused" || o.kind == Mark::Crash;
    let named = |o: &Outcome| o.kind != Mark::Right && (o.extra > 0 || o.verdict == "ambiguous");
    assert!(
        !noisy.iter().any(|o| refused(o) || named(o)),
        "{}",
        summary(&noisy)
    );
    let gross: Vec<&Outcome> = noisy.iter().filter(|o| o.noise.contains("gross")).collect();
    assert!(
        gross.len() == 2 && gross.iter().all(|o| o.flags_right == Some(true)),
        "{}",
        summary(&noisy)
    );
    // White, heavy-tailed and correlated along a line.
    let lines = examine("scalar-null", 5, 77);
    assert!(
        lines.iter().all(|o| o.kind == Mark::Right),
        "{}",
        summary(&lines)
    );
}
