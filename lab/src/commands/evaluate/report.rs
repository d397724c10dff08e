//! `report.html` of an evaluation, out of its document.

use crate::commands::page::{Curves, Page, PlainTable, render};
use anyhow::ensure;
use serde_json::Value;
use wcal_report::Fact;

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

/// A table out of rows: the names' key, then keys of errors in mm with their headings.
fn table(rows: &Value, caption: &str, name: &[&str], columns: &[(&str, &str)]) -> Option<PlainTable> {
    let rows = rows.as_array().filter(|r| !r.is_empty())?;
    let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let one = |r: &Value| {
        let first = name.iter().map(|k| text(&r[*k])).collect::<Vec<_>>().join(", ");
        // A key with a slash is a path within the row.
        let cell = |key: &str| match r.pointer(key).and_then(Value::as_f64) {
            Some(value) if key.starts_with('/') => format!("{value:.2}"),
            _ => stated(r, key),
        };
        std::iter::once(first).chain(columns.iter().map(|(key, _)| cell(key))).collect()
    };
    Some(PlainTable {
        caption: caption.to_owned(),
        columns: std::iter::once(name.join(", "))
            .chain(columns.iter().map(|c| format!("#{}", c.1)))
            .collect(),
        rows: rows.iter().map(one).collect(),
    })
}

/// The tables that the document has.
fn tables(document: &Value) -> Vec<PlainTable> {
    let real = &document["virtual_real"];
    let surface = ("rmse_mm", "surface, mm");
    let [true_contact, followed] =
        [("true_contact_rmse_mm", "true contact, mm"), ("followed_rmse_mm", "followed, mm")];
    let tables = [
        table(
            &document["methods"],
            "Methods: mean over objects of the RMSE",
            &["set", "method"],
            &[surface, followed, true_contact],
        ),
        table(
            &document["faces"]["methods"],
            "Upright objects, filter and network on the same sweeps",
            &["set", "method"],
            &[surface, true_contact],
        ),
        table(
            &document["simulation"]["objects"],
            "Simulation, object by object",
            &["set", "name"],
            &[surface, true_contact, ("along_track_mm", "along the way, mm")],
        ),
        table(
            &document["faces"]["objects"],
            "Simulation, objects upright, four faces, no jumps (the paper's table I)",
            &["set", "name"],
            &[surface, true_contact],
        ),
        table(
            &real["objects"],
            "VIRTUAL real bench, object by object",
            &["set", "name"],
            &[surface, true_contact],
        ),
        table(
            &document["ablations"],
            "Ablations on the VIRTUAL real bench, unseen objects",
            &["name"],
            &[surface, followed, true_contact],
        ),
        table(
            &document["noise"],
            "VIRTUAL real bench, unseen objects, by the noise of its stream",
            &["noise"],
            &[surface, true_contact, ("/coverage90", "coverage of 90 % regions")],
        ),
        table(
            &document["test_objects"]["rows"],
            "Test objects, which chose no design (SIMULATED)",
            &["turns", "method", "speed_known"],
            &[surface, true_contact],
        ),
        table(
            &document["speed"],
            "Speed",
            &["mm_s"],
            &[("constant_mm", "constant, mm"), ("random_mm", "random, mm")],
        ),
        table(
            &document["sim2real"],
            "Simulation, VIRTUAL air and water",
            &["name"],
            &[("simulation_mm", "simulation, mm"), ("air_mm", "air, mm"), ("water_mm", "water, mm")],
        ),
    ];
    tables.into_iter().flatten().collect()
}

/// The page of evaluation.json.
///
/// # Errors
/// Where it has no rows of methods.
pub fn page(document: &Value) -> anyhow::Result<String> {
    ensure!(document["methods"].is_array(), "methods: expected rows, found none");
    let real = &document["virtual_real"];
    let mut facts = Vec::new();
    if !real.is_null() {
        for (name, key) in [("seen", "seen_mean_mm"), ("unseen", "unseen_mean_mm"), ("worst", "worst_mm")] {
            facts.push(Fact::new(format!("virtual bench, {name}"), format!("{} mm", stated(real, key))));
        }
    }
    let faces = &document["faces"];
    if !faces.is_null() {
        for (name, key) in [("seen", "seen_mean_mm"), ("unseen", "unseen_mean_mm")] {
            facts.push(Fact::new(format!("upright, no jumps, {name}"), format!("{} mm", stated(faces, key))));
        }
    }
    facts.push(Fact::new("streaming", format!("{} samples/s", document["streaming"]["samples_per_s"])));
    facts.push(Fact::new("model, SHA-256", document["model"].as_str().unwrap_or("")));
    let mut notes = vec![
        "In brackets: 95 % intervals by bootstrap, over whole objects for means and over whole sweeps for one object.".to_owned(),
        "The virtual real bench is a simulation with other physics; nothing of it was used in training.".to_owned(),
    ];
    if document["quick"] == true {
        notes.insert(
            0,
            "QUICK: few objects and sweeps, so that the intervals are wide; not for comparisons.".to_owned(),
        );
    }
    let speed = document["speed"].as_array().cloned().unwrap_or_default();
    let line = |key: &str| {
        speed.iter().filter_map(|r| Some([r["mm_s"].as_f64()?, r[key].as_f64()?])).collect::<Vec<[f64; 2]>>()
    };
    let curves = if speed.is_empty() {
        Vec::new()
    } else {
        vec![Curves {
            title: "Error over speed".into(),
            x: "speed, mm/s".into(),
            y: "RMSE, mm".into(),
            lines: vec![("constant".into(), line("constant_mm")), ("random".into(), line("random_mm"))],
            marks: Vec::new(),
        }]
    };
    Ok(render(&Page {
        over: "Contact tracker".into(),
        title: "Evaluation".into(),
        facts,
        notes,
        curves,
        tables: tables(document),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_value_stands_with_its_interval_or_as_a_dash() {
        assert_eq!(stated(&json!({"seen_mean_mm": null}), "seen_mean_mm"), "-");
        let row = json!({"rmse_mm": 0.224, "interval95": {"rmse_mm": [0.18, 0.27]}});
        assert_eq!(stated(&row, "rmse_mm"), "0.22 [0.18, 0.27]");
    }
}
