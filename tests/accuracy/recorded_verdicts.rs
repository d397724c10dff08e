//! What `verify` says of sweeps that the program recorded itself: settled rows beside rows in
//! motion, one effect each (SIMULATED).

use crate::support::{fixture, program};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn recorded(name: &str) -> PathBuf {
    fixture("recorded").join(name)
}

/// verify.json of a session folder.
fn verified(session: &Path) -> Value {
    let out = tempfile::tempdir().unwrap();
    let run = program()
        .arg("verify")
        .arg(session)
        .arg("--out")
        .arg(out.path().join("v"))
        .output()
        .unwrap();
    let text = std::fs::read(out.path().join("v/verify.json"));
    serde_json::from_slice(&text.unwrap_or_else(|e| unreachable!("{e}: {run:?}"))).unwrap()
}

/// A recorded session whose rows are changed, or left out, by `edit` (names of the columns, cells).
fn edited(name: &str, edit: impl Fn(&[&str], &mut Vec<String>) -> bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(
        recorded(name).join("session.toml"),
        folder.path().join("session.toml"),
    )
    .unwrap();
    for file in ["points.csv", "holdout.csv"] {
        let text = std::fs::read_to_string(recorded(name).join(file)).unwrap();
        let mut lines = text.lines();
        let header = lines.next().unwrap();
        let names: Vec<&str> = header.split(',').collect();
        let mut out = vec![header.to_owned()];
        for line in lines {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if edit(&names, &mut cells) {
                out.push(cells.join(","));
            }
        }
        std::fs::write(folder.path().join(file), out.join("\n") + "\n").unwrap();
    }
    folder
}

fn place(names: &[&str], column: &str) -> usize {
    names.iter().position(|n| *n == column).unwrap()
}

/// The only effect, with its class alone, and the interval of its parameter `name`.
fn only(v: &Value, id: &str, name: &str) -> [f64; 2] {
    assert_eq!(v["verdict"], "effect", "{} {}", v["reason"], v["notes"]);
    assert_eq!(
        v["effects"].as_array().map(Vec::len),
        Some(1),
        "{}",
        v["effects"]
    );
    assert_eq!(v["effects"][0]["id"], id);
    let own = v["effects"][0]["parameters"]
        .as_array()
        .unwrap()
        .iter()
        .find(|p| p["name"] == name)
        .unwrap();
    [0, 1].map(|k| own["interval95"][k].as_f64().unwrap())
}

/// The settled floor is that of 500 samples with the reference's noise, 0.063 pm, whatever the rows
/// in motion scatter (0.45 pm).
fn floors(v: &Value) {
    let floor = |key: &str| v["noise_floor"][key].as_f64().unwrap();
    let (settled, moving) = (floor("wavelength_pm"), floor("moving_wavelength_pm"));
    assert!(
        (0.0632 / 1.3..0.0632 * 1.3).contains(&settled),
        "settled {settled} pm"
    );
    assert!(
        (0.447 / 1.3..0.447 * 1.3).contains(&moving),
        "moving {moving} pm"
    );
}

/// Whether poses that were set again refute the declared and the accepted model: p-values beside
/// the verdict of each.
fn refuted_by_replicates(v: &Value) -> Vec<bool> {
    let all = v["tests"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|t| t["witness"] == "replicates");
    let of = |t: &Value| {
        let (p, refuted) = (t["p"].as_f64().unwrap(), t["refuted"].as_bool().unwrap());
        assert_eq!(refuted, p < 0.002, "{t}");
        refuted
    };
    all.map(of).collect()
}

#[test]
fn a_drift_is_named_alone_and_nothing_where_it_is_taken_out() {
    let v = verified(&recorded("drift"));
    let [low, high] = only(&v, "zero-drift", "drift_pm_per_min_1");
    assert!(low < 0.3 && 0.3 < high && high - low < 0.02, "{low} {high}");
    floors(&v);
    // A second opinion, from nothing but how poses reproduce: the declared model is refuted, the
    // accepted one stands.
    assert_eq!(refuted_by_replicates(&v), [true, false], "{}", v["tests"]);
    // Control: the same readings less 0.3 pm/min.
    let without = edited("drift", |names, cells| {
        let minutes = cells[place(names, "t_s")].parse::<f64>().unwrap() / 60.0;
        for column in ["fbg_1_nm", "fbg_2_nm"] {
            let cell = &mut cells[place(names, column)];
            *cell = format!("{:.7}", cell.parse::<f64>().unwrap() - 0.3e-3 * minutes);
        }
        true
    });
    let v = verified(without.path());
    assert_eq!(v["verdict"], "adequate", "{} {}", v["reason"], v["effects"]);
    assert_eq!(refuted_by_replicates(&v), [false], "{}", v["tests"]);
    floors(&v);
}

#[test]
fn a_lag_is_named_alone_and_nothing_where_no_row_was_read_in_motion() {
    let v = verified(&recorded("lag"));
    let [low, high] = only(&v, "time-lag", "lag_s");
    assert!(
        low < 0.060 && 0.060 < high && high - low < 0.01,
        "{low} {high}"
    );
    floors(&v);
    // Control: the settled rows alone cannot show it.
    let settled = edited("lag", |names, cells| {
        cells[place(names, "dwell_s")].parse::<f64>().unwrap() > 0.0
    });
    let v = verified(settled.path());
    assert_eq!(v["verdict"], "adequate", "{} {}", v["reason"], v["effects"]);
}

#[test]
fn creep_is_named_alone() {
    let v = verified(&recorded("creep"));
    let [low, high] = only(&v, "creep", "creep_fraction");
    assert!(
        low < 0.02 && 0.02 < high && high - low < 0.004,
        "{low} {high}"
    );
    let [low, high] = only(&v, "creep", "time_constant_s");
    assert!(
        low < 30.0 && 30.0 < high && high - low < 12.0,
        "{low} {high}"
    );
    assert_eq!(refuted_by_replicates(&v), [true, false], "{}", v["tests"]);
    floors(&v);
}
