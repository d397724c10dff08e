//! The probability of several contacts: stated against observed, on objects that neither network nor map has seen.

use serde_json::{Value, json};
use wcal_track::model_file::Card;
use wcal_track::two_contacts::reliability::{PlattMap, Reliability, several_calls};
use wcal_track::{SweepSeries, Tracker};

/// Judged on unseen objects, the base's speed known: the network's own probability, the card's map where it has one, and for comparison a map
/// fitted here to the kept-back sweeps over seen objects.
pub fn several_probability<'a>(
    tracker: &Tracker,
    card: &Card,
    seen: impl Iterator<Item = &'a SweepSeries>,
    unseen: impl Iterator<Item = &'a SweepSeries>,
) -> Value {
    let judged = several_calls(tracker, unseen, true);
    let of_card = card.several_maps.map(|[_, known]| known);
    let of_seen = PlattMap::fitted(&several_calls(tracker, seen, true));
    let through = |map: Option<PlattMap>| {
        map.and_then(|map| Some(json!({"map": map, "reliability": Reliability::of(&judged, &map)?})))
    };
    json!({
        "as_stated": Reliability::of(&judged, &of_card.unwrap_or_default()),
        "uncalibrated": Reliability::of(&judged, &PlattMap::default()),
        "by_card": through(of_card), "fitted_on_seen": through(of_seen),
    })
}

/// What a person reads of it in the terminal.
pub fn print_several(document: &Value) {
    let number = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
    let line = |name: &str, r: &Value| {
        if !r.is_null() {
            println!(
                "several contacts, {name}: Brier {:.4} (constant base rate {:.4}), expected calibration error {:.3}",
                number(&r["brier"]),
                number(&r["brier_base_rate"]),
                number(&r["expected_calibration_error"])
            );
        }
    };
    let several = &document["several_probability"];
    line("unseen objects, the network's own probability", &several["uncalibrated"]);
    line("through the card's map", &several["by_card"]["reliability"]);
    line("through a map fitted on seen objects", &several["fitted_on_seen"]["reliability"]);
    for b in several["as_stated"]["bins"].as_array().into_iter().flatten() {
        println!(
            "  stated {:.1} to {:.1}: {:.3}, observed {:.3} of {}",
            number(&b["from"]),
            number(&b["to"]),
            number(&b["stated"]),
            number(&b["observed"]),
            b["samples"]
        );
    }
}
