//! What a person reads of an evaluation in the terminal.

use crate::evaluation::MethodScores;
use crate::evaluation::document::mean;
use serde_json::Value;

/// `0.22 [0.18, 0.27]` out of a row, `-` where there is no value.
fn stated(row: &Value, key: &str) -> String {
    let Some(value) = row[key].as_f64() else {
        return "-".to_owned();
    };
    let interval: Vec<f64> = row["interval95"][key]
        .as_array()
        .into_iter()
        .flatten()
        .flat_map(Value::as_f64)
        .collect();
    match interval[..] {
        [low, high] => format!("{value:.2} [{low:.2}, {high:.2}]"),
        _ => format!("{value:.2}"),
    }
}

/// Methods, and the tables.
pub(super) fn print(scores: &[MethodScores], document: &Value) {
    print_methods(scores, document);
    print_bench(document);
    print_test_objects(document);
}

fn print_bench(document: &Value) {
    let number = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
    let real = &document["virtual_real"];
    if real.is_null() {
        return;
    }
    println!(
        "VIRTUAL real bench: seen {}, unseen {}, worst {} mm (verify: {}, accepted {})",
        stated(real, "seen_mean_mm"),
        stated(real, "unseen_mean_mm"),
        stated(real, "worst_mm"),
        real["verdict"],
        real["accepted"]
    );
    let covers = &real["coverage90"];
    println!(
        "  its 90 % regions cover: seen {:.3}, unseen {:.3}",
        number(&covers["seen"]),
        number(&covers["unseen"])
    );
    let known = &document["known_motion"];
    if !known.is_null() {
        println!(
            "  known motion, its groove by physics: {:.2} mm, bound {:.2} mm (error / bound {:.2}); 95 % regions hold {} of {} trajectories",
            number(&known["error_mm"]),
            number(&known["bound_mm"]),
            number(&known["error_over_bound"]),
            known["trajectories_held"],
            known["trajectories"]
        );
    }
}

fn print_methods(scores: &[MethodScores], document: &Value) {
    println!(
        "SIMULATED; mean over objects of the RMSE in mm; followed: 2 mm of the base's way after an onset, jump or slip"
    );
    println!(
        "{:7} {:21} {:>19} {:>19} {:>19} {:>19} {:>7} {:>6}",
        "objects", "method", "surface", "followed", "contact", "followed", "cover90", "F1"
    );
    let scored = scores.iter().filter(|s| !s.objects.is_empty());
    for (s, row) in scored.zip(document["methods"].as_array().into_iter().flatten()) {
        let cover = s
            .objects
            .iter()
            .filter_map(|o| o.all.coverage90)
            .collect::<Vec<_>>();
        let cover = if cover.is_empty() {
            "-".to_owned()
        } else {
            format!("{:.3}", cover.iter().sum::<f64>() / cover.len() as f64)
        };
        let [a, b, c, d] = [
            "rmse_mm",
            "followed_rmse_mm",
            "true_contact_rmse_mm",
            "followed_true_contact_rmse_mm",
        ]
        .map(|k| stated(row, k));
        println!(
            "{:7} {:21} {a:>19} {b:>19} {c:>19} {d:>19} {cover:>7} {:6.3}",
            s.set,
            s.method,
            mean(&s.objects, |o| o.detection.f1)
        );
    }
}

/// Objects set aside for tests.
fn print_test_objects(document: &Value) {
    let rows = document["test_objects"]["rows"].as_array();
    if rows.is_some() {
        println!(
            "test objects, which chose no design (surface, true contact, mm; coverage of 90 % regions)"
        );
    }
    for r in rows.into_iter().flatten() {
        let speed = if r["speed_known"] == true {
            "speed known"
        } else {
            "speed not known"
        };
        println!(
            "  {:8} {:8} {speed:16} {:>20} {:>20} {:>7.3}",
            r["turns"].as_str().unwrap_or(""),
            r["method"].as_str().unwrap_or(""),
            stated(r, "rmse_mm"),
            stated(r, "true_contact_rmse_mm"),
            r["coverage90"].as_f64().unwrap_or(f64::NAN)
        );
    }
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
