//! The document of an evaluation as it is written.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use wcal_lab::evaluation::document::Means;
use wcal_lab::evaluation::slope_s;

#[test]
fn a_mean_over_nothing_is_null() {
    let means = Means::of(&[], &[]);
    let written = serde_json::to_value(&means).unwrap();
    assert!(
        written["seen_mean_mm"].is_null() && written["interval95"]["seen_mean_mm"].is_null(),
        "{written}"
    );
    assert_eq!(written["objects"].as_array().map(Vec::len), Some(0));
}

#[test]
fn the_slope_of_a_line_is_found_and_that_of_one_speed_is_none() {
    let line: Vec<[f64; 2]> = (1..6).map(|k| [f64::from(k), 0.3 + 0.02 * f64::from(k)]).collect();
    assert!((slope_s(&line) - 0.02).abs() < 1e-12);
    // Control: one speed twice has no slope.
    assert_eq!(slope_s(&[[4.0, 0.1], [4.0, 0.3]]), 0.0);
}
