//! What a person reads of an evaluation in the terminal.

use super::report::stated;
use crate::evaluation::document::mean;
use crate::evaluation::{MethodScores, slope_s};
use serde_json::Value;

/// Methods, streaming, and the tables.
pub(super) fn print(scores: &[MethodScores], document: &Value) {
    if document["quick"] == true {
        println!("QUICK: few objects and sweeps, wide intervals");
    }
    print_methods(scores, document);
    let streaming = &document["streaming"];
    println!("streaming: {} samples/s, p99 {} us", streaming["samples_per_s"], streaming["p99_us"]);
    print_tables(document);
    print_test_objects(document);
}

fn print_tables(document: &Value) {
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
    let faces = &document["faces"];
    for (name, of) in [("moments only", &faces["speed_not_known"]), ("speed known", faces)] {
        let [seen, unseen] = ["seen_mean_mm", "unseen_mean_mm"].map(|k| stated(of, k));
        println!(
            "upright, four faces, no jumps (the paper's table I), {name}: seen {seen}, unseen {unseen} mm"
        );
    }
    for r in faces["methods"].as_array().into_iter().flatten() {
        let [set, name] = ["set", "method"].map(|k| r[k].as_str().unwrap_or(""));
        println!("  {set:7} {name:21} {:>19}", stated(r, "rmse_mm"));
    }
    let rows = |name: &str| document[name].as_array().cloned().unwrap_or_default();
    for r in rows("ablations") {
        println!(
            "  {:28} {:>20} {:>20}",
            r["name"].as_str().unwrap_or(""),
            stated(&r, "rmse_mm"),
            stated(&r, "followed_rmse_mm")
        );
    }
    for r in rows("noise") {
        println!(
            "  noise {:12} {:>20} mm from the surface; 90 % regions hold {:.3}",
            r["noise"].as_str().unwrap_or(""),
            stated(&r, "rmse_mm"),
            number(&r["coverage90"])
        );
    }
    let speeds = rows("speed");
    if speeds.is_empty() {
        return;
    }
    println!("speed mm/s: constant, random (mm)");
    for r in &speeds {
        println!(
            "  {:4.0} {:>20} {:>20}",
            number(&r["mm_s"]),
            stated(r, "constant_mm"),
            stated(r, "random_mm")
        );
    }
    let slope = |key: &str| {
        let point = |r: &Value| Some([r["mm_s"].as_f64()?, r[key].as_f64()?]);
        slope_s(&speeds.iter().filter_map(point).collect::<Vec<_>>())
    };
    println!("  slope {:.3} s, {:.3} s", slope("constant_mm"), slope("random_mm"));
    println!("simulation, virtual air, virtual water (mm)");
    for r in rows("sim2real") {
        let [s, a, w] = ["simulation_mm", "air_mm", "water_mm"].map(|k| stated(&r, k));
        println!("  {:18} {s:>20} {a:>20} {w:>20}", r["name"].as_str().unwrap_or(""));
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
        let cover = s.objects.iter().filter_map(|o| o.all.coverage90).collect::<Vec<_>>();
        let cover = if cover.is_empty() {
            "-".to_owned()
        } else {
            format!("{:.3}", cover.iter().sum::<f64>() / cover.len() as f64)
        };
        let [a, b, c, d] =
            ["rmse_mm", "followed_rmse_mm", "true_contact_rmse_mm", "followed_true_contact_rmse_mm"]
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
        println!("test objects, which chose no design (surface, true contact, mm; coverage of 90 % regions)");
    }
    for r in rows.into_iter().flatten() {
        let speed = if r["speed_known"] == true { "speed known" } else { "speed not known" };
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
