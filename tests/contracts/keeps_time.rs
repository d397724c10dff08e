//! The page of the bench, whose sweep and stream run beside each other in time.

use crate::readme::{after, json, marked};
use std::fs;

#[test]
fn the_bench_runs_and_marks_what_it_leaves() {
    let folder = after("docs/src/guide/bench.md");
    for name in [
        "session/run.json",
        "verify/verify.json",
        "groove.json",
        "track.json",
    ] {
        assert_eq!(json(folder.path(), name)["simulated"], true, "{name}");
    }
    assert_eq!(
        json(folder.path(), "fit/calibration.json")["provenance"]["simulated"],
        true
    );
    assert!(marked(folder.path(), "verify/report.html"));
    // The stream was tracked. Whether the sweep beside it has come to a contact within its 20 s is
    // a matter of the machine's load; contacts of live streams are tested where nothing else runs
    // (tests/live/track_live.rs).
    let track = fs::read_to_string(folder.path().join("track.csv")).unwrap();
    let probabilities: Vec<f64> = track
        .lines()
        .skip(1)
        .filter_map(|l| l.split(',').nth(6)?.parse().ok())
        .collect();
    assert!(
        probabilities.len() > 100 && probabilities.iter().any(|p| *p < 0.5),
        "{}",
        probabilities.len()
    );
}
