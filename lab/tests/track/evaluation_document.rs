//! The document of an evaluation as it is written.

use wcal_lab::evaluation::document::Means;

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
