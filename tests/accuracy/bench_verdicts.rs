//! Sweeps of the virtual bench in the sweep's own process, and what `verify` says of them
//! (SIMULATED). The bench's time passes only while the sweep waits, so a scenario and its seed give
//! the same session on every computer, in seconds.

use crate::support::{program, repository};
use serde_json::Value;
use std::path::Path;

/// A folder with the rig of the virtual bench without cameras, at 500 Hz.
fn bench() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    let rig = rig
        .split("[[camera]]")
        .next()
        .unwrap()
        .replace("rate_hz = 2000.0", "rate_hz = 500.0");
    std::fs::write(folder.path().join("rig.toml"), rig).unwrap();
    folder
}

fn wcal(folder: &Path, arguments: &[&str]) -> (i32, String) {
    let output = program()
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    (
        output.status.code().unwrap(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

/// The paper's plan, and one of five trajectories with rows on the fly.
const PAPER: &str = include_str!("../../rigs/plans/paper-27.toml");
const MOVING: &str = "format = \"wcal-plan/1\"\nname = \"moving\"\n[settle]\ngate_pm_per_s = 0.5\nwindow_s = 1.0\n\
    [[block]]\nrole = \"verification\"\ntrajectories = [1, 2, 4, 5, 7]\ndepths_mm = [2.5, 5.0]\nunloading = true\nreplicates = 2\n\
    speeds_mm_s = [2.0, 6.0]\non_the_fly_hz = 10.0\n";

/// Sweeps a scenario (`more` beyond format and rate) by a plan into `session`; what the program
/// said.
fn swept(folder: &Path, session: &str, plan: &str, more: &str) -> String {
    swept_at(folder, session, plan, more, 500)
}

/// The same at a rate, which the rig must have, too.
fn swept_at(folder: &Path, session: &str, plan: &str, more: &str, rate_hz: u32) -> String {
    let scenario = format!(
        "format = \"wcal-scenario/1\"\n{more}\n[interrogator]\nrate_hz = {rate_hz}\n[cameras]\ncount = 0\n"
    );
    std::fs::write(folder.join("scenario.toml"), scenario).unwrap();
    std::fs::write(folder.join("plan.toml"), plan).unwrap();
    let sweep = [
        "stage-sweep",
        "--rig",
        "rig.toml",
        "--plan",
        "plan.toml",
        "--home",
        "--scenario",
        "scenario.toml",
    ];
    let (code, said) = wcal(folder, &[&sweep[..], &["--out", session]].concat());
    assert_eq!(code, 0, "{said}");
    said
}

/// verify.json of a session.
fn verified(folder: &Path, session: &str) -> Value {
    let out = format!("verify-{session}");
    let (_, said) = wcal(folder, &["verify", session, "--out", &out]);
    let text = std::fs::read(folder.join(out).join("verify.json"));
    serde_json::from_slice(&text.unwrap_or_else(|e| unreachable!("{e}: {said}"))).unwrap()
}

fn names(v: &Value) -> Vec<&str> {
    v["effects"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|e| e["id"].as_str())
        .collect()
}

#[test]
fn a_scenario_and_its_seed_give_the_same_session_again() {
    let folder = bench();
    let points = |session: &str, seed: u64| {
        let said = swept(folder.path(), session, PAPER, &format!("seed = {seed}"));
        assert!(said.contains("SIMULATED"), "{said}");
        std::fs::read_to_string(folder.path().join(session).join("points.csv")).unwrap()
    };
    let first = points("first", 3);
    assert_eq!(first.lines().count(), 37, "27 poses, nine rests, a header");
    assert_eq!(first, points("again", 3));
    assert_ne!(first, points("other", 4));
    // A rig of another rate, and one with cameras, are not this bench.
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    std::fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let sweep = [
        "stage-sweep",
        "--rig",
        "rig.toml",
        "--plan",
        "plan.toml",
        "--scenario",
        "scenario.toml",
        "--out",
        "none",
    ];
    let (code, said) = wcal(folder.path(), &sweep);
    assert!(code == 1 && said.contains("500 Hz"), "{said}");
    assert!(!folder.path().join("none").exists());
}

/// A trajectory whose direction is not the stated one is left out by nothing in the catalogue; its
/// three poses, flagged together, were called slips of the wire in single readings.
#[test]
fn a_trajectory_that_is_off_as_a_whole_is_no_slip() {
    let folder = bench();
    let rig: toml::Table = std::fs::read_to_string(folder.path().join("rig.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let turned = |rad: f64| -> String {
        let each = rig["trajectory"].as_array().unwrap().iter().map(|t| {
            let numbers = |key: &str| -> Vec<f64> {
                t[key]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|v| v.as_float().unwrap())
                    .collect()
            };
            let (id, mut d) = (t["id"].as_integer().unwrap(), numbers("direction"));
            if id == 5 {
                let (sin, cos) = rad.sin_cos();
                (d[1], d[2]) = (cos * d[1] - sin * d[2], sin * d[1] + cos * d[2]);
            }
            format!(
                "[[trajectory]]\nid = {id}\norigin_mm = {:?}\ndirection = {d:?}\n",
                numbers("origin_mm")
            )
        });
        format!("seed = 20\n{}", each.collect::<String>())
    };
    swept(folder.path(), "turned", PAPER, &turned(0.054));
    let v = verified(folder.path(), "turned");
    assert_eq!(
        v["verdict"],
        "unknown-effect",
        "{} {:?}",
        v["reason"],
        names(&v)
    );
    // Control: as stated, nothing is found.
    swept(folder.path(), "straight", PAPER, &turned(0.0));
    let v = verified(folder.path(), "straight");
    assert_eq!(v["verdict"], "adequate", "{} {:?}", v["reason"], names(&v));
}

/// Interval of a parameter of an effect.
fn interval(v: &Value, id: &str, name: &str) -> [f64; 2] {
    let effect = v["effects"]
        .as_array()
        .unwrap()
        .iter()
        .find(|e| e["id"] == id)
        .unwrap();
    let own = effect["parameters"]
        .as_array()
        .unwrap()
        .iter()
        .find(|p| p["name"] == name)
        .unwrap();
    [0, 1].map(|k| own["interval95"][k].as_f64().unwrap())
}

/// Three depths do not tell the period of the screw's error, so sine and cosine each may be zero,
/// and the effect was dropped for that. Both together cannot be.
#[test]
fn an_error_of_the_screw_is_named_where_its_period_is_not_told() {
    let folder = bench();
    swept(
        folder.path(),
        "screw",
        PAPER,
        "seed = 38\n[effects]\nperiodic_um = 22.7",
    );
    let v = verified(folder.path(), "screw");
    assert_eq!(
        (&v["verdict"], names(&v)),
        (&"effect".into(), vec!["stage-periodic"]),
        "{}",
        v["reason"]
    );
    let [low, high] = interval(&v, "stage-periodic", "pitch_mm");
    assert!(low < 0.6096 && 0.6096 < high, "{low} {high}");
    // Control: without it nothing is named.
    swept(folder.path(), "none", PAPER, "seed = 38");
    let v = verified(folder.path(), "none");
    assert_eq!(v["verdict"], "adequate", "{} {:?}", v["reason"], names(&v));
}

/// Stamps of a stage that answers on a serial line come now earlier, now later: between two of them
/// the speed was 15 % off, and the lag with it.
#[test]
fn a_lag_beside_play_is_as_long_as_it_is() {
    let folder = bench();
    swept(
        folder.path(),
        "lag",
        MOVING,
        "seed = 35\n[effects]\nbacklash_um = 19\nlag_ms = 44",
    );
    let v = verified(folder.path(), "lag");
    assert_eq!(
        (&v["verdict"], names(&v)),
        (&"effect".into(), vec!["stage-backlash", "time-lag"]),
        "{}",
        v["reason"]
    );
    let [low, high] = interval(&v, "time-lag", "lag_s");
    assert!(
        low < 0.044 && 0.044 < high && high - low < 0.012,
        "{low} {high}"
    );
    let [low, high] = interval(&v, "stage-backlash", "backlash_mm");
    assert!(
        low < 0.019 && 0.019 < high && high - low < 0.006,
        "{low} {high}"
    );
    // Control: with the play alone no lag is named.
    swept(
        folder.path(),
        "play",
        MOVING,
        "seed = 35\n[effects]\nbacklash_um = 19",
    );
    let v = verified(folder.path(), "play");
    assert_eq!(
        (&v["verdict"], names(&v)),
        (&"effect".into(), vec!["stage-backlash"]),
        "{}",
        v["reason"]
    );
}

/// A settled row's time is the end of its averaging window, its mean is of the window's middle: of
/// a creep of eight seconds half a second is 6 %.
#[test]
fn creep_is_as_large_as_it_is_when_rows_say_how_long_they_average() {
    let folder = bench();
    swept(
        folder.path(),
        "creep",
        MOVING,
        "seed = 36\n[effects]\ncreep_fraction = 0.05\ncreep_s = 8",
    );
    let found = |session: &str| {
        let v = verified(folder.path(), session);
        assert_eq!(
            (&v["verdict"], names(&v)),
            (&"effect".into(), vec!["creep"]),
            "{}",
            v["reason"]
        );
        (
            interval(&v, "creep", "creep_fraction"),
            interval(&v, "creep", "time_constant_s"),
        )
    };
    let (fraction, constant) = found("creep");
    assert!(
        fraction[0] < 0.05 && 0.05 < fraction[1] && fraction[1] - fraction[0] < 0.003,
        "{fraction:?}"
    );
    assert!(
        constant[0] < 8.0 && 8.0 < constant[1] && constant[1] - constant[0] < 0.8,
        "{constant:?}"
    );
    // Control: without the windows' lengths the interval misses.
    std::fs::create_dir(folder.path().join("unsaid")).unwrap();
    for file in ["session.toml", "points.csv", "holdout.csv"] {
        let Ok(text) = std::fs::read_to_string(folder.path().join("creep").join(file)) else {
            continue;
        };
        let unsaid = text.replacen("average_s", "note", 1);
        std::fs::write(folder.path().join("unsaid").join(file), unsaid).unwrap();
    }
    let (fraction, _) = found("unsaid");
    assert!(0.05 < fraction[0], "{fraction:?}");
}

/// Over the paper's two minutes a room that warms steadily and a drift look alike to within 1e-2:
/// one name would be a matter of chance.
#[test]
fn a_drift_of_two_minutes_is_not_told_from_a_temperature_that_rises() {
    let folder = bench();
    let rig = std::fs::read_to_string(folder.path().join("rig.toml")).unwrap();
    std::fs::write(
        folder.path().join("rig.toml"),
        rig.replace("rate_hz = 500.0", "rate_hz = 2000.0"),
    )
    .unwrap();
    let found = |session: &str, swing: &str| {
        let more = format!(
            "seed = 246\n[temperature]\ndrift_degc_per_h = 0.3\n{swing}\n[effects]\nzero_drift_pm_per_min = 0.167"
        );
        swept_at(folder.path(), session, PAPER, &more, 2000);
        let v = verified(folder.path(), session);
        let mut told: Vec<String> = v["alternatives"]
            .as_array()
            .unwrap()
            .iter()
            .map(Value::to_string)
            .collect();
        told.sort_unstable();
        (v["verdict"].clone(), told.concat())
    };
    let slow = found("slow", "swing_degc = 0.05\nswing_period_s = 600.0");
    assert_eq!(
        slow,
        (
            "ambiguous".into(),
            r#"["temperature-mismatch"]["zero-drift"]"#.to_owned()
        )
    );
    // Control: a temperature that goes up and down within the session tells the drift.
    let fast = found("fast", "swing_degc = 0.05\nswing_period_s = 60.0");
    assert_eq!(fast, ("effect".into(), r#"["zero-drift"]"#.to_owned()));
}
