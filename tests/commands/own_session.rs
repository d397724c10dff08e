//! A clean session of the rich plan, from the sweep to contact points through its own calibration (SIMULATED).

use crate::support::{code_and_messages, repository};
use serde_json::Value;
use std::path::Path;

/// A rig without cameras and a bench without effects, as files in a folder.
fn rig_and_scenario(folder: &Path, seed: u64) {
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    let of_stage = rig.replace("rate_hz = 2000.0", "rate_hz = 500.0").replace("clock_scale = 4.0\n", "");
    let (head, cameras) = (of_stage.split("[[camera]]").next().unwrap(), of_stage.contains("[[camera]]"));
    assert!(cameras, "the rig's cameras come last");
    std::fs::write(folder.join("rig.toml"), head).unwrap();
    let scenario = format!(
        "format = \"wcal-scenario/1\"\nseed = {seed}\n[interrogator]\nrate_hz = 500.0\nnoise_pm = 1.0\n\
         [temperature]\ndrift_degc_per_h = 0.3\nswing_degc = 0.05\nswing_period_s = 600.0\n"
    );
    std::fs::write(folder.join("scenario.toml"), scenario).unwrap();
}

/// Rows, flagged rows, and trajectories whose region holds the groove; with the exit code.
fn tracked(session: &str, calibration: &str, out: &Path) -> (i32, [u64; 4]) {
    let table = out.display().to_string();
    let (code, text) = code_and_messages(&["track", session, "--calibration", calibration, "--out", &table]);
    let document = std::fs::read(out.with_extension("json")).unwrap_or_else(|e| panic!("{e}: {text}"));
    let v: Value = serde_json::from_slice(&document).unwrap();
    let number = |v: &Value| v.as_u64().unwrap_or_else(|| panic!("{v}"));
    let groove = &v["groove_tracking"];
    let counts = [&v["rows"], &v["flagged_rows"], &groove["trajectories"], &groove["trajectories_held"]];
    (code, counts.map(number))
}

/// Rows on the fly average 10 samples, settled ones 501; both have the noise that follows from their own number.
#[test]
fn a_clean_rich_session_is_located_by_its_own_calibration() {
    let mut held = [0, 0];
    for seed in [11, 12, 13] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        rig_and_scenario(folder.path(), seed);
        let plan = repository("rigs/plans/rich.toml").display().to_string();
        let (rig, scenario, session) = (at("rig.toml"), at("scenario.toml"), at("session"));
        let sweep = ["--rig", &rig, "--plan", &plan, "--scenario", &scenario, "--out", &session];
        let (code, text) = code_and_messages(&[&["stage-sweep", "--home"][..], &sweep].concat());
        assert_eq!(code, 0, "{text}");
        let verified = at("verified");
        let (code, text) = code_and_messages(&["verify", &session, "--out", &verified]);
        assert_eq!(code, 0, "{text}");
        let calibration = format!("{verified}/calibration.json");
        let (code, [rows, flagged, trajectories, inside]) =
            tracked(&session, &calibration, &folder.path().join("track.csv"));
        println!("SIMULATED: seed {seed}: {flagged} of {rows} rows flagged, {inside} of {trajectories} held");
        assert!(code == 0 && 20 * flagged <= rows, "seed {seed}: exit {code}, {flagged} of {rows} flagged");
        held = [held[0] + inside, held[1] + trajectories];
        // Control: rows on the fly that claim as many samples as settled ones contradict the motion.
        if seed == 11 {
            let points = folder.path().join("session/points.csv");
            let text = std::fs::read_to_string(&points).unwrap();
            let place = text.lines().next().unwrap().split(',').position(|c| c == "samples").unwrap();
            let claimed = text.lines().enumerate().map(|(k, line)| {
                let mut cells: Vec<&str> = line.split(',').collect();
                if k > 0 {
                    cells[place] = "501";
                }
                cells.join(",") + "\n"
            });
            std::fs::write(&points, claimed.collect::<String>()).unwrap();
            let (code, [rows, flagged, ..]) =
                tracked(&session, &calibration, &folder.path().join("claimed.csv"));
            assert!(
                (3..=4).contains(&code) && 2 * flagged > rows,
                "exit {code}, {flagged} of {rows} flagged"
            );
        }
    }
    // Of 27 regions with 95 % each at most five miss (once in 400 such tests).
    assert!(held[1] == 27 && held[0] >= 22, "{held:?}");
}
