//! Measured strokes of a pneumatic actuator: friction by direction through the program.

use crate::support::{fixture, program};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn pneumatic(name: &str) -> PathBuf {
    fixture("pneumatic").join(name)
}

fn verify(folder: &Path) -> Value {
    let out = tempfile::tempdir().unwrap();
    let run = program()
        .arg("verify")
        .arg(folder)
        .args(["--json", "--out"])
        .arg(out.path())
        .output()
        .unwrap();
    serde_json::from_slice(&run.stdout).unwrap()
}

/// Half the difference of the mean force between the directions, N.
fn half_difference(table: &str) -> f64 {
    let mut sums = [[0.0; 2]; 2];
    let header: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|h| *h == name).unwrap();
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let side = usize::from(cells[column("direction")].parse::<f64>().unwrap() > 0.0);
        sums[side][0] += cells[column("response")].parse::<f64>().unwrap();
        sums[side][1] += 1.0;
    }
    0.5 * (sums[1][0] / sums[1][1] - sums[0][0] / sums[0][1])
}

fn effect<'a>(v: &'a Value, id: &str) -> Option<&'a Value> {
    v["effects"].as_array()?.iter().find(|e| e["id"] == id)
}

#[test]
fn friction_by_direction_is_named_with_its_size() {
    for name in ["pk-7bar", "nap310-1bar"] {
        let v = verify(&pneumatic(name));
        let half =
            half_difference(&std::fs::read_to_string(pneumatic(name).join("points.csv")).unwrap());
        let hysteresis =
            effect(&v, "hysteresis").unwrap_or_else(|| panic!("{name}: {}", v["effects"]));
        let size = hysteresis["parameters"]
            .as_array()
            .unwrap()
            .iter()
            .find(|p| p["name"] == "half_loop")
            .unwrap();
        let stated = size["value"].as_f64().unwrap();
        // The plain difference of means also holds what the ends of the strokes add.
        assert!(
            (stated / half - 1.0).abs() < 0.05,
            "{name}: {stated} against {half} N"
        );
        let rmse = |when: &str| v[when]["response_rmse"].as_f64().unwrap();
        assert!(
            rmse("after") < 0.1 * rmse("before"),
            "{name}: {} to {}",
            rmse("before"),
            rmse("after")
        );
        // A wave that repeats with the strokes is no period of its own.
        assert!(effect(&v, "periodic").is_none_or(|p| {
            let period = p["parameters"]
                .as_array()
                .unwrap()
                .iter()
                .find(|p| p["name"] == "period")
                .unwrap();
            period["unit"] != "readings"
        }));
    }
}

#[test]
fn without_the_difference_no_hysteresis_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(
        pneumatic("pk-7bar").join("session.toml"),
        folder.path().join("session.toml"),
    )
    .unwrap();
    let text = std::fs::read_to_string(pneumatic("pk-7bar").join("points.csv")).unwrap();
    let half = half_difference(&text);
    let header: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let level = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if let (Ok(force), Ok(direction)) = (
            cells[column("response")].parse::<f64>(),
            cells[column("direction")].parse::<f64>(),
        ) {
            cells[column("response")] = format!("{:.4}", force - half * direction);
        }
        cells.join(",") + "\n"
    };
    std::fs::write(
        folder.path().join("points.csv"),
        text.lines().map(level).collect::<String>(),
    )
    .unwrap();
    let v = verify(folder.path());
    let loops = effect(&v, "hysteresis")
        .and_then(|e| e["parameters"][0]["value"].as_f64())
        .unwrap_or(0.0);
    assert!(loops.abs() < 0.1 * half, "{loops} of {half} N");
}
