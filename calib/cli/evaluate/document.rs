//! `evaluation.json`: errors with their intervals, mean over objects and object by object.

use super::{EvaluateArgs, FORMAT};
use crate::picture_output::provenance;
use serde_json::{Value, json};
use wcal_track::bootstrap::{ErrorOf, mean_interval95, object_interval95};
use wcal_track::evaluate::ObjectScores;

/// Mean over objects; not a number without any, which a document has as null.
pub(super) fn mean(rows: &[ObjectScores], value: impl Fn(&ObjectScores) -> f64) -> f64 {
    rows.iter().map(value).sum::<f64>() / rows.len() as f64
}

/// Errors of a row that are means over objects.
pub(super) const MEANS: [(&str, ErrorOf); 4] = [
    ("rmse_mm", |s| s.surface),
    ("true_contact_rmse_mm", |s| s.contact),
    ("followed_rmse_mm", |s| s.followed_surface),
    ("followed_true_contact_rmse_mm", |s| s.followed_contact),
];

/// 95 % intervals of the means over objects.
pub(super) fn intervals(rows: &[ObjectScores]) -> Value {
    MEANS.iter().map(|(name, of)| (*name, json!(mean_interval95(rows, *of)))).collect()
}

pub(super) fn document(
    rows: &[(&str, &str, Vec<ObjectScores>)],
    streaming: &Value,
    model: &str,
    args: &EvaluateArgs,
) -> Value {
    let of =
        |set: &str, name: &str| rows.iter().find(|r| r.0 == set && r.1 == name).map_or(&[][..], |r| &r.2[..]);
    let best = "network, speed known";
    let objects: Vec<Value> =
        ["seen", "unseen"].iter().flat_map(|set| of(set, best).iter().map(move |o| object(o, set))).collect();
    let scored = rows.iter().filter(|(_, _, r)| !r.is_empty());
    let methods: Vec<Value> = scored.map(|(set, name, r)| method(set, name, r)).collect();
    json!({
        "format": FORMAT, "simulated": true, "quick": args.quick, "model": model, "calibration": null,
        "simulation": {"method": best, "seen_mean_mm": mean(of("seen", best), |o| o.all.rmse_mm),
            "unseen_mean_mm": mean(of("unseen", best), |o| o.all.rmse_mm),
            "interval95": both_means(of("seen", best), of("unseen", best)),
            "objects": objects},
        "bootstrap": {"level": 0.95, "means": "whole objects are drawn again", "object": "whole sweeps are drawn again"},
        "methods": methods, "streaming": streaming,
        "provenance": provenance([args.model.join("model.json").as_path()]),
    })
}

/// A method's row in evaluation.json.
pub(super) fn method(set: &str, name: &str, r: &[ObjectScores]) -> Value {
    json!({"set": set, "method": name, "rmse_mm": mean(r, |o| o.all.rmse_mm),
        "true_contact_rmse_mm": mean(r, |o| o.all.true_contact_rmse_mm), "p95_mm": mean(r, |o| o.all.p95_mm),
        "followed_rmse_mm": mean(r, |o| o.followed.rmse_mm),
        "followed_true_contact_rmse_mm": mean(r, |o| o.followed.true_contact_rmse_mm),
        "detection_f1": mean(r, |o| o.detection.f1), "interval95": intervals(r)})
}

/// 95 % intervals of the two means.
pub(super) fn both_means(seen: &[ObjectScores], unseen: &[ObjectScores]) -> Value {
    let of: ErrorOf = |s| s.surface;
    json!({"seen_mean_mm": mean_interval95(seen, of), "unseen_mean_mm": mean_interval95(unseen, of)})
}

/// An object's row in evaluation.json.
pub(super) fn object(o: &ObjectScores, set: &str) -> Value {
    json!({"name": o.name, "set": set, "rmse_mm": o.all.rmse_mm, "true_contact_rmse_mm": o.all.true_contact_rmse_mm,
        "along_track_mm": o.all.along_track_mm, "p95_mm": o.all.p95_mm, "coverage90": o.all.coverage90,
        "followed": o.followed, "detection": o.detection, "sweeps": o.sweeps.len(),
        "interval95": {"rmse_mm": object_interval95(&o.sweeps, |s| s.surface),
            "true_contact_rmse_mm": object_interval95(&o.sweeps, |s| s.contact),
            "along_track_mm": object_interval95(&o.sweeps, |s| s.along)}})
}

/// `0.22 [0.18, 0.27]` out of a row, `-` where there is no value.
pub(super) fn stated(row: &Value, key: &str) -> String {
    let Some(value) = row[key].as_f64() else { return "-".to_owned() };
    let interval: Vec<f64> =
        row["interval95"][key].as_array().into_iter().flatten().flat_map(Value::as_f64).collect();
    match interval[..] {
        [low, high] => format!("{value:.2} [{low:.2}, {high:.2}]"),
        _ => format!("{value:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_over_nothing_is_no_number() {
        let means = json!({"seen_mean_mm": mean(&[], |o| o.all.rmse_mm)});
        assert!(means["seen_mean_mm"].is_null());
        assert_eq!(stated(&means, "seen_mean_mm"), "-");
        let row = json!({"rmse_mm": 0.224, "interval95": {"rmse_mm": [0.18, 0.27]}});
        assert_eq!(stated(&row, "rmse_mm"), "0.22 [0.18, 0.27]");
    }
}
